"""The laser interlock: a laser is lit only on a robot at rest without any fault.

A fault stops the mirror too. Driving does not: the mirror's place is known only by counting its moves, and it goes back
to its middle while the robot drives off.
"""

from __future__ import annotations

from dataclasses import replace

from hardware_bridge.safety.draft import Body, Draft
from hardware_bridge.safety.limits import SafetyLimits
from hardware_bridge.safety.situation import RobotSituation


def interlock(limits: SafetyLimits, draft: Draft) -> Draft:
    """Lasers off where the robot moves or has no laser, where people have not released it, or its allowance is used."""
    for place, body, robot in draft.free():
        if draft.commands[place].laser > 0.0:
            reason = _reason(limits, draft, place, body, robot)
            dark = replace(draft.commands[place], laser=0.0)
            draft = draft.alter(place, "laser", reason, dark) if reason else draft
    lit = (command.laser > 0.0 for command in draft.commands)
    used = zip(draft.memory.lit_s, lit, strict=True)
    return draft.remember(lit_s=tuple(_used_s(limits, before, on, draft.elapsed_s) for before, on in used))


def _reason(limits: SafetyLimits, draft: Draft, place: int, body: Body, robot: RobotSituation) -> str:
    if not body.laser:
        return "it carries no laser"
    if not draft.situation.laser_allowed:
        return "people have not released the lasers"
    if not (draft.commands[place].stands and robot.stationary):
        return "it moves; the laser is for robots at rest"
    most, used_s = limits.laser_max_on_s, draft.memory.lit_s[place]
    if most is not None and used_s + draft.elapsed_s > most:
        return f"it was lit for {used_s:.1f} s, at most {most} s of {limits.laser_period_s} s"
    return ""


def _used_s(limits: SafetyLimits, used_s: float, lit: bool, elapsed_s: float) -> float:
    """How much of its allowance a laser has used up; dark time gives it back."""
    most = limits.laser_max_on_s
    if most is None:
        return 0.0
    return used_s + elapsed_s if lit else max(0.0, used_s - elapsed_s * most / (limits.laser_period_s - most))

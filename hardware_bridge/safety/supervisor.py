"""The supervisor: the last before the wire. What it does not pass, no link sends."""

from __future__ import annotations

import math
from functools import partial

from coop_envs.agents.team import Team
from hardware_bridge.command import RobotCommand, SafeCommand, supervisors_seal
from hardware_bridge.safety import faults, motion
from hardware_bridge.safety.barrier import barrier
from hardware_bridge.safety.draft import Draft, Rule, body_of, nothing_happened
from hardware_bridge.safety.geofence import geofence, geofence_after_barrier
from hardware_bridge.safety.laser import interlock
from hardware_bridge.safety.limits import SafetyLimits
from hardware_bridge.safety.situation import Intervention, Situation
from hardware_bridge.safety.sound import taken

LONGEST_TICK_S = 0.1
"""A longer pause between ticks gives no more speed than this."""
FIRST_TICK_S = 1.0 / 30.0

Released = tuple[tuple[SafeCommand, ...], tuple[Intervention, ...]]


def rules_of(limits: SafetyLimits) -> tuple[Rule, ...]:
    """The chain of rules, in order.

    All faults come before geofence and barrier, which then know who stands.
    """
    fenced = limits.corners is not None
    chain: tuple[tuple[Rule, bool], ...] = (
        (faults.emergency_stop, True),
        (partial(faults.people, limits), True),
        (partial(faults.deadman, limits), True),
        (partial(faults.ranges, limits), True),
        (faults.lost, True),
        (partial(faults.silence, limits), True),
        (partial(faults.lost_pose, limits), True),
        (partial(faults.battery, limits), limits.battery_floor is not None),
        (faults.inchworm, limits.inchworm),
        (partial(geofence, limits), fenced),
        (partial(motion.speed, limits), True),
        (partial(barrier, limits), limits.barrier),
        (partial(geofence_after_barrier, limits), fenced and limits.barrier),
        (partial(motion.speed, limits), limits.barrier),
        (partial(motion.acceleration, limits), limits.max_accel_m_s2 is not None),
        (partial(interlock, limits), True),
    )
    return tuple(rule for rule, on in chain if on)


def stopped_commands(robots: int, brightness: float = 0.0) -> tuple[SafeCommand, ...]:
    """Everybody stands, hats dark or lit: what is sent before the first decision, and after the last."""
    return (SafeCommand(RobotCommand(brightness=brightness), supervisors_seal()),) * robots


class Supervisor:
    """Holds a team to its limits, tick by tick.

    Its answers are a function of limits, team and all calls so far: the same calls give the same answers, bit for bit.
    """

    def __init__(self, limits: SafetyLimits, team: Team) -> None:
        self._rules = rules_of(limits)
        self._bodies = tuple(body_of(member) for member in team.members)
        self._memory = nothing_happened(len(self._bodies))

    @property
    def estop_latched(self) -> bool:
        """Whether the e-stop holds everybody."""
        return self._memory.estop

    def release(self, time_s: float, wanted: tuple[RobotCommand, ...], situation: Situation) -> Released:
        """What the robots are told instead of what is wanted, and every reason why. Never raises.

        A robot that a fault stops is told exactly (0.0, 0.0), at once. Should a rule itself break, everybody stands.
        """
        draft = self._begun(time_s, wanted, situation)
        try:
            for rule in self._rules:
                draft = rule(draft)
        except Exception as error:  # noqa: BLE001 (whatever breaks here, robots must stand)
            for place in range(len(self._bodies)):
                draft = draft.stop(place, "broken", f"{type(error).__name__}: {error}")
        held = frozenset((told.robot, told.rule) for told in draft.interventions)
        wheels = tuple(command.wheels_rad_s for command in draft.commands)
        known_s = time_s if math.isfinite(time_s) else self._memory.time_s
        self._memory = draft.remember(time_s=known_s, held=held, wheels=wheels).memory
        seal = supervisors_seal()
        return tuple(SafeCommand(command, seal) for command in draft.commands), draft.interventions

    def _begun(self, time_s: float, wanted: object, situation: Situation) -> Draft:
        commands, reasons = taken(wanted, len(self._bodies))
        elapsed_s = _elapsed_s(time_s, self._memory.time_s)
        draft = Draft(time_s, elapsed_s, self._bodies, situation, self._memory, commands)
        for place, reason in enumerate(reasons):
            draft = draft.tell(place, "not a command", reason) if reason else draft
        return draft


def _elapsed_s(time_s: float, last_s: float | None) -> float:
    """Since the last tick; 0 where the clock jumps back or tells no time."""
    if not math.isfinite(time_s):
        return 0.0
    return FIRST_TICK_S if last_s is None else min(max(time_s - last_s, 0.0), LONGEST_TICK_S)

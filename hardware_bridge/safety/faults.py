"""Rules that stand a robot for a fault, or give it to a person: e-stop, silence, people, a lost pose, battery, loss.

Comparisons are written so that a value that is not a number counts as the fault.
"""

from __future__ import annotations

from hardware_bridge.safety.draft import Draft
from hardware_bridge.safety.limits import SafetyLimits
from hardware_bridge.safety.sound import clipped, taken


def emergency_stop(draft: Draft) -> Draft:
    """Latched: everybody stands from a press until a release that comes without a press."""
    now = draft.situation
    latched = bool(now.estop) or (draft.memory.estop and not now.release_estop)
    draft = draft.remember(estop=latched)
    if latched:
        reason = "the e-stop is pressed" if now.estop else "the e-stop is latched; release it"
        for place in range(len(draft.bodies)):
            draft = draft.stop(place, "e-stop", reason)
    return draft


def people(limits: SafetyLimits, draft: Draft) -> Draft:
    """A person's command replaces the policy's for the robots that the person drives.

    A robot taken over stays the person's: when the person falls silent it stands, and it goes back to the policy only
    when a person who is there no longer drives it.
    """
    now, count = draft.situation, len(draft.bodies)
    there = now.human is not None and 0 <= now.human_age_s <= limits.human_timeout_s
    entries = now.human if now.human is not None and len(now.human) == count else (None,) * count
    released = there and now.human is not None and len(now.human) == count
    drives = [entry is not None for entry in entries]
    driven = tuple(now_ or (was and not released) for now_, was in zip(drives, draft.memory.driven, strict=True))
    draft = draft.remember(driven=driven)
    for place, _, _ in draft.free():
        if not driven[place]:
            continue
        if not (there and drives[place]):
            silent = f"silent for {now.human_age_s:.2f} s, at most {limits.human_timeout_s} s"
            draft = draft.stop(place, "human silent", f"the person who drives it is {silent}")
            continue
        (command,), (fault,) = taken((entries[place],), 1)
        draft = draft.alter(place, "human", "a person drives it", command)
        draft = draft.stop(place, "not a command", fault) if fault else draft
    return draft


def deadman(limits: SafetyLimits, draft: Draft) -> Draft:
    """Robots that the policy drives stand while it is silent."""
    age = draft.situation.policy_age_s
    if age <= limits.deadman_s:
        return draft
    for place, _, robot in draft.free():
        if not draft.memory.driven[place] and robot.at_work:
            draft = draft.stop(place, "deadman", f"the policy is silent for {age:.2f} s, at most {limits.deadman_s} s")
    return draft


def ranges(limits: SafetyLimits, draft: Draft) -> Draft:
    """Brightness, laser and mirror are clipped to their ranges."""
    for place, _, _ in draft.robots:
        reason = f"brightness and laser within 0..1, mirror within {limits.max_galvo_counts} counts"
        draft = draft.alter(place, "range", reason, clipped(draft.commands[place], limits.max_galvo_counts))
    return draft


def lost(draft: Draft) -> Draft:
    """Robots that are lost, or wait in the dock, stand."""
    for place, _, robot in draft.free():
        if not robot.at_work:
            draft = draft.hold(place, "not at work", "it waits in the dock" if robot.docked else "it is declared lost")
    return draft


def silence(limits: SafetyLimits, draft: Draft) -> Draft:
    """Robots that do not report stand."""
    for place, _, robot in draft.free():
        if robot.at_work and not robot.sample_age_s <= limits.max_sample_age_s:
            reason = f"no report for {robot.sample_age_s:.2f} s, at most {limits.max_sample_age_s} s"
            draft = draft.stop(place, "silent robot", reason)
    return draft


def lost_pose(limits: SafetyLimits, draft: Draft) -> Draft:
    """Robots stand of which nobody knows where they are."""
    oldest, widest = limits.max_pose_age_s, limits.max_sigma_m
    for place, _, robot in draft.free():
        if not robot.at_work:
            continue
        if not robot.placed:
            draft = draft.stop(place, "no pose", "its pose is not finite")
        elif oldest is not None and not robot.pose_age_s <= oldest:
            draft = draft.stop(place, "old pose", f"no camera frame for {robot.pose_age_s:.2f} s, at most {oldest} s")
        elif widest is not None and not robot.sigma_m <= widest:
            draft = draft.stop(place, "vague pose", f"position known to {robot.sigma_m:.2f} m, at most {widest} m")
    return draft


def battery(limits: SafetyLimits, draft: Draft) -> Draft:
    """Robots stand below the floor, until they are above it by the hysteresis."""
    floor = limits.battery_floor
    assert floor is not None
    again = round(floor + limits.battery_hysteresis, 9)
    low = tuple(
        was if robot.battery is None else not robot.battery >= (again if was else floor)
        for was, robot in zip(draft.memory.low, draft.situation.robots, strict=True)
    )
    draft = draft.remember(low=low)
    for place, _, robot in draft.free():
        if low[place] and robot.at_work:
            share = "unknown" if robot.battery is None else f"{robot.battery:.0%}"
            draft = draft.stop(place, "battery", f"battery {share}, stands below {floor:.0%} until {again:.0%}")
    return draft


def inchworm(draft: Draft) -> Draft:
    """Robots stand that the inchworm rule does not let move; they may scan."""
    for place, _, robot in draft.free():
        if not robot.permitted:
            draft = draft.halt(place, "inchworm", "nobody who stands ties it to the ground")
    return draft

"""Limits of speed and acceleration: both wheels are scaled together, so the robot stays on its curve."""

from __future__ import annotations

from dataclasses import replace

from hardware_bridge.safety.draft import Draft
from hardware_bridge.safety.limits import SafetyLimits

ROUNDING = 1e-9
"""What is over a limit by less was scaled to it already."""


def speed(limits: SafetyLimits, draft: Draft) -> Draft:
    """No wheel's rim is faster than the robot may be, nor the turn."""
    for place, body, _ in draft.free():
        wheels = draft.commands[place].wheels_rad_s
        rim = max(abs(wheel) for wheel in wheels) * body.wheel_radius_m
        turn = abs(body.twist(wheels)[1])
        most_m_s = min(limits.max_speed_m_s, body.max_speed_m_s)
        most_rad_s = min(limits.max_yaw_rate_rad_s, body.max_yaw_rate_rad_s)
        reason = f"rim {rim:.2f} m/s, turn {turn:.2f} rad/s, at most {most_m_s} m/s, {most_rad_s} rad/s"
        factor = min(1.0, most_m_s / max(rim, most_m_s), most_rad_s / max(turn, most_rad_s))
        draft = _scaled(draft, place, factor, "speed", reason)
    return draft


def acceleration(limits: SafetyLimits, draft: Draft) -> Draft:
    """No wheel's rim gains speed faster than allowed. To lose speed, or to stop, never waits."""
    most = limits.max_accel_m_s2
    assert most is not None
    for place, body, _ in draft.free():
        step = most * draft.elapsed_s / body.wheel_radius_m
        factor = 1.0
        for wheel, was in zip(draft.commands[place].wheels_rad_s, draft.memory.wheels[place], strict=True):
            same_way = abs(was) if wheel * was > 0 else 0.0
            if abs(wheel) > same_way + step:
                factor = min(factor, (same_way + step) / abs(wheel))
        reason = f"rim gains at most {most} m/s^2, {most * draft.elapsed_s:.3f} m/s in this tick"
        draft = _scaled(draft, place, factor, "acceleration", reason)
    return draft


def _scaled(draft: Draft, place: int, factor: float, rule: str, reason: str) -> Draft:
    if factor >= 1.0 - ROUNDING:
        return draft
    left, right = draft.commands[place].wheels_rad_s
    return draft.alter(
        place, rule, reason, replace(draft.commands[place], wheels_rad_s=(left * factor + 0.0, right * factor + 0.0))
    )

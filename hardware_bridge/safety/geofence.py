"""The geofence: no robot drives out of it; one outside may drive back and turn on the spot."""

from __future__ import annotations

import math
from dataclasses import replace

from hardware_bridge.reading import Pair
from hardware_bridge.safety.draft import Body, Draft
from hardware_bridge.safety.limits import SafetyLimits
from hardware_bridge.safety.polygon import Point, depth
from hardware_bridge.safety.situation import RobotSituation

STEPS = 8
"""Points along the path ahead that are looked at."""


def geofence(limits: SafetyLimits, draft: Draft) -> Draft:
    """Robots about to leave lose their forward speed and keep their turn."""
    for place, body, robot in draft.free():
        wheels = draft.commands[place].wheels_rad_s
        reason = _leaving(limits, body, robot, wheels)
        if reason:
            left, right = wheels
            turn = 0.5 * (right - left)
            after = replace(draft.commands[place], wheels_rad_s=(0.0 - turn, turn))
            draft = draft.alter(place, "geofence", reason, after)
    return draft


def geofence_after_barrier(limits: SafetyLimits, draft: Draft) -> Draft:
    """Robots that the barrier would steer out stand."""
    for place, body, robot in draft.free():
        reason = _leaving(limits, body, robot, draft.commands[place].wheels_rad_s)
        if reason:
            draft = draft.halt(place, "geofence", reason)
    return draft


def path_ahead(position_m: Point, yaw_rad: float, twist: Pair, ahead_s: float) -> list[Point]:
    """Where a unicycle with this speed (m/s) and yaw rate (rad/s) comes past, the end last."""
    speed, yaw_rate = twist
    points = []
    for k in range(1, STEPS + 1):
        time = ahead_s * k / STEPS
        half = 0.5 * yaw_rate * time
        chord = speed * time * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        heading = yaw_rad + half
        points.append((position_m[0] + chord * math.cos(heading), position_m[1] + chord * math.sin(heading)))
    return points


def _leaving(limits: SafetyLimits, body: Body, robot: RobotSituation, wheels: Pair) -> str:
    """Why a robot may not go on like this; nothing where it may."""
    corners = limits.corners
    assert corners is not None
    speed, yaw_rate = body.twist(wheels)
    if speed == 0.0 or not robot.placed:
        return ""
    needed = body.radius_m + limits.geofence_margin_m + min(limits.sigmas * robot.sigma_m, limits.most_sigma_margin_m)
    now = depth(corners, robot.position_m)
    ahead = [
        depth(corners, p) for p in path_ahead(robot.position_m, robot.yaw_rad, (speed, yaw_rate), limits.look_ahead_s)
    ]
    lowest = min(ahead)
    inside = lowest >= needed
    back = now < needed and lowest >= now and ahead[-1] > now
    return (
        ""
        if inside or back
        else f"in {limits.look_ahead_s} s it would be {_place(lowest)}, at least {needed:.2f} m inside"
    )


def _place(depth_m: float) -> str:
    return f"{abs(depth_m):.2f} m {'inside' if depth_m >= 0 else 'outside'}"

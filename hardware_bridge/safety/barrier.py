"""The collision barrier: no two bodies come closer than their safety distance, whatever they are told.

Each robot is steered by a point ``projection_m`` ahead of its axle, which can move in every direction. With d the
distance of two robots' points, n the direction to the other, and D the distance to keep, the point's velocity u obeys

    n . u <= share * gain * max(d - D, 0)

for every other robot: one half each where both may move, the whole where the other stands. The wanted velocity goes to
the nearest that obeys. Standing always obeys, so there is always a solution, nobody is made to move who stands, and
nobody gets faster than wanted; robots that obey already are left as they are, bit for bit. As a point is up to
``projection_m`` from its robot's centre, D adds that for each of the two.

A loop that lags by tau closes a gap without overshoot for gain <= 1 / (4 tau), so that is the gain, with tau the
drive's lag and ``reaction_s``. A robot that turns goes elsewhere than a late command thought. So with no gap left it
turns by at most `FARTHEST_TURN_RAD` in tau; and where two centres come within half a margin of their safety distance,
only velocities that lead away by an angle are left, growing to `STEEPEST_RAD` where half the margin is used up. Robots
that were set down closer than that are held as far apart as they have ever been. Drives slower than their
specification, or poses later than ``reaction_s``, eat into the margin.

Source: control barrier functions for unicycles as in the Robotarium (Wilson et al. 2020), with the constraint of each
pair shared between its robots so that each solves a problem in two variables, here in closed form.
"""

from __future__ import annotations

import math
from dataclasses import replace

from hardware_bridge.reading import Pair
from hardware_bridge.safety.draft import Body, Draft
from hardware_bridge.safety.limits import SafetyLimits
from hardware_bridge.safety.situation import RobotSituation

STEEPEST_RAD = 1.3
FARTHEST_TURN_RAD = 0.25
SLACK = 1e-12
CREEP_M_S = 1e-4
"""What the barrier leaves below this is standing."""

Placed = tuple[Body, RobotSituation]
HalfPlane = tuple[float, float, float]
"""(a, b, c): velocities with a u + b v <= c; (a, b) of length 1, c at least 0."""


def barrier(limits: SafetyLimits, draft: Draft) -> Draft:
    """Slow and turn robots that would come too close to another."""
    robots, commands, apart_m = draft.robots, draft.commands, _held_apart(limits, draft)
    draft = draft.remember(apart_m=apart_m)
    moving = [not commands[place].stands or not robot.stationary for place, _, robot in robots]
    for place, body, robot in draft.free():
        one, wheels = (body, robot), commands[place].wheels_rad_s
        others = [(k, (b, r)) for k, b, r in robots if k != place and r.placed and not r.docked]
        if commands[place].stands or not robot.placed or not others:
            continue
        planes = [p for k, o in others for p in _half_planes(limits, one, o, moving[k], apart_m[place][k])]
        steered = _steered(limits, body, robot.yaw_rad, wheels, planes)
        if steered != wheels:
            gap, name = min((_centres_m(one, o) - body.radius_m - o[0].radius_m, o[0].name) for _, o in others)
            reason = f"{gap:.2f} m from {name}, keeps {limits.barrier_margin_m} m"
            draft = draft.alter(place, "barrier", reason, replace(commands[place], wheels_rad_s=steered))
    return draft


def nearest(wanted: Pair, planes: list[HalfPlane]) -> Pair:
    """The velocity nearest to the wanted one that obeys every half-plane; each of them holds the origin.

    The solution in the plane is the wanted velocity, its foot on one line, or where two lines cross.
    """
    if _obeys(wanted, planes):
        return wanted
    candidates = [(0.0, 0.0)]
    for k, (a, b, c) in enumerate(planes):
        over = a * wanted[0] + b * wanted[1] - c
        candidates.append((wanted[0] - over * a, wanted[1] - over * b))
        for a2, b2, c2 in planes[:k]:
            cross = a * b2 - b * a2
            if abs(cross) > 1e-9:
                candidates.append(((c * b2 - b * c2) / cross, (a * c2 - c * a2) / cross))
    return min((u for u in candidates if _obeys(u, planes)), key=lambda u: math.dist(u, wanted))


def _steered(limits: SafetyLimits, body: Body, yaw_rad: float, wheels: Pair, planes: list[HalfPlane]) -> Pair:
    """Wheel speeds that obey; the same where these do."""
    wanted = to_point(body, yaw_rad, limits.projection_m, wheels)
    allowed = nearest(wanted, planes)
    if allowed != wanted:
        wheels = from_point(body, yaw_rad, limits.projection_m, allowed)
    turn = abs(body.twist(wheels)[1]) * _late_s(limits, body)
    if turn > FARTHEST_TURN_RAD and any(c == 0.0 for _, _, c in planes):
        wheels = wheels[0] * FARTHEST_TURN_RAD / turn, wheels[1] * FARTHEST_TURN_RAD / turn
    return wheels


def to_point(body: Body, yaw_rad: float, projection_m: float, wheels: Pair) -> Pair:
    """Velocity (m/s, team frame) of the point ahead of the axle."""
    speed, yaw_rate = body.twist(wheels)
    c, s, across = math.cos(yaw_rad), math.sin(yaw_rad), projection_m * yaw_rate
    return c * speed - s * across, s * speed + c * across


def from_point(body: Body, yaw_rad: float, projection_m: float, velocity: Pair) -> Pair:
    """Wheel speeds that give the point this velocity."""
    if math.hypot(*velocity) < CREEP_M_S:
        return 0.0, 0.0
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return body.wheels(c * velocity[0] + s * velocity[1], (c * velocity[1] - s * velocity[0]) / projection_m)


def keep_m(limits: SafetyLimits, one: Placed, other: Placed) -> float:
    """How far apart the centres of two robots stay (m)."""
    sigma = math.hypot(one[1].sigma_m, other[1].sigma_m)
    unsure = (
        min(limits.sigmas * sigma, limits.most_sigma_margin_m) if math.isfinite(sigma) else limits.most_sigma_margin_m
    )
    return one[0].radius_m + other[0].radius_m + limits.barrier_margin_m + unsure


def _held_apart(limits: SafetyLimits, draft: Draft) -> tuple[tuple[float, ...], ...]:
    """For each two robots the distance (m) below which they are turned away from each other."""

    def held(one: Placed, other: Placed, before_m: float) -> float:
        if not (one[1].placed and other[1].placed) or one[1].docked or other[1].docked:
            return 0.0
        farthest = max(before_m, _centres_m(one, other))
        return min(farthest, keep_m(limits, one, other) + 0.5 * limits.barrier_margin_m)

    everybody = [(body, robot) for _, body, robot in draft.robots]
    return tuple(
        tuple(held(one, other, before_m) for other, before_m in zip(everybody, row, strict=True))
        for one, row in zip(everybody, draft.memory.apart_m, strict=True)
    )


def _half_planes(limits: SafetyLimits, one: Placed, other: Placed, moves: bool, apart_m: float) -> list[HalfPlane]:
    """What another robot leaves to this one."""
    (body, robot), (_, obstacle) = one, other
    here, there = _point(robot, limits.projection_m), _point(obstacle, limits.projection_m)
    towards = math.atan2(there[1] - here[1], there[0] - here[0])
    missing = apart_m - _centres_m(one, other)
    if missing > 0.0:
        steep = STEEPEST_RAD * min(1.0, missing / max(limits.barrier_margin_m, SLACK))
        return [(math.cos(towards + turn), math.sin(towards + turn), 0.0) for turn in (-steep, steep)]
    free_m = math.dist(here, there) - keep_m(limits, one, other) - 2.0 * limits.projection_m
    gain = 0.25 / _late_s(limits, body)
    closing = (0.5 if moves else 1.0) * gain * max(free_m, 0.0)
    return [(math.cos(towards), math.sin(towards), closing)]


def _late_s(limits: SafetyLimits, body: Body) -> float:
    """How long a motion goes on before a command changes it."""
    return body.drive_lag_s + limits.reaction_s


def _centres_m(one: Placed, other: Placed) -> float:
    return math.dist(one[1].position_m, other[1].position_m)


def _point(robot: RobotSituation, ahead_m: float) -> Pair:
    x, y = robot.position_m
    return x + ahead_m * math.cos(robot.yaw_rad), y + ahead_m * math.sin(robot.yaw_rad)


def _obeys(velocity: Pair, planes: list[HalfPlane]) -> bool:
    return all(a * velocity[0] + b * velocity[1] <= c + SLACK for a, b, c in planes)

"""A robot as a disc with two driven sides on uneven ground: drive, slip, slope, steps, walls, other robots.

Wheel speeds follow their set-points with a first-order lag; each side slips by a relative amount that wanders (a
first-order Gauss-Markov process). Where walls or other robots are in the way, the motion into them is removed, the
rest stays.
"""

from __future__ import annotations

import warp as wp

from coop_envs.geometry.so3 import stand_on, wrap
from coop_envs.geometry.terrain import Terrain
from coop_envs.simulation.footing import Footing, foot_point, footing
from coop_envs.simulation.hazards import motion_scale
from coop_envs.simulation.parameters import Hazards, RobotModel
from coop_envs.simulation.state import ACTIVE, DOCKED, FALLEN, SWALLOWED, State

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

SLIDE_M_S = wp.constant(1.0)  # assumed: speed of a slide with no grip at all down a vertical slope

AS_WANTED, ALONG_WALL, NOWHERE = (wp.constant(k) for k in range(3))


@wp.struct
class Ground:
    """What all robots of a batch stand on."""

    terrain: Terrain
    hazards: Hazards
    friction: float


@wp.func
def without_approach(step: wp.vec2, towards: wp.vec2) -> wp.vec2:
    """A step less its component towards an obstacle."""
    length = wp.length(towards)
    if length < 1.0e-6:
        return step
    n = towards / length
    return step - n * wp.max(wp.dot(step, n), 0.0)


@wp.func
def ground_motion(
    model: RobotModel, wheels: wp.vec2, slip: wp.vec2, scale: float, R: wp.mat33, friction: float
) -> wp.vec3:
    """Forward speed, leftward speed and yaw rate on the ground from wheel speeds, slip and slope.

    Going uphill loses ``slope_slip`` times the grade; across a slope the robot crabs downhill by the same share of its
    speed; beyond its slope limit it gains no height, beyond the friction angle it slides.
    Source: thesis eq (6.10), counter-clockwise positive.
    """
    left = model.wheel_radius * wheels[0] * (1.0 - slip[0]) * scale
    right = model.wheel_radius * wheels[1] * (1.0 - slip[1]) * scale
    forward = 0.5 * (left + right)
    climb = R[2, 0]
    lean = R[2, 1]
    if forward * climb > 0.0:
        forward = forward * (1.0 - wp.min(model.slope_slip * wp.abs(climb), 1.0))
        if wp.abs(climb) > model.max_climb:
            forward = 0.0
    sideways = -model.slope_slip * lean * wp.abs(forward)
    steepness = wp.sqrt(climb * climb + lean * lean)
    grip = friction * R[2, 2]
    if steepness > grip:
        excess = (steepness - grip) / steepness
        forward = forward - climb * excess * SLIDE_M_S
        sideways = sideways - lean * excess * SLIDE_M_S
    return wp.vec3(forward, sideways, (right - left) / model.track)


@wp.func
def present(state: State, b: int, r: int) -> bool:
    """Whether a robot stands in the world, to be seen and in the way."""
    status = state.status[b, r]
    return status != DOCKED and status != SWALLOWED and state.collected[b, r] == 0


@wp.func
def between(state: State, robots: wp.array[RobotModel], b: int, o: int, foot: wp.vec2) -> wp.vec2:
    """From a point on the ground to where robot o stands."""
    other = foot_point(state.position[b, o], state.rotation[b, o], robots[o].body_height)
    return wp.vec2(other[0], other[1]) - foot


@wp.func
def pushes(state: State, robots: wp.array[RobotModel], b: int, r: int, o: int, foot: wp.vec2, step: wp.vec2) -> bool:
    """Whether a step of robot r would bring it closer to robot o than their bodies allow."""
    if o == r or not present(state, b, o):
        return False
    gap = between(state, robots, b, o, foot)
    return wp.dot(step, gap) > 1.0e-8 and wp.length(gap - step) < robots[r].body_radius + robots[o].body_radius


@wp.func
def around_robots(state: State, robots: wp.array[RobotModel], b: int, r: int, foot: wp.vec2, step: wp.vec2) -> wp.vec2:
    """A step less what would push into another robot."""
    free = step
    for o in range(robots.shape[0]):
        if pushes(state, robots, b, r, o, foot, free):
            free = without_approach(free, between(state, robots, b, o, foot))
    return free


@wp.func
def pushes_any(state: State, robots: wp.array[RobotModel], b: int, r: int, foot: wp.vec2, step: wp.vec2) -> bool:
    """Whether a step of robot r would push into any other robot."""
    found = bool(False)
    for o in range(robots.shape[0]):
        found = found or pushes(state, robots, b, r, o, foot, step)
    return found


@wp.func
def drive(state: State, robots: wp.array[RobotModel], ground: Ground, b: int, r: int, dt: float):
    """Move one active robot for one substep, in place; it may fall."""
    model = robots[r]
    w = state.world[b]
    R = state.rotation[b, r]
    up = wp.vec3(R[0, 2], R[1, 2], R[2, 2])
    foot = foot_point(state.position[b, r], R, model.body_height)
    at = wp.vec2(foot[0], foot[1])
    scale = motion_scale(ground.hazards, w, at[0], at[1])
    motion = ground_motion(model, state.wheels[b, r], state.slip[b, r], scale, R, ground.friction)
    turn = motion[2] * dt * up[2] / (R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0])
    facing = stand_on(up, state.yaw[b, r] + 0.5 * turn)
    velocity = facing * wp.vec3(motion[0], motion[1], 0.0)
    wanted = wp.vec2(velocity[0], velocity[1]) * dt
    step = around_robots(state, robots, b, r, at, wanted)
    stand = Footing()
    way = int(AS_WANTED)
    trying = bool(True)
    while trying:
        stand = footing(ground.terrain, w, model, at + step, foot[2], up)
        into = wp.dot(step, stand.wall)
        stuck = stand.missing == 1 or into > 1.0e-7
        if way == AS_WANTED and into > 0.0:
            step = without_approach(step, stand.wall)
            way = ALONG_WALL
        elif way != NOWHERE and (
            stuck or (wp.length(step - wanted) > 0.0 and pushes_any(state, robots, b, r, at, step))
        ):
            step = wp.vec2(0.0, 0.0)
            way = NOWHERE
        else:
            trying = bool(False)
    yaw = wrap(state.yaw[b, r] + turn)
    now = at + step
    state.yaw[b, r] = yaw
    state.position[b, r] = wp.vec3(now[0], now[1], stand.height) + stand.normal * model.body_height
    state.rotation[b, r] = stand_on(stand.normal, yaw)
    if stand.falls == 1 or stand.normal[2] < model.upright:
        state.rotation[b, r] = stand_on(-stand.normal, yaw)
        state.status[b, r] = FALLEN


@wp.func
def spin_wheels(state: State, model: RobotModel, b: int, r: int, set_point: wp.vec2, dt: float):
    """Let the wheels follow their set-point for one substep; below 1 mrad/s, or 50 told to stand, they stand."""
    wheels = state.wheels[b, r]
    wheels = wheels + (set_point - wheels) * (1.0 - wp.exp(-dt / model.lag))
    if wp.length(wheels) < 1.0e-3 or (wp.length(set_point) == 0.0 and wp.length(wheels) < 0.05):
        wheels = wp.vec2(0.0, 0.0)
    state.wheels[b, r] = wheels


@wp.func
def restless(state: State, friction: float, b: int, r: int) -> bool:
    """Whether a robot has to be moved at all: its wheels turn, or it slides."""
    if state.status[b, r] != ACTIVE:
        return False
    upright = state.rotation[b, r][2, 2]
    return wp.length(state.wheels[b, r]) > 0.0 or upright * upright * (1.0 + friction * friction) < 1.0

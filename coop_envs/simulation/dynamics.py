"""A robot as a disc with two driven sides on uneven ground: drive, slip, slope, steps, walls, other robots.

Wheel speeds follow their set-points with a first-order lag; each side slips by a relative amount that wanders (a
first-order Gauss-Markov process). The disc rests on the plane through the ground under its rim; a rise above the
robot's step limit, or missing ground, blocks it as a wall does: the motion into it is removed, the rest stays.
"""

from __future__ import annotations

import warp as wp

from coop_envs.geometry.so3 import stand_on, wrap
from coop_envs.geometry.terrain import Terrain, ground_height
from coop_envs.simulation.hazards import motion_scale
from coop_envs.simulation.parameters import Hazards, RobotModel
from coop_envs.simulation.state import ACTIVE, DOCKED, FALLEN, SWALLOWED, State

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

RIM_POINTS = wp.constant(12)
RIM_STEP = wp.constant(0.5235987755982988)
ABYSS = wp.constant(-100.0)


@wp.struct
class Ground:
    """What all robots of a batch stand on."""

    terrain: Terrain
    hazards: Hazards
    friction: float


@wp.struct
class Footing:
    """What a disc stands on: height and unit normal of the fitted plane, the sum of directions that are blocked."""

    height: float
    normal: wp.vec3
    wall: wp.vec2
    missing: int


@wp.func
def footing(terrain: Terrain, w: int, model: RobotModel, at: wp.vec2, below: float) -> Footing:
    """Footing at a point for a robot that has stood at height ``below`` so far."""
    foot = Footing()
    centre = ground_height(terrain, w, at[0], at[1])
    if centre < ABYSS or centre - below > model.max_step:
        foot.missing = 1
        foot.height = below
        foot.normal = wp.vec3(0.0, 0.0, 1.0)
        return foot
    total = centre
    count = float(1.0)
    tilt = wp.vec2(0.0, 0.0)
    for k in range(RIM_POINTS):
        ray = wp.vec2(wp.cos(float(k) * RIM_STEP), wp.sin(float(k) * RIM_STEP))
        rim = at + ray * model.body_radius
        h = ground_height(terrain, w, rim[0], rim[1])
        if h - below > model.max_step or h < ABYSS:
            foot.wall = foot.wall + ray
        else:
            if h - below < -model.max_drop:
                h = centre
            total = total + h
            count = count + 1.0
            tilt = tilt + ray * (h - centre)
    foot.height = total / count
    slope = tilt * (2.0 / (float(RIM_POINTS) * model.body_radius))
    foot.normal = wp.normalize(wp.vec3(-slope[0], -slope[1], 1.0))
    return foot


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
        if wp.abs(climb) > wp.sin(model.max_slope):
            forward = 0.0
    sideways = -model.slope_slip * lean * wp.abs(forward)
    steepness = wp.sqrt(climb * climb + lean * lean)
    grip = friction * R[2, 2]
    if steepness > grip:
        excess = (steepness - grip) / steepness
        forward = forward - climb * excess
        sideways = sideways - lean * excess
    return wp.vec3(forward, sideways, (right - left) / model.track)


@wp.func
def present(state: State, b: int, r: int) -> bool:
    """Whether a robot stands in the world, to be seen and in the way."""
    status = state.status[b, r]
    return status != DOCKED and status != SWALLOWED and state.collected[b, r] == 0


@wp.func
def around_robots(
    state: State, robots: wp.array(dtype=RobotModel), b: int, r: int, foot: wp.vec2, step: wp.vec2
) -> wp.vec2:
    """A step less what would push into another robot."""
    free = step
    for o in range(robots.shape[0]):
        if o != r and present(state, b, o):
            other = state.position[b, o]
            gap = wp.vec2(other[0], other[1]) - foot
            if wp.length(gap - free) < robots[r].body_radius + robots[o].body_radius:
                free = without_approach(free, gap)
    return free


@wp.func
def foot_point(position: wp.vec3, R: wp.mat33, body_height: float) -> wp.vec3:
    """The point on the ground under the body's origin, along its own z axis."""
    return position - wp.vec3(R[0, 2], R[1, 2], R[2, 2]) * body_height


@wp.func
def drive(state: State, robots: wp.array(dtype=RobotModel), ground: Ground, b: int, r: int, dt: float):
    """Move one active robot for one substep, in place; it may fall."""
    model = robots[r]
    w = state.world[b]
    R = state.rotation[b, r]
    foot = foot_point(state.position[b, r], R, model.body_height)
    at = wp.vec2(foot[0], foot[1])
    scale = motion_scale(ground.hazards, w, at[0], at[1])
    motion = ground_motion(model, state.wheels[b, r], state.slip[b, r], scale, R, ground.friction)
    middle = state.yaw[b, r] + 0.5 * motion[2] * dt
    level = wp.length(wp.vec2(R[0, 0], R[1, 0]))
    c = wp.cos(middle)
    s = wp.sin(middle)
    step = wp.vec2(motion[0] * level * c - motion[1] * s, motion[0] * level * s + motion[1] * c) * dt
    step = around_robots(state, robots, b, r, at, step)
    stand = footing(ground.terrain, w, model, at + step, foot[2])
    if wp.dot(step, stand.wall) > 0.0:
        step = without_approach(step, stand.wall)
        stand = footing(ground.terrain, w, model, at + step, foot[2])
    if stand.missing == 1 or wp.dot(step, stand.wall) > 1.0e-7:
        step = wp.vec2(0.0, 0.0)
        stand = footing(ground.terrain, w, model, at, foot[2])
    yaw = wrap(state.yaw[b, r] + motion[2] * dt)
    now = at + step
    state.yaw[b, r] = yaw
    state.position[b, r] = wp.vec3(now[0], now[1], stand.height) + stand.normal * model.body_height
    state.rotation[b, r] = stand_on(stand.normal, yaw)
    if foot[2] - stand.height > model.max_drop or stand.normal[2] < wp.cos(model.tip_slope):
        state.rotation[b, r] = stand_on(-stand.normal, yaw)
        state.status[b, r] = FALLEN


@wp.func
def spin_wheels(state: State, model: RobotModel, b: int, r: int, set_point: wp.vec2, dt: float):
    """Let the wheels follow their set-point for one substep; below 1 mrad/s they stand."""
    wheels = state.wheels[b, r]
    wheels = wheels + (set_point - wheels) * (1.0 - wp.exp(-dt / model.lag))
    if wp.length(wheels) < 1.0e-3 or (wp.length(set_point) == 0.0 and wp.length(wheels) < 0.05):
        wheels = wp.vec2(0.0, 0.0)
    state.wheels[b, r] = wheels


@wp.func
def restless(state: State, b: int, r: int) -> bool:
    """Whether a robot has to be moved at all: wheels turn or it may slide."""
    return state.status[b, r] == ACTIVE and (wp.length(state.wheels[b, r]) > 0.0 or state.rotation[b, r][2, 2] < 0.99)

"""Place the robots of the teams that start anew, and let reserves out of their dock."""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.geometry.keyed_random import draw_key, normal2, normal3
from coop_envs.geometry.so3 import stand_on
from coop_envs.geometry.terrain import ground_height
from coop_envs.simulation.dynamics import Ground, present
from coop_envs.simulation.footing import footing
from coop_envs.simulation.parameters import RobotModel
from coop_envs.simulation.state import ACTIVE, DOCKED, State

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

PLACE_CHANNEL = wp.constant(32)
BIAS_CHANNEL = wp.constant(34)


@wp.struct
class Starts:
    """Start poses (x, y, yaw) of robots by world (W, N), of the docks (W,), and how exactly people place robots."""

    pose: wp.array2d[wp.vec3]
    dock: wp.array[wp.vec3]
    position_sigma: float
    yaw_sigma: float


@wp.struct
class Starting:
    """Which teams start anew (1), and each one's key of random numbers and world. (B,)"""

    chosen: wp.array[int]
    key: wp.array[wp.uint64]
    world: wp.array[int]


@wp.func
def stand_at(state: State, model: RobotModel, ground: Ground, b: int, r: int, pose: wp.vec3):
    """Set a robot down at rest at x, y, yaw."""
    at = wp.vec2(pose[0], pose[1])
    w = state.world[b]
    height = ground_height(ground.terrain, w, at[0], at[1])
    stand = footing(ground.terrain, w, model, at, height, wp.vec3(0.0, 0.0, 1.0))
    stand = footing(ground.terrain, w, model, at, stand.height, stand.normal)
    state.position[b, r] = wp.vec3(at[0], at[1], stand.height) + stand.normal * model.body_height
    state.rotation[b, r] = stand_on(stand.normal, pose[2])
    state.yaw[b, r] = pose[2]
    state.velocity[b, r] = wp.vec3(0.0, 0.0, 0.0)
    state.wheels[b, r] = wp.vec2(0.0, 0.0)


@wp.kernel
def place_teams(
    state: State, robots: wp.array[RobotModel], starts: Starts, ground: Ground, starting: Starting,
):  # fmt: skip
    """Start the chosen teams anew in their worlds. The first observer defines the team frame, so it stands exactly."""
    b = wp.tid()
    if starting.chosen[b] == 0:
        return
    w = starting.world[b]
    key = starting.key[b]
    state.key[b] = key
    state.world[b] = w
    state.tick[b] = 0
    for r in range(robots.shape[0]):
        model = robots[r]
        pose = starts.pose[w, r]
        if r > 0:
            a = normal2(draw_key(key, 0, r, PLACE_CHANNEL)) * starts.position_sigma
            turn = normal2(draw_key(key, 0, r, PLACE_CHANNEL + 1))
            pose = pose + wp.vec3(a[0], a[1], turn[0] * starts.yaw_sigma)
        stand_at(state, model, ground, b, r, pose)
        state.status[b, r] = ACTIVE
        state.collected[b, r] = 0
        if model.reserve == 1:
            state.status[b, r] = DOCKED
        state.slip[b, r] = normal2(draw_key(key, 0, r, PLACE_CHANNEL + 2)) * model.slip
        for t in range(state.mirror.shape[2]):
            state.mirror[b, r, t] = wp.vec2(0.0, 0.0)
        state.mirror_left[b, r] = wp.vec2(0.0, 0.0)
        state.energy[b, r] = wp.vec4d()
        state.path[b, r] = 0.0
        state.gyro_bias[b, r] = normal3(key, 0, r, BIAS_CHANNEL + 1) * model.gyro_bias
        state.accel_bias[b, r] = normal3(key, 0, r, BIAS_CHANNEL + 3) * model.accel_bias
    first = state.position[b, 0]
    state.frame[b] = wp.vec4(first[0], first[1], first[2], state.yaw[b, 0])


@wp.kernel
def serve_dock(
    state: State, command: Command, robots: wp.array[RobotModel], starts: Starts, ground: Ground,
    running: wp.array[int],
):  # fmt: skip
    """Take away the robots to be collected; put reserves that are called before the dock once nobody stands there."""
    b = wp.tid()
    if running[b] == 0:
        return
    for r in range(robots.shape[0]):
        if command.collect[b, r] == 1:
            state.collected[b, r] = 1
        if state.status[b, r] == DOCKED and command.undock[b, r] == 1:
            pose = starts.dock[state.world[b]]
            free = bool(True)
            for o in range(robots.shape[0]):
                gap = wp.length(wp.vec2(state.position[b, o][0] - pose[0], state.position[b, o][1] - pose[1]))
                if present(state, b, o) and gap < robots[o].body_radius + robots[r].body_radius:
                    free = bool(False)
            if free:
                a = normal2(draw_key(state.key[b], state.tick[b], r, PLACE_CHANNEL)) * starts.position_sigma
                turn = normal2(draw_key(state.key[b], state.tick[b], r, PLACE_CHANNEL + 1))
                stand_at(state, robots[r], ground, b, r, pose + wp.vec3(a[0], a[1], turn[0] * starts.yaw_sigma))
                state.status[b, r] = ACTIVE

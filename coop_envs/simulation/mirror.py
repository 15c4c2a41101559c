"""The laser's mirror in truth: motors that run for whole counts, without feedback, until an end stop."""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.agents.raster import LaserModel
from coop_envs.geometry.keyed_random import draw_key, normal2
from coop_envs.simulation.state import State

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

MIRROR_CHANNEL = wp.constant(11)
STOPPED_S = wp.constant(1.0e-4)


@wp.func
def turn_mirror(
    state: State, command: Command, laser: LaserModel, b: int, r: int, t: int, tick_s: float
) -> float:  # fmt: skip
    """Turn the mirror for one tick; the share of it in which its motors ran. A move is heeded once both stand."""
    ticks = state.mirror.shape[2]
    mirror = state.mirror[b, r, (t + ticks - 1) % ticks]
    left = state.mirror_left[b, r]
    counts = command.galvo[b, r, t]
    if laser.fitted == 1 and left[0] == 0.0 and left[1] == 0.0:
        left = wp.vec2(float(counts[0]), float(counts[1])) * laser.count_s
    longest = float(0.0)
    if left[0] != 0.0 or left[1] != 0.0:
        noise = normal2(draw_key(state.key[b], state.tick[b] + t, r, MIRROR_CHANNEL)) * laser.move_noise
        for axis in range(2):
            run = wp.clamp(left[axis], -tick_s, tick_s)
            turned = run / laser.count_s * laser.count_rad * (1.0 + noise[axis])
            mirror[axis] = wp.clamp(mirror[axis] + turned, -laser.limit_rad, laser.limit_rad)
            left[axis] = left[axis] - run
            if wp.abs(left[axis]) < STOPPED_S:
                left[axis] = 0.0
            longest = wp.max(longest, wp.abs(run))
    state.mirror[b, r, t] = mirror
    state.mirror_left[b, r] = left
    return longest / tick_s

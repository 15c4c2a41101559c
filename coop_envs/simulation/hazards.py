"""Signed distance to a hazard's edge: a rectangle rounded by a radius, as in `worlds.world.Hazard`."""

from __future__ import annotations

import warp as wp

from coop_envs.simulation.parameters import SLIPPERY, Hazards

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.func
def hazard_distance(hazards: Hazards, k: int, x: float, y: float) -> float:
    """Distance from (x, y) to the edge of hazard k in metres, negative inside."""
    d = wp.vec2(x, y) - hazards.centre[k]
    a = hazards.axis[k]
    u = wp.abs(a[0] * d[0] + a[1] * d[1]) - hazards.half_size[k][0]
    v = wp.abs(a[0] * d[1] - a[1] * d[0]) - hazards.half_size[k][1]
    outside = wp.length(wp.vec2(wp.max(u, 0.0), wp.max(v, 0.0)))
    return outside + wp.min(wp.max(u, v), 0.0) - hazards.radius[k]


@wp.func
def motion_scale(hazards: Hazards, w: int, x: float, y: float) -> float:
    """How much of the commanded motion the ground at (x, y) gives: 1, or less on a slippery patch."""
    scale = float(1.0)
    for k in range(hazards.first[w], hazards.first[w + 1]):
        if hazards.kind[k] == SLIPPERY and hazard_distance(hazards, k, x, y) < 0.0:
            scale = wp.min(scale, hazards.motion_scale[k])
    return scale

"""Kernels that call the Warp functions of `coop_envs.geometry` on arrays, and `on_device` to run them."""

from __future__ import annotations

import numpy as np
import warp as wp

from coop_envs.device import prepare
from coop_envs.geometry.keyed_random import draw_key, mix64, normal2, normal3, uniform
from coop_envs.geometry.so3 import exp_so3, heading, log_so3, orthonormal, stand_on, wrap
from coop_envs.geometry.terrain import Terrain, blocked, cast_ray, ground_height

wp.set_module_options({"enable_backward": False})


@wp.kernel
def mixed(x: wp.array[wp.uint64], out: wp.array[wp.uint64]):
    i = wp.tid()
    out[i] = mix64(x[i])


@wp.kernel
def keys(team: wp.array[wp.uint64], place: wp.array[wp.vec3i], out: wp.array[wp.uint64]):
    i = wp.tid()
    out[i] = draw_key(team[i], place[i][0], place[i][1], place[i][2])


@wp.kernel
def uniforms(key: wp.array[wp.uint64], out: wp.array[float]):
    i = wp.tid()
    out[i] = uniform(key[i])


@wp.kernel
def pairs(key: wp.array[wp.uint64], out: wp.array[wp.vec2]):
    i = wp.tid()
    out[i] = normal2(key[i])


@wp.kernel
def triples(team: wp.array[wp.uint64], place: wp.array[wp.vec3i], out: wp.array[wp.vec3]):
    i = wp.tid()
    out[i] = normal3(team[i], place[i][0], place[i][1], place[i][2])


@wp.kernel
def exponentials(w: wp.array[wp.vec3d], out: wp.array[wp.mat33d]):
    i = wp.tid()
    out[i] = exp_so3(w[i])


@wp.kernel
def logarithms(r: wp.array[wp.mat33d], out: wp.array[wp.vec3d]):
    i = wp.tid()
    out[i] = log_so3(r[i])


@wp.kernel
def nearest_rotations(r: wp.array[wp.mat33d], out: wp.array[wp.mat33d]):
    i = wp.tid()
    out[i] = orthonormal(r[i])


@wp.kernel
def headings(r: wp.array[wp.mat33d], out: wp.array[wp.float64]):
    i = wp.tid()
    out[i] = heading(r[i])


@wp.kernel
def wrapped(angle: wp.array[float], out: wp.array[float]):
    i = wp.tid()
    out[i] = wrap(angle[i])


@wp.kernel
def standing(normal: wp.array[wp.vec3], yaw: wp.array[float], out: wp.array[wp.mat33]):
    i = wp.tid()
    out[i] = stand_on(normal[i], yaw[i])


@wp.kernel
def heights_at(terrain: Terrain, world: wp.array[int], at: wp.array[wp.vec2], out: wp.array[float]):
    i = wp.tid()
    out[i] = ground_height(terrain, world[i], at[i][0], at[i][1])


@wp.kernel
def ranges(
    terrain: Terrain, world: wp.array[int], start: wp.array[wp.vec3], direction: wp.array[wp.vec3],
    limit: float, out: wp.array[float],
):  # fmt: skip
    i = wp.tid()
    out[i] = cast_ray(terrain, world[i], start[i], direction[i], limit)


@wp.kernel
def sight_lines(
    terrain: Terrain, world: wp.array[int], a: wp.array[wp.vec3], b: wp.array[wp.vec3], slack: float,
    out: wp.array[int],
):  # fmt: skip
    i = wp.tid()
    out[i] = int(blocked(terrain, world[i], a[i], b[i], slack))


def on_device(kernel: wp.Kernel, *arguments: object) -> np.ndarray:
    """What a kernel writes, one entry for each row of its array arguments; other arguments pass through."""
    device = prepare("cpu")
    names = list(kernel.adj.arg_types)
    inputs, rows = [], 0
    for name, value in zip(names, arguments, strict=False):
        kind = kernel.adj.arg_types[name]
        if hasattr(kind, "ndim"):
            value = wp.array(np.ascontiguousarray(value), dtype=kind.dtype, device=device)
            rows = value.shape[0]
        inputs.append(value)
    out = wp.zeros(rows, dtype=kernel.adj.arg_types[names[-1]].dtype, device=device)
    wp.launch(kernel, rows, inputs=inputs, outputs=[out], device=device)
    return out.numpy()

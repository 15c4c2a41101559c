"""Kernels that call the Warp functions of `coop_envs.sensing` on arrays."""

from __future__ import annotations

import warp as wp

from coop_envs.sensing.camera import CameraModel, bearing, bearing_d, in_view, project
from coop_envs.sensing.correspondence import assignments, in_turans_set
from coop_envs.sensing.features import hue_apart
from coop_envs.sensing.leds import LedModel, led_signal, pixel_noise
from coop_envs.sensing.p3p import mat43d, p3p_depths, triad
from coop_envs.sensing.poses import (
    cholesky6,
    information_of,
    inverse_from_cholesky6,
    led_rows,
    mat66d,
    solve_cholesky6,
    vec6d,
)
from coop_envs.sensing.refinement import vec8i

wp.set_module_options({"enable_backward": False})


@wp.kernel
def pixels(camera: CameraModel, point: wp.array[wp.vec3], out: wp.array[wp.vec2]):
    i = wp.tid()
    out[i] = project(camera, point[i])


@wp.kernel
def bearings(camera: CameraModel, uv: wp.array[wp.vec2], out: wp.array[wp.vec3]):
    i = wp.tid()
    out[i] = bearing(camera, uv[i])


@wp.kernel
def exact_bearings(camera: CameraModel, uv: wp.array[wp.vec2d], out: wp.array[wp.vec3d]):
    i = wp.tid()
    out[i] = bearing_d(camera, uv[i])


@wp.kernel
def views(camera: CameraModel, point: wp.array[wp.vec3], out: wp.array[int]):
    i = wp.tid()
    out[i] = int(in_view(camera, point[i]))


@wp.kernel
def signals(
    model: LedModel, brightness: wp.array[float], to_camera: wp.array[wp.vec3],
    axis: wp.array[wp.vec3], out: wp.array[float],
):  # fmt: skip
    i = wp.tid()
    out[i] = led_signal(model, brightness[i], to_camera[i], axis[i])


@wp.kernel
def noises(model: LedModel, signal: wp.array[float], out: wp.array[float]):
    i = wp.tid()
    out[i] = pixel_noise(model, signal[i])


@wp.kernel
def informations(
    camera: CameraModel, arm: wp.array[wp.vec3d], position: wp.array[wp.vec3d], noise: wp.array[wp.float64],
    out: wp.array[mat66d],
):  # fmt: skip
    i = wp.tid()
    rows = led_rows(camera, arm[i], position[i])
    out[i] = information_of(rows, wp.float64(1.0) / (noise[i] * noise[i]))


@wp.kernel
def factors(a: wp.array[mat66d], out: wp.array[mat66d]):
    i = wp.tid()
    out[i] = cholesky6(a[i])


@wp.kernel
def solutions(a: wp.array[mat66d], right: wp.array[vec6d], out: wp.array[vec6d]):
    i = wp.tid()
    out[i] = solve_cholesky6(cholesky6(a[i]), right[i])


@wp.kernel
def inverses(a: wp.array[mat66d], out: wp.array[mat66d]):
    i = wp.tid()
    out[i] = inverse_from_cholesky6(cholesky6(a[i]))


@wp.kernel
def three_point_poses(
    rays: wp.array2d[wp.vec3d], points: wp.array2d[wp.vec3d], depths: wp.array[mat43d],
    rotation: wp.array2d[wp.mat33d], position: wp.array2d[wp.vec3d],
):  # fmt: skip
    """Poses (n, 4) that bring points (n, 3) onto rays (n, 3)."""
    i = wp.tid()
    x = wp.vec3d(wp.length_sq(points[i, 0] - points[i, 1]), wp.length_sq(points[i, 0] - points[i, 2]),
                 wp.length_sq(points[i, 1] - points[i, 2]))  # fmt: skip
    c = wp.vec3d(wp.dot(rays[i, 0], rays[i, 1]), wp.dot(rays[i, 0], rays[i, 2]), wp.dot(rays[i, 1], rays[i, 2]))
    found = p3p_depths(x, c)
    depths[i] = found
    body = triad(points[i, 0], points[i, 1], points[i, 2])
    for k in range(4):
        if found[k, 0] > wp.float64(0.0):
            a = rays[i, 0] * found[k, 0]
            camera = triad(a, rays[i, 1] * found[k, 1], rays[i, 2] * found[k, 2])
            rotation[i, k] = camera * wp.transpose(body)
            position[i, k] = a - rotation[i, k] * points[i, 0]


@wp.kernel
def assignment_counts(counts: wp.array[vec8i], out: wp.array[int]):
    i = wp.tid()
    out[i] = assignments(counts[i])


@wp.kernel
def turans_set(triple: wp.array[wp.vec3i], out: wp.array[int]):
    i = wp.tid()
    out[i] = int(in_turans_set(triple[i][0], triple[i][1], triple[i][2]))


@wp.kernel
def hue_distances(a: wp.array[float], b: wp.array[float], out: wp.array[float]):
    i = wp.tid()
    out[i] = hue_apart(a[i], b[i])

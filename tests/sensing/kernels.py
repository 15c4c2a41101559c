"""Kernels that call the Warp functions of `coop_envs.sensing` on arrays."""

from __future__ import annotations

import warp as wp

from coop_envs.sensing.camera import CameraModel, in_view, project
from coop_envs.sensing.leds import LedModel, led_signal, pixel_noise
from coop_envs.sensing.poses import cholesky6, inverse_from_cholesky6, led_information, mat66d

wp.set_module_options({"enable_backward": False})


@wp.kernel
def pixels(camera: CameraModel, point: wp.array[wp.vec3], out: wp.array[wp.vec2]):
    i = wp.tid()
    out[i] = project(camera, point[i])


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
    focal: wp.vec2, arm: wp.array[wp.vec3], position: wp.array[wp.vec3], noise: wp.array[float],
    out: wp.array[mat66d],
):  # fmt: skip
    i = wp.tid()
    out[i] = led_information(focal, arm[i], position[i], noise[i])


@wp.kernel
def factors(a: wp.array[mat66d], out: wp.array[mat66d]):
    i = wp.tid()
    out[i] = cholesky6(a[i])


@wp.kernel
def inverses(a: wp.array[mat66d], out: wp.array[mat66d]):
    i = wp.tid()
    out[i] = inverse_from_cholesky6(cholesky6(a[i]))

"""Rung `poses`: what a pose solver would make of the blobs, if it knew whose they are and its problem were linear.

Blobs are those of `imaging`, noise and all; a pose's error is the one that their pixels' errors cause. The solver of
rung `features` finds no single pose in about 1 % of the views that get one here, and a wrong one in 0.1 %.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

from coop_envs.geometry.so3 import exp_so3
from coop_envs.sensing.camera import CameraModel
from coop_envs.sensing.features import Features, hue_apart
from coop_envs.sensing.hats import Hats
from coop_envs.sensing.leds import LedModel, pixel_noise
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import cholesky6, information_of, inverse_from_cholesky6, led_rows, mat66d, vec6d
from coop_envs.sensing.solver import NOT_ASKED, POSE, TOO_FEW_LEDS
from coop_envs.simulation.imaging import Labels, camera_axes, reflection
from coop_envs.simulation.state import State

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.func
def see_hat(
    state: State, features: Features, labels: Labels, hats: Hats, camera: CameraModel, model: LedModel,
    out: Measurements, b: int, i: int, j: int,
) -> int:  # fmt: skip
    """The pose of hat j in camera i from its own blobs, linearised at the truth."""
    R_world_camera = camera_axes(state, camera, b, i)
    eye = state.position[b, i] + state.rotation[b, i] * camera.p_body_camera
    R = wp.mat33d(wp.transpose(R_world_camera) * state.rotation[b, j])
    p = wp.transpose(R_world_camera) * (state.position[b, j] - eye) + reflection(state, model, b, i, j)
    information = mat66d()
    gradient = vec6d()
    leds = int(0)
    used = int(0)
    for k in range(features.count[b, i]):
        if labels.robot[b, i, k] == j:
            led = labels.led[b, i, k]
            if hue_apart(features.hue[b, i, k], hats.hue[j, led]) <= model.hue_tolerance:
                leds = leds + 1
                used = used | (1 << led)
                rows = led_rows(camera, R * wp.vec3d(hats.position[j, led]), wp.vec3d(p))
                sigma = wp.float64(pixel_noise(model, features.signal[b, i, k]))
                weight = wp.float64(1.0) / (sigma * sigma)
                e = wp.vec2d(features.pixel[b, i, k]) - rows.uv
                information = information + information_of(rows, weight)
                gradient = gradient + (rows.u * e[0] + rows.v * e[1]) * weight
    if leds < model.min_leds:
        return TOO_FEW_LEDS
    factor = cholesky6(information)
    if not factor[0, 0] > wp.float64(0.0):
        return TOO_FEW_LEDS
    covariance = inverse_from_cholesky6(factor)
    error = covariance * gradient
    out.seen[b, i, j] = 1
    out.R_camera_body[b, i, j] = wp.mat33(exp_so3(wp.vec3d(error[0], error[1], error[2])) * R)
    out.p_camera_body[b, i, j] = p + wp.vec3(float(error[3]), float(error[4]), float(error[5]))
    out.covariance[b, i, j] = covariance
    out.leds[b, i, j] = used
    return POSE


@wp.kernel
def see(
    state: State, features: Features, labels: Labels, hats: Hats, cameras: wp.array[CameraModel], model: LedModel,
    out: Measurements, answer: wp.array3d[int], running: wp.array[int],
):  # fmt: skip
    """Relative poses of all robots from all cameras; one thread a team and camera. ``answer`` as of `solve_poses`."""
    b, i = wp.tid()
    if running[b] == 0:
        return
    for j in range(hats.leds.shape[0]):
        out.seen[b, i, j] = 0
        answer[b, i, j] = NOT_ASKED
        if i != j and cameras[i].fitted == 1 and hats.leds[j] > 0:
            answer[b, i, j] = see_hat(state, features, labels, hats, cameras[i], model, out, b, i, j)

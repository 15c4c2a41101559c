"""Rung `poses`: which LEDs each camera sees, and the pose their pixels would give, drawn with its own covariance."""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.geometry.keyed_random import draw_key, normal2, uniform
from coop_envs.geometry.so3 import exp_so3
from coop_envs.geometry.terrain import blocked
from coop_envs.sensing.camera import CameraModel, in_view
from coop_envs.sensing.leds import LedModel, led_signal, pixel_noise
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import cholesky6, inverse_from_cholesky6, led_information, mat66d, vec6d
from coop_envs.simulation.dynamics import Ground, present
from coop_envs.simulation.parameters import RobotModel
from coop_envs.simulation.state import DEPLETED, State

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FIRST_CHANNEL = wp.constant(64)
CHANNELS = wp.constant(16)
OUTLIER_M = wp.constant(0.3)
DIFFUSER_M = wp.constant(0.005)


@wp.func
def hidden_by_robot(state: State, robots: wp.array[RobotModel], b: int, i: int, j: int, a: wp.vec3, c: wp.vec3) -> bool:
    """Whether a third robot's body, an upright cylinder, stands between camera a and LED c."""
    d = wp.vec2(c[0] - a[0], c[1] - a[1])
    length2 = wp.dot(d, d)
    if length2 < 1.0e-9:
        return False
    for k in range(robots.shape[0]):
        if k != i and k != j and present(state, b, k):
            p = state.position[b, k]
            to = wp.vec2(p[0] - a[0], p[1] - a[1])
            s = wp.dot(to, d) / length2
            chord2 = robots[k].body_radius * robots[k].body_radius / length2 - wp.dot(to, to) / length2 + s * s
            if chord2 > 0.0 and s + wp.sqrt(chord2) > 0.0 and s - wp.sqrt(chord2) < 1.0:
                enter = wp.max(s - wp.sqrt(chord2), 0.0)
                leave = wp.min(s + wp.sqrt(chord2), 1.0)
                top = p[2] - robots[k].body_height + robots[k].height
                if a[2] + wp.min(enter * (c[2] - a[2]), leave * (c[2] - a[2])) < top:
                    return True
    return False


@wp.func
def look_at(
    state: State, command: Command, robots: wp.array[RobotModel], cameras: wp.array[CameraModel],
    leds: wp.array2d[wp.vec3], model: LedModel, ground: Ground, b: int, i: int, j: int,
) -> mat66d:  # fmt: skip
    """Fisher information of the LEDs of robot j that camera i detects; its [0, 0] is 0 where they are too few."""
    camera = cameras[i]
    R_world_camera = state.rotation[b, i] * camera.R_body_camera
    eye = state.position[b, i] + state.rotation[b, i] * camera.p_body_camera
    R = state.rotation[b, j]
    R_camera_body = wp.transpose(R_world_camera) * R
    p_camera_body = wp.transpose(R_world_camera) * (state.position[b, j] - eye)
    up = wp.vec3(R[0, 2], R[1, 2], R[2, 2])
    information = mat66d()
    detected = int(0)
    for k in range(robots[j].leds):
        arm = R_camera_body * leds[j, k]
        if in_view(camera, arm + p_camera_body):
            lamp = state.position[b, j] + R * leds[j, k]
            signal = led_signal(model, command.brightness[b, j], eye - lamp, up)
            hidden = signal < model.detection_signal or hidden_by_robot(state, robots, b, i, j, eye, lamp)
            if not (hidden or blocked(ground.terrain, state.world[b], eye, lamp, DIFFUSER_M)):
                detected = detected + 1
                noise = pixel_noise(model, signal)
                information = information + led_information(camera.focal, arm, p_camera_body, noise)
    if detected < model.min_leds:
        information = mat66d()
    return information


@wp.func
def powered(state: State, b: int, r: int) -> bool:
    """Whether a robot in the world has power for its camera and hat."""
    return present(state, b, r) and state.status[b, r] != DEPLETED


@wp.kernel
def see(
    state: State, command: Command, out: Measurements, robots: wp.array[RobotModel],
    cameras: wp.array[CameraModel], leds: wp.array2d[wp.vec3], model: LedModel, ground: Ground,
    running: wp.array[int],
):  # fmt: skip
    """Relative poses of all robots from all cameras; one thread a team and camera."""
    b, i = wp.tid()
    if running[b] == 0:
        return
    for j in range(robots.shape[0]):
        out.seen[b, i, j] = 0
        if i != j and cameras[i].fitted == 1 and robots[j].leds > 0 and powered(state, b, i) and powered(state, b, j):
            information = look_at(state, command, robots, cameras, leds, model, ground, b, i, j)
            factor = cholesky6(information)
            key = state.key[b]
            channel = FIRST_CHANNEL + CHANNELS * j
            lost = uniform(draw_key(key, state.tick[b], i, channel)) < model.dropout
            if factor[0, 0] > wp.float64(0.0) and not lost:
                covariance = inverse_from_cholesky6(factor)
                low = cholesky6(covariance)
                white = vec6d()
                for k in range(3):
                    pair = normal2(draw_key(key, state.tick[b], i, channel + 1 + k))
                    white[2 * k] = wp.float64(pair[0])
                    white[2 * k + 1] = wp.float64(pair[1])
                error = low * white
                theta = wp.vec3d(error[0], error[1], error[2])
                shift = wp.vec3(float(error[3]), float(error[4]), float(error[5]))
                if uniform(draw_key(key, state.tick[b], i, channel + 4)) < model.outlier:
                    jump = normal2(draw_key(key, state.tick[b], i, channel + 5))
                    shift = shift + wp.vec3(jump[0], 0.0, jump[1]) * OUTLIER_M
                camera = cameras[i]
                R_world_camera = state.rotation[b, i] * camera.R_body_camera
                eye = state.position[b, i] + state.rotation[b, i] * camera.p_body_camera
                R_camera_body = wp.transpose(R_world_camera) * state.rotation[b, j]
                out.seen[b, i, j] = 1
                out.R_camera_body[b, i, j] = wp.mat33(exp_so3(theta)) * R_camera_body
                out.p_camera_body[b, i, j] = wp.transpose(R_world_camera) * (state.position[b, j] - eye) + shift
                out.covariance[b, i, j] = covariance

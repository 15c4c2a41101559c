"""The blobs of light in every camera's frame: LEDs through the true lens, with noise, losses and lights that are none.

At times a frame misses a hat altogether, and at times it shows a hat's reflection beside it instead. Blobs that touch
are one: the brighter.
"""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.geometry.arrays import allocate
from coop_envs.geometry.keyed_random import draw_key, normal2, normal3, uniform
from coop_envs.geometry.so3 import exp_so3
from coop_envs.sensing.camera import CameraModel, in_view, project
from coop_envs.sensing.features import Features
from coop_envs.sensing.hats import Hats
from coop_envs.sensing.leds import LedModel, hue_noise, pixel_noise
from coop_envs.simulation.calibration import CalibrationError, true_camera, true_led
from coop_envs.simulation.dynamics import Ground
from coop_envs.simulation.parameters import RobotModel
from coop_envs.simulation.state import State
from coop_envs.simulation.visibility import light_from, powered

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

HAT_CHANNEL, HAT_CHANNELS = wp.constant(64), wp.constant(16)
FALSE_CHANNEL, LED_CHANNEL = wp.constant(2048), wp.constant(4096)
SHAKE_CHANNEL = wp.constant(2560)
REFLECTION_M = wp.constant(0.3)
FALSE_LIGHTS = 4


@wp.struct
class Labels:
    """Whose blobs they are: robot and LED of each, -1 for lights that are no LEDs. (B, N, K)"""

    robot: wp.array3d[int]
    led: wp.array3d[int]


@wp.struct
class View:
    """A camera in truth: its lens, its place in the world and its axes."""

    lens: CameraModel
    eye: wp.vec3
    axes: wp.mat33


def allocate_labels(teams: int, robots: int, blobs: int, device: str) -> Labels:
    """Labels of nothing yet."""
    return allocate(Labels, (teams, robots, blobs), device)


@wp.func
def camera_axes(state: State, camera: CameraModel, b: int, i: int) -> wp.mat33:
    """R_world_camera of camera i in this frame; its mount shakes while the robot's wheels turn."""
    axes = state.rotation[b, i] * camera.R_body_camera
    if camera.shake > 0.0 and wp.length(state.wheels[b, i]) > 0.0:
        turn = normal3(state.key[b], state.tick[b], i, SHAKE_CHANNEL) * camera.shake
        axes = axes * wp.mat33(exp_so3(wp.vec3d(turn)))
    return axes


@wp.func
def view_of(state: State, camera: CameraModel, error: CalibrationError, b: int, i: int) -> View:
    """Camera i as it really is."""
    view = View()
    view.lens = true_camera(camera, error, state.key[b], i)
    view.axes = camera_axes(state, camera, b, i)
    view.eye = state.position[b, i] + state.rotation[b, i] * camera.p_body_camera
    return view


@wp.func
def missed(state: State, model: LedModel, b: int, i: int, j: int) -> bool:
    """Whether this frame of camera i misses hat j."""
    return uniform(draw_key(state.key[b], state.tick[b], i, HAT_CHANNEL + HAT_CHANNELS * j)) < model.dropout


@wp.func
def reflection(state: State, model: LedModel, b: int, i: int, j: int) -> wp.vec3:
    """How far from hat j its image in this frame seems to be (camera axes, m): zero unless it is a reflection."""
    key = state.key[b]
    channel = HAT_CHANNEL + HAT_CHANNELS * j
    if uniform(draw_key(key, state.tick[b], i, channel + 4)) >= model.outlier:
        return wp.vec3()
    jump = normal2(draw_key(key, state.tick[b], i, channel + 5))
    return wp.vec3(jump[0], 0.0, jump[1]) * REFLECTION_M


@wp.func
def add_blob(
    features: Features, labels: Labels, size: wp.vec2, merge: float, b: int, i: int, uv: wp.vec2, hue: float,
    signal: float, robot: int, led: int,
):  # fmt: skip
    """Append a blob that lies in the image, or merge it with one that it touches."""
    n = features.count[b, i]
    if not (uv[0] >= 0.0 and uv[1] >= 0.0 and uv[0] <= size[0] - 1.0 and uv[1] <= size[1] - 1.0):
        return
    place = n
    for k in range(n):
        if wp.length(features.pixel[b, i, k] - uv) < merge:
            place = k
    if place < n and features.signal[b, i, place] >= signal:
        return
    if place < features.pixel.shape[2]:
        features.pixel[b, i, place] = uv
        features.hue[b, i, place] = hue - 360.0 * wp.floor(hue / 360.0)
        features.signal[b, i, place] = signal
        labels.robot[b, i, place] = robot
        labels.led[b, i, place] = led
        features.count[b, i] = wp.max(n, place + 1)


@wp.func
def image_hat(
    state: State, command: Command, features: Features, labels: Labels, robots: wp.array[RobotModel], hats: Hats,
    view: View, model: LedModel, error: CalibrationError, ground: Ground, b: int, i: int, j: int,
):  # fmt: skip
    """The blobs of one hat."""
    key = state.key[b]
    tick = state.tick[b]
    shift = reflection(state, model, b, i, j)
    for k in range(hats.leds[j]):
        led = true_led(hats.position[j, k], error, key, j, k)
        lamp = state.position[b, j] + state.rotation[b, j] * led
        p_camera = wp.transpose(view.axes) * (lamp - view.eye) + shift
        channel = LED_CHANNEL + 32 * j + 4 * k
        if in_view(view.lens, p_camera) and uniform(draw_key(key, tick, i, channel)) >= model.blob_dropout:
            signal = light_from(state, command, robots, model, ground, b, i, j, view.eye, led)
            if signal > 0.0:
                noise = normal2(draw_key(key, tick, i, channel + 1)) * pixel_noise(model, signal)
                hue = hats.hue[j, k] + hue_noise(model, signal) * normal2(draw_key(key, tick, i, channel + 2))[0]
                uv = project(view.lens, p_camera) + noise
                add_blob(features, labels, view.lens.size, model.merge, b, i, uv, hue, signal, j, k)


@wp.func
def image_false_lights(state: State, features: Features, labels: Labels, view: View, model: LedModel, b: int, i: int):
    """Lamps and glints of any hue, anywhere in the image."""
    key = state.key[b]
    for k in range(FALSE_LIGHTS):
        channel = FALSE_CHANNEL + 8 * k
        if uniform(draw_key(key, state.tick[b], i, channel)) < model.false_lights / float(FALSE_LIGHTS):
            u = uniform(draw_key(key, state.tick[b], i, channel + 1)) * view.lens.size[0]
            v = uniform(draw_key(key, state.tick[b], i, channel + 2)) * view.lens.size[1]
            hue = uniform(draw_key(key, state.tick[b], i, channel + 3)) * 360.0
            signal = model.detection_signal + uniform(draw_key(key, state.tick[b], i, channel + 4))
            add_blob(features, labels, view.lens.size, model.merge, b, i, wp.vec2(u, v), hue, signal, -1, -1)


@wp.kernel
def image_leds(
    state: State, command: Command, features: Features, labels: Labels, robots: wp.array[RobotModel], hats: Hats,
    cameras: wp.array[CameraModel], model: LedModel, error: CalibrationError, ground: Ground, running: wp.array[int],
):  # fmt: skip
    """The blobs in all cameras' frames; one thread a team and camera."""
    b, i = wp.tid()
    if running[b] == 0:
        return
    features.count[b, i] = 0
    if cameras[i].fitted == 0 or not powered(state, b, i):
        return
    view = view_of(state, cameras[i], error, b, i)
    for j in range(robots.shape[0]):
        if i != j and hats.leds[j] > 0 and powered(state, b, j) and not missed(state, model, b, i, j):
            image_hat(state, command, features, labels, robots, hats, view, model, error, ground, b, i, j)
    image_false_lights(state, features, labels, view, model, b, i)

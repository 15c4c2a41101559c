"""Laser spots in truth: where the lit ray lands at the end of each tick, and what every camera's frame shows of it.

Robots are dark to the laser: a ray that meets one leaves no spot. A frame shows one spot, or another light instead.
"""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.agents.raster import LaserModel
from coop_envs.geometry.keyed_random import draw_key, normal2, uniform
from coop_envs.geometry.terrain import blocked, cast_to_surface
from coop_envs.sensing.camera import CameraModel, in_view, project
from coop_envs.sensing.leds import LedModel
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.spots import GRAZING, SpotModel, spot_noise, spot_signal
from coop_envs.simulation.calibration import CalibrationError, true_camera
from coop_envs.simulation.dynamics import Ground
from coop_envs.simulation.parameters import RobotModel
from coop_envs.simulation.state import State
from coop_envs.simulation.visibility import hidden_by_robot, powered

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

PIXEL_CHANNEL, LIGHT_CHANNEL, CHANCE_CHANNEL, STAMP_CHANNEL = (wp.constant(k) for k in (16, 17, 18, 19))
LASER_REACH_M = wp.constant(10.0)
SURFACE_M = wp.constant(0.005)


@wp.struct
class Spot:
    """Where a ray landed: ``lit`` is 0 without a spot; ``incidence`` the cosine, ``distance`` (m) from the laser."""

    lit: int
    point: wp.vec3
    normal: wp.vec3
    incidence: float
    distance: float
    duty: float
    source: int


@wp.func
def land(
    state: State, command: Command, robots: wp.array[RobotModel], lasers: wp.array[LaserModel], ground: Ground,
    b: int, r: int, t: int,
) -> Spot:  # fmt: skip
    """The spot of robot r's laser at the end of tick t."""
    spot = Spot()
    mirror = state.mirror[b, r, t]
    R = state.rotation[b, r]
    level = wp.cos(mirror[1])
    ray = R * wp.vec3(wp.cos(mirror[0]) * level, wp.sin(mirror[0]) * level, wp.sin(mirror[1]))
    start = state.position[b, r] + R * lasers[r].position
    w = state.world[b]
    surface = cast_to_surface(ground.terrain, w, start, ray, LASER_REACH_M)
    if surface.t > 0.0:
        spot.point = start + ray * surface.t
        spot.normal = surface.normal
        spot.incidence = -wp.dot(ray, spot.normal)
        spot.distance = surface.t
        spot.duty = command.laser[b, r, t]
        spot.source = r
        free = not hidden_by_robot(state, robots, b, r, r, start, spot.point)
        spot.lit = int(spot.incidence > GRAZING and free)
    return spot


@wp.func
def show(
    state: State, out: Measurements, robots: wp.array[RobotModel], camera: CameraModel, leds: LedModel,
    spots: SpotModel, ground: Ground, spot: Spot, b: int, i: int, t: int,
):  # fmt: skip
    """What camera i's frame at the end of tick t shows."""
    tick = state.tick[b] - out.spot.shape[2] + t
    key = state.key[b]
    chance = normal2(draw_key(key, tick, i, STAMP_CHANNEL))
    out.spot_stamp[b, i, t] = chance[0] * spots.jitter
    R_world_camera = state.rotation[b, i] * camera.R_body_camera
    eye = state.position[b, i] + state.rotation[b, i] * camera.p_body_camera
    if spot.lit == 1 and uniform(draw_key(key, tick, i, CHANCE_CHANNEL)) >= spots.missed:
        p_camera = wp.transpose(R_world_camera) * (spot.point - eye)
        to_camera = eye - spot.point
        signal = spot_signal(spots, leds, spot.duty, spot.distance, to_camera, spot.normal)
        if signal >= leds.detection_signal and in_view(camera, p_camera):
            hidden = hidden_by_robot(state, robots, b, i, i, eye, spot.point)
            if not (hidden or blocked(ground.terrain, state.world[b], eye, spot.point, SURFACE_M)):
                d = wp.length(to_camera)
                sigma = spot_noise(spots, leds, signal, spot.incidence, camera.focal[0], d)
                noise = normal2(draw_key(key, tick, i, PIXEL_CHANNEL)) * sigma
                out.spot[b, i, t] = project(camera, p_camera) + noise
                out.spot_sigma[b, i, t] = sigma
    if uniform(draw_key(key, tick, i, LIGHT_CHANNEL)) < spots.false_spot:
        at = normal2(draw_key(key, tick, i, LIGHT_CHANNEL + 4)) * 0.2
        out.spot[b, i, t] = wp.vec2((0.5 + at[0]) * camera.size[0], (0.5 + at[1]) * camera.size[1])
        out.spot_sigma[b, i, t] = leds.noise_px


@wp.kernel
def shine(
    state: State, command: Command, out: Measurements, robots: wp.array[RobotModel], lasers: wp.array[LaserModel],
    cameras: wp.array[CameraModel], error: CalibrationError, leds: LedModel, spots: SpotModel, ground: Ground,
    running: wp.array[int],
):  # fmt: skip
    """Frames of all cameras at the ends of a decision's ticks; one thread a team and tick.

    Robots that scan stand, so their pose at the end of the decision serves for all of it; spots of cameras that move
    are never used.
    """
    b, t = wp.tid()
    if running[b] == 0:
        return
    spot = Spot()
    for r in range(robots.shape[0]):
        if command.laser[b, r, t] > 0.0 and powered(state, b, r) and spot.lit == 0:
            spot = land(state, command, robots, lasers, ground, b, r, t)
    for i in range(robots.shape[0]):
        out.spot_sigma[b, i, t] = 0.0
        if cameras[i].fitted == 1 and powered(state, b, i):
            camera = true_camera(cameras[i], error, state.key[b], i)
            show(state, out, robots, camera, leds, spots, ground, spot, b, i, t)

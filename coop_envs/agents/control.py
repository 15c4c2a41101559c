"""From a policy's action to a robot's command, the same for simulation and for robots.

An action is eight numbers in [-1, 1], named in `ACTION_NAMES`. ``hold`` above 0 commands exactly zero motion. Entries a
robot has no use for are ignored; `action_mask` says which.

A robot with a laser that holds and whose ``scan_request`` is above 0 draws a raster: the request is its width as a
share of the laser's full raster, ``scan_azimuth`` (left) and ``scan_elevation`` (up) its centre as shares of the
mirror's reach. A raster that runs goes on while it is requested; the next begins with the first decision after its end.
While anyone of the team scans, all hats are dark, and the lasers take turns, one a tick.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.command import Command
from coop_envs.agents.raster import LaserModel, Raster, abandon_raster, begin_raster, next_move, on_point
from coop_envs.agents.team import Member, Team

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

ACTION_NAMES = (
    "hold",
    "forward_speed",
    "yaw_rate",
    "pitch_rate",
    "scan_request",
    "scan_azimuth",
    "scan_elevation",
    "marker_brightness",
)
HOLD, FORWARD, YAW, REQUEST, AZIMUTH, ELEVATION, BRIGHTNESS = (wp.constant(k) for k in (0, 1, 2, 4, 5, 6, 7))
LANDMARK_BRIGHTNESS = wp.constant(0.5)
AT_WORK = wp.constant(1)


@wp.struct
class DriveModel:
    """Wheel radius and track (m), speeds that an action of 1 asks for (m/s, rad/s), largest rim speed (m/s).

    ``collect`` is 1 where lost robots are taken out of the way by hand.
    """

    wheel_radius: float
    track: float
    cruise_speed: float
    cruise_yaw_rate: float
    max_speed: float
    collect: int


def action_mask(member: Member) -> NDArray[np.int8]:
    """1 for the entries of the action that this robot uses, (8,)."""
    laser = int(member.laser is not None)
    return np.array([1, 1, 1, 0, laser, laser, laser, int(member.hat is not None)], dtype=np.int8)


def drive_models(team: Team, collect_lost: bool, device: str) -> wp.array:
    """Pack every member's drive (N,)."""
    models = []
    for member in team.members:
        model = DriveModel()
        model.wheel_radius, model.track = member.robot.wheel_radius_m, member.robot.track_m
        model.cruise_speed, model.cruise_yaw_rate = member.cruise_speed_m_s, member.cruise_yaw_rate_rad_s
        model.max_speed, model.collect = member.robot.max_speed_m_s, int(collect_lost)
        models.append(model)
    return wp.array(models, dtype=DriveModel, device=device)


@wp.func
def wheel_speeds(model: DriveModel, speed: float, yaw_rate: float) -> wp.vec2:
    """Left and right wheel speed (rad/s), slowed together where one would exceed the robot's limit.

    Source: thesis eq (6.10).
    """
    left = speed - 0.5 * yaw_rate * model.track
    right = speed + 0.5 * yaw_rate * model.track
    fastest = wp.max(wp.abs(left), wp.abs(right))
    scale = wp.min(1.0, model.max_speed / wp.max(fastest, 1.0e-6))
    return wp.vec2(left, right) * (scale / model.wheel_radius)


@wp.func
def wants_scan(
    actions: wp.array3d[float], declared: wp.array2d[int], lasers: wp.array[LaserModel], b: int, r: int
) -> bool:
    """Whether a robot holds and asks for a scan that it can make."""
    able = lasers[r].fitted == 1 and declared[b, r] == AT_WORK
    return able and actions[b, r, HOLD] > 0.0 and actions[b, r, REQUEST] > 0.0


@wp.func
def scan(
    raster: Raster, command: Command, model: LaserModel, b: int, r: int, turn: int, scanners: int, request: float,
    azimuth: float, elevation: float,
):  # fmt: skip
    """One decision of scanning. The robot may light its laser in every ``scanners``-th tick, first after ``turn``."""
    if raster.point[b, r] >= raster.points[b, r]:
        begin_raster(raster, model, b, r, request, azimuth, elevation)
    for t in range(command.laser.shape[2]):
        command.galvo[b, r, t] = next_move(raster, model, b, r)
        if on_point(raster, b, r) and t % scanners == turn:
            command.laser[b, r, t] = model.duty
            raster.point[b, r] = raster.point[b, r] + 1
    command.scan_progress[b, r] = float(raster.point[b, r]) / float(raster.points[b, r])


@wp.kernel
def control(
    actions: wp.array3d[float], declared: wp.array2d[int], called: wp.array2d[int], clock: wp.array[int],
    models: wp.array[DriveModel], lasers: wp.array[LaserModel], raster: Raster, command: Command,
    running: wp.array[int],
):  # fmt: skip
    """Commands for every robot of the running teams.

    One that is docked or lost stands; a lost one keeps its hat lit as a landmark.
    """
    b, r = wp.tid()
    if running[b] == 0:
        return
    model = models[r]
    ticks = command.laser.shape[2]
    for t in range(ticks):
        command.laser[b, r, t] = 0.0
        command.galvo[b, r, t] = wp.vec2i(0, 0)
    command.scan_progress[b, r] = 0.0
    scanners = int(0)
    rank = int(0)
    for o in range(models.shape[0]):
        if wants_scan(actions, declared, lasers, b, o):
            scanners = scanners + 1
            if o < r:
                rank = rank + 1
    command.undock[b, r] = called[b, r]
    command.collect[b, r] = int(declared[b, r] > AT_WORK) * model.collect
    command.wheels[b, r] = wp.vec2(0.0, 0.0)
    command.hold[b, r] = 1
    command.brightness[b, r] = LANDMARK_BRIGHTNESS
    if declared[b, r] == AT_WORK:
        hold = actions[b, r, HOLD] > 0.0
        command.hold[b, r] = int(hold)
        if not hold:
            speed = wp.clamp(actions[b, r, FORWARD], -1.0, 1.0) * model.cruise_speed
            yaw_rate = wp.clamp(actions[b, r, YAW], -1.0, 1.0) * model.cruise_yaw_rate
            command.wheels[b, r] = wheel_speeds(model, speed, yaw_rate)
        command.brightness[b, r] = 0.5 * (wp.clamp(actions[b, r, BRIGHTNESS], -1.0, 1.0) + 1.0)
    if scanners > 0:
        command.brightness[b, r] = 0.0
    if wants_scan(actions, declared, lasers, b, r):
        turn = (rank + scanners - (clock[b] * ticks) % scanners) % scanners
        request = wp.min(actions[b, r, REQUEST], 1.0)
        azimuth = wp.clamp(actions[b, r, AZIMUTH], -1.0, 1.0)
        elevation = wp.clamp(actions[b, r, ELEVATION], -1.0, 1.0)
        scan(raster, command, lasers[r], b, r, turn, scanners, request, azimuth, elevation)
    elif lasers[r].fitted == 1:
        abandon_raster(raster, b, r, ticks)

"""`Belief`: what a team knows, a function of its measurements and commands alone."""

from __future__ import annotations

import math
from enum import IntEnum

import warp as wp

from coop_envs.agents.team import Team
from coop_envs.estimation.settings import Estimation
from coop_envs.geometry.arrays import allocate
from coop_envs.sensing.camera import body_from_camera
from coop_envs.sensing.poses import mat66d, vec6d


class Declared(IntEnum):
    """What the belief holds of a robot."""

    DOCKED = 0
    ACTIVE = 1
    LOST = 2


WAITING = wp.constant(int(Declared.DOCKED))
WORKING = wp.constant(int(Declared.ACTIVE))
LOST = wp.constant(int(Declared.LOST))

ERROR_STATES = 15
THETA, POSITION, VELOCITY, GYRO, ACCEL = (wp.constant(k) for k in (0, 3, 6, 9, 12))
NO_SLOT = wp.constant(-1)
SPARE_SLOTS = 3
LEDS_PER_SLOT = wp.constant(5)


class vec15d(wp.types.vector(length=ERROR_STATES, dtype=wp.float64)):  # noqa: N801 - a Warp type, named as Warp's own
    """Fifteen numbers in double precision: the states of a slot."""


@wp.struct
class Belief:
    """Arrays over B teams and N robots, team frame (the first observer's start, z along gravity), SI units.

    position, velocity, rotation, gyro_bias, accel_bias
        (B, N) the 16 states of thesis eq (5.1), the attitude as R_team_body.
    covariance
        (B, 15 S, 15 S) of the errors in S filter slots: those of calibrations first, then of robots, whose errors are
        (theta, p, v, b_g, b_a) with R = Exp(theta) R_hat.
    calibration
        (B, K) how far cameras and hats are off, as `calibration` lays out; K slots.
    first_position, first_velocity
        (B, N) where the updates of this decision are linearised: as predicted.
    slot, slots
        (B, N) each robot's slot or -1; (B,) how many slots are in use.
    pose_covariance
        (B, N) the (theta, p) block, kept after a robot left the filter.
    lag
        (B, N) by how much the velocity at the end of the decision exceeds its mean, both in body axes.
    declared, stationary
        (B, N) a `Declared`; 1 where a robot stands still.
    rest_s, unseen_s, silent_s
        (B, N) since when it rests, no camera saw it, its radio or its balance is gone.
    seen
        (B, N, N) 1 where the pose that camera i gave of robot j in this decision passed the gate.
    averaged
        (B, N, N) sightings fused since the pair came to rest.
    rejected
        (B, N) sightings of the robot that failed the gate in a row and agree.
    rejected_s
        (B, N) time since the first of them.
    refused
        (B, N, N) residual of the last sighting of j by camera i that failed the gate.
    wandered
        (B, N, N) running mean of the residuals of a pair at rest whose sightings are only checked.
    demoted
        (B, N) 1 where the pose was doubted in this decision: the robot was moved or slipped.
    tried_s, turn_tried, turn_felt, anchor
        (B, N) since the last motion that was noticed: seconds of driving, turn by the wheels and by the gyro (rad), and
        where a camera saw it first (x, y, 1 once it did).
    spinning
        (B, N) 1 while the wheels seem to spin on a robot held fast.
    battery
        (B, N) remaining fraction.
    marked, undock
        (B, N) 1 where the loss was declared in this decision and marks a hazard; 1 where a reserve is called.
    goal
        (B,) x, y, radius, 1 if there is one.
    clock
        (B,) decisions since reset.
    """

    position: wp.array2d[wp.vec3d]
    velocity: wp.array2d[wp.vec3d]
    rotation: wp.array2d[wp.mat33d]
    gyro_bias: wp.array2d[wp.vec3d]
    accel_bias: wp.array2d[wp.vec3d]
    covariance: wp.array3d[wp.float64]
    calibration: wp.array2d[vec15d]
    first_position: wp.array2d[wp.vec3d]
    first_velocity: wp.array2d[wp.vec3d]
    slot: wp.array2d[int]
    slots: wp.array[int]
    pose_covariance: wp.array2d[mat66d]
    lag: wp.array2d[wp.vec3d]
    declared: wp.array2d[int]
    stationary: wp.array2d[int]
    rest_s: wp.array2d[float]
    unseen_s: wp.array2d[float]
    silent_s: wp.array2d[float]
    seen: wp.array3d[int]
    averaged: wp.array3d[int]
    rejected: wp.array2d[int]
    rejected_s: wp.array2d[float]
    refused: wp.array3d[vec6d]
    wandered: wp.array3d[vec6d]
    demoted: wp.array2d[int]
    tried_s: wp.array2d[float]
    turn_tried: wp.array2d[float]
    turn_felt: wp.array2d[float]
    anchor: wp.array2d[wp.vec3]
    spinning: wp.array2d[int]
    battery: wp.array2d[float]
    marked: wp.array2d[int]
    undock: wp.array2d[int]
    goal: wp.array[wp.vec4]
    clock: wp.array[int]


@wp.struct
class MemberModel:
    """What the estimator knows of one robot: IMU noise, wheels, camera, size, whether it is a spare picket.

    ``odometry`` is 1 where its wheels tell of its motion. ``camera_slot`` and ``hat_slot`` are the filter's slots for
    the calibration of its camera and of its hat's LEDs (one for each five), or -1.
    """

    gyro_noise: wp.float64
    accel_noise: wp.float64
    moving_gyro_noise: wp.float64
    moving_accel_noise: wp.float64
    gyro_bias: wp.float64
    accel_bias: wp.float64
    gyro_walk: wp.float64
    accel_walk: wp.float64
    wheel_radius: float
    track: float
    odometry_noise: float
    slip: float
    slip_time: float
    R_body_camera: wp.mat33d
    p_body_camera: wp.vec3d
    camera_shake: wp.float64
    odometry: int
    camera_slot: int
    hat_slot: int
    contact_radius: float
    body_radius: float
    body_height: float
    height: float
    radio_imu: int
    picket: int
    reserve: int
    camera: int
    laser: int


def member_models(team: Team, settings: Estimation, device: str) -> wp.array:
    """Pack what the estimator knows of each robot (N,)."""
    models: list[MemberModel] = []
    camera_slots, hat_slots, _ = calibration_slots(team, settings)
    for r, member in enumerate(team.members):
        model, robot, imu = MemberModel(), member.robot, member.robot.imu
        model.gyro_noise, model.accel_noise = imu.gyro_noise_rad_s_rthz, imu.accel_noise_m_s2_rthz
        model.moving_gyro_noise = imu.moving_gyro_noise_rad_s_rthz
        model.moving_accel_noise = imu.moving_accel_noise_m_s2_rthz
        model.gyro_bias, model.accel_bias = imu.gyro_bias_rad_s, imu.accel_bias_m_s2
        model.gyro_walk, model.accel_walk = imu.gyro_walk_rad_s2_rthz, imu.accel_walk_m_s3_rthz
        model.wheel_radius, model.track = robot.wheel_radius_m, robot.track_m
        model.odometry_noise, model.odometry = robot.odometry_noise, int(settings.wheels)
        model.camera_slot, model.hat_slot = camera_slots[r], hat_slots[r]
        model.slip, model.slip_time = robot.slip, robot.slip_time_s
        model.contact_radius, model.body_radius = robot.contact_radius_m, robot.body_radius_m
        model.body_height, model.height = robot.body_height_m, robot.height_m
        model.picket, model.reserve = int(member.role == "picket"), int(member.reserve)
        model.radio_imu = int(robot.radio_imu)
        model.camera, model.laser = int(member.camera is not None), int(member.laser is not None)
        if member.camera is not None:
            model.R_body_camera = wp.mat33d(*body_from_camera(member.camera.pitch_down_rad).ravel())
            model.p_body_camera = wp.vec3d(*member.camera.position_m)
            model.camera_shake = settings.camera_shake_rad
        models.append(model)
    return wp.array(models, dtype=MemberModel, device=device)


def calibration_slots(team: Team, settings: Estimation) -> tuple[list[int], list[int], int]:
    """Each robot's slot for its camera's calibration and the first one for its hat's, or -1; how many there are."""
    cameras: list[int] = []
    hats: list[int] = []
    used = 0
    for member in team.members:
        wanted = member.camera is not None and settings.calibrates_cameras
        cameras.append(used if wanted else NO_SLOT)
        used += wanted
        leds = len(member.hat.leds) if member.hat is not None and settings.hat_sigma_m > 0 else 0
        hats.append(used if leds else NO_SLOT)
        used += math.ceil(leds / LEDS_PER_SLOT)
    return cameras, hats, used


def allocate_belief(team: Team, teams: int, device: str, settings: Estimation | None = None) -> Belief:
    """Belief of nothing yet. The filter holds the robots at work and a few lost ones that serve as landmarks."""
    n = len(team.members)
    working = sum(not member.reserve for member in team.members)
    calibrated = calibration_slots(team, settings or Estimation())[2]
    size = ERROR_STATES * (calibrated + min(n, working + SPARE_SLOTS))
    shapes = {"covariance": (teams, size, size), "calibration": (teams, calibrated)}
    return allocate(Belief, (teams, n, n), device, **shapes)

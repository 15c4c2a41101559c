"""An inchworm team whose motion is written down in closed form, and what its sensors would say of it.

Nothing of the simulator is used: pickets and observer drive and turn in smooth pushes, one after the other; IMU samples
are means of the true signals between samples, on clocks that may be off.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_team
from coop_envs.localization.logs.events import Event, ImuSample, Log, Odometry, PoseSighting, Trajectory
from coop_envs.sensing.camera import body_from_camera

NAMES = ("observer_0", "picket_0", "picket_1")
STARTS = {"observer_0": (0.0, 0.0, 0.0), "picket_0": (0.6, 0.25, 0.0), "picket_1": (0.6, -0.25, 0.0)}
FINE_S = 0.001
SIGMA_RAD, SIGMA_M = 0.015, 0.005
STEP_S, STEP_M, TURN_RAD = 3.0, 0.3, 0.6
REST_S = 2.0
GRAVITY = 9.81


@dataclasses.dataclass(frozen=True)
class Motion:
    """True signals of one robot on a fine grid: position (K, 3), yaw (K,), speed, acceleration."""

    time_s: np.ndarray
    position: np.ndarray
    yaw: np.ndarray
    speed: np.ndarray

    def pose(self, at: float) -> tuple[np.ndarray, np.ndarray]:
        """R_world_body and p_world at a time."""
        p = np.array([np.interp(at, self.time_s, self.position[:, k]) for k in range(3)])
        return Rotation.from_euler("z", np.interp(at, self.time_s, self.yaw)).as_matrix(), p

    def imu(self, start_s: float, end_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean gyro and specific force between two times."""
        yaw = np.interp([start_s, end_s], self.time_s, self.yaw)
        v = np.interp([start_s, end_s], self.time_s, self.speed)
        turn = (yaw[1] - yaw[0]) / (end_s - start_s)
        force = [(v[1] - v[0]) / (end_s - start_s), 0.5 * (v[0] + v[1]) * turn, GRAVITY]
        return np.array([0.0, 0.0, turn]), np.array(force)


def push(time_s: np.ndarray, start_s: float) -> np.ndarray:
    """A smooth push that begins at a time and lasts ``STEP_S``; its integral is 1."""
    share = np.clip((time_s - start_s) / STEP_S, 0.0, 1.0)
    return 30.0 * share**2 * (1.0 - share) ** 2 / STEP_S


def motions(increments: int = 2, turn_rad: float = TURN_RAD) -> dict[str, Motion]:
    """After a rest, in each increment picket 0, picket 1 and the observer drive a step, to and fro as they turn."""
    order = ("picket_0", "picket_1", "observer_0")
    time_s = np.arange(0.0, REST_S + increments * len(order) * STEP_S + REST_S, FINE_S)
    out = {}
    for rank, name in enumerate(order):
        starts = [REST_S + (len(order) * k + rank) * STEP_S for k in range(increments)]
        speed = sum((STEP_M * push(time_s, at) for at in starts), np.zeros_like(time_s))
        swing = sum(
            (turn_rad * push(time_s, at) * np.sin(2 * np.pi * np.clip((time_s - at) / STEP_S, 0, 1)) for at in starts),
            np.zeros_like(time_s),
        )
        x, y, yaw0 = STARTS[name]
        yaw = yaw0 + np.concatenate([[0.0], np.cumsum(0.5 * (swing[1:] + swing[:-1])) * FINE_S])
        v = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1)
        way = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (v[1:] + v[:-1]), axis=0) * FINE_S])
        out[name] = Motion(time_s, np.array([x, y, 0.0]) + way, yaw, speed)
    return out


def generated_log(
    seed: int = 0,
    increments: int = 2,
    imu_hz: float = 50.0,
    frame_hz: float = 30.0,
    turn_rad: float = TURN_RAD,
    clock_s: Mapping[str, float] | None = None,
    latency_s: float | None = None,
    odometry: bool = True,
    silent: Sequence[tuple[str, float, float]] = (),
    unseen: Sequence[tuple[str, float, float]] = (),
    outliers: float = 0.0,
    starts: Sequence[str] = NAMES,
) -> Log:
    """Events in order of arrival, and the truth.

    ``clock_s``: by how much the clock of a robot's IMU and odometry, or of ``camera observer_0``, is ahead.
    ``latency_s``: the mean of exponential delays; None: nobody notes arrivals. ``silent`` and ``unseen``: robots whose
    radio is gone, or that no camera sees, from when until when.
    """
    rng, clock_s = np.random.default_rng(seed), clock_s or {}
    team, truth = load_team("inchworm"), motions(increments, turn_rad)
    events: list[tuple[float, Event]] = []
    end_s = truth[NAMES[0]].time_s[-1]
    for member, name in zip(team.members, NAMES, strict=True):
        imu, motion = member.robot.imu, truth[name]
        gyro_bias, accel_bias = rng.normal(0, imu.gyro_bias_rad_s, 3), rng.normal(0, imu.accel_bias_m_s2, 3)
        for at in np.arange(1.0 / imu_hz, end_s, 1.0 / imu_hz):
            if any(name == who and since < at < until for who, since, until in silent):
                continue
            gyro, accel = motion.imu(at - 1.0 / imu_hz, at)
            moves = float(np.interp(at, motion.time_s, motion.speed)) > 1e-4
            scale = np.sqrt(imu_hz)
            spread = np.hypot(imu.gyro_noise_rad_s_rthz, moves * imu.moving_gyro_noise_rad_s_rthz) * scale
            shaken = np.hypot(imu.accel_noise_m_s2_rthz, moves * imu.moving_accel_noise_m_s2_rthz) * scale
            stamp = at + clock_s.get(name, 0.0)
            gyro = gyro + gyro_bias + rng.normal(0, spread, 3)
            accel = accel + accel_bias + rng.normal(0, shaken, 3)
            events.append((at, ImuSample(stamp, name, gyro, accel)))
        for at in np.arange(0.0, end_s, 0.05) if odometry else ():
            forward = float(np.interp(at + 0.025, motion.time_s, motion.speed))
            turn = motion.imu(at, at + 0.05)[0][2]
            slip = 1.0 + rng.normal(0, 0.02)
            events.append((at, Odometry(at + clock_s.get(name, 0.0), name, forward * slip, turn * slip)))
    events += _sightings(rng, team, truth, np.arange(0.0121, end_s, 1.0 / frame_hz), clock_s, unseen, outliers)
    arrivals = [(at + (rng.exponential(latency_s) if latency_s else 0.0), event) for at, event in events]
    arrivals.sort(key=lambda entry: entry[0])
    played = [dataclasses.replace(event, arrival_s=at) if latency_s is not None else event for at, event in arrivals]
    true = {
        name: Trajectory(
            motion.time_s[::10],
            motion.position[::10],
            Rotation.from_rotvec(motion.yaw[::10, None] * np.array([0.0, 0.0, 1.0])).as_matrix(),
        )
        for name, motion in truth.items()
    }
    return Log(NAMES, played, team, {name: STARTS[name] for name in starts}, truth=true)


def _sightings(rng, team, truth, times, clock_s, unseen, outliers):
    camera = team.members[0].camera
    R_body_camera, p_body_camera = body_from_camera(camera.pitch_down_rad), np.array(camera.position_m)
    covariance = np.diag([SIGMA_RAD**2] * 3 + [SIGMA_M**2] * 3)
    for at in times:
        R_o, p_o = truth["observer_0"].pose(at)
        R_c, p_c = R_o @ R_body_camera, p_o + R_o @ p_body_camera
        for name in NAMES[1:]:
            if any(name == who and since < at < until for who, since, until in unseen):
                continue
            R, p = truth[name].pose(at)
            turn = Rotation.from_rotvec(rng.normal(0, SIGMA_RAD, 3)).as_matrix()
            rotation, position = turn @ R_c.T @ R, R_c.T @ (p - p_c) + rng.normal(0, SIGMA_M, 3)
            if rng.random() < outliers:
                position = position + rng.normal(0, 0.3, 3)
            stamp = at + clock_s.get("camera observer_0", 0.0)
            yield at, PoseSighting(stamp, "observer_0", name, rotation, position, covariance)

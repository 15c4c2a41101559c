"""The thesis's own filter, for comparison: one EKF of 15 error states a robot, in NumPy over a batch of teams.

As thesis chapter 5 has it: the IMU propagates robots that are told to move; robots told to stand have no velocity and
no propagation, and neither gravity nor the gyro's bias is read off at rest; no wheels, no gate but the camera's range,
no first-estimate Jacobians, no calibration states. A pose's covariance is that of one pixel (eq 5.7).

Where this departs from the printed equations: the measurement is (5.11)-(5.13) with the lever arm in the body frame and
out of the rotation block, in Hamilton's convention, R = Exp(theta) R_hat; (5.14) has 15 columns a robot, not 16.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_envs.agents.team import Team
from coop_envs.sensing.camera import body_from_camera
from coop_envs.sensing.measurements import Measurements

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIZE = 15
THETA, POSITION, VELOCITY, GYRO, ACCEL = (slice(k, k + 3) for k in (0, 3, 6, 9, 12))
GRAVITY = np.array([0.0, 0.0, -9.81])
OBSERVER = 0


@dataclass(frozen=True)
class ThesisSettings:
    """Noise and weights of the filter.

    The authors' launch files give 1.0 and 4.0 as variances of gyro and accelerometer, and 0.001 of the walks of their
    biases. As densities in rad and m they would add 10 degrees of heading noise a frame, so that the gyro would count
    for nothing and fusion could not turn out better than the camera alone, as it did (Table 5.2). They are read here as
    variances of a sample: (1 deg/s)^2 and (2 m/s^2)^2, what an MPU-6050 on tracks may show at 30 Hz; the walks in
    deg/s and m/s^2 alike.

    As the authors have it, only the diagonal of a pose's covariance counts; it is divided by 10 while the observer
    moves and multiplied by 10 while it stands. Initial variances are 1e-25, and 100 for a picket never seen.
    """

    gyro_variance: float = float(np.deg2rad(1.0)) ** 2
    accel_variance: float = 4.0
    gyro_walk: float = 0.001 * float(np.deg2rad(1.0)) ** 2
    accel_walk: float = 0.001
    pixel_px: float = 1.0
    moving_weight: float = 10.0
    resting_weight: float = 0.1
    start_variance: float = 1e-25
    unseen_variance: float = 100.0
    range_m: float = 3.0
    motion_model: bool = True
    """False: the camera alone (thesis section 5.3.2); robots that move walk at random, by the next two a second."""
    walk_m2_s: float = 0.004
    walk_rad2_s: float = 0.1


class ThesisFilter:
    """Beliefs of B teams: ``position`` (B, N, 3), ``rotation`` (B, N, 3, 3), ``covariance`` (B, 15 N, 15 N)."""

    def __init__(self, team: Team, starts: Array, settings: ThesisSettings | None = None) -> None:
        """Everybody at rest and level at ``starts`` (B, N, 3): x, y, yaw in the team frame."""
        self.settings = settings or ThesisSettings()
        teams, robots, _ = starts.shape
        self.shape = teams, robots
        camera = team.members[OBSERVER].camera
        assert camera is not None, "a team's first observer has a camera"
        self.R_body_camera = body_from_camera(camera.pitch_down_rad)
        self.p_body_camera = np.array(camera.position_m)
        self.focal_px = np.array([camera.fx_px, camera.fy_px])
        leds = [member.hat.leds if member.hat else () for member in team.members]
        self.hats = [np.array([led.position_m for led in hat]).reshape(-1, 3) for hat in leds]
        self.position = np.concatenate([starts[..., :2], np.zeros((teams, robots, 1))], axis=-1)
        upright = starts[..., 2].reshape(-1, 1) * [0.0, 0.0, 1.0]
        self.rotation = Rotation.from_rotvec(upright).as_matrix().reshape(teams, robots, 3, 3)
        self.velocity, self.gyro_bias, self.accel_bias = (np.zeros((teams, robots, 3)) for _ in range(3))
        diagonal = np.full((teams, robots, SIZE), self.settings.start_variance)
        diagonal[:, 1:, :6] = self.settings.unseen_variance
        self.covariance = np.zeros((teams, robots * SIZE, robots * SIZE))
        self.covariance[:, range(robots * SIZE), range(robots * SIZE)] = diagonal.reshape(teams, -1)

    def step(self, measured: Measurements, moving: Mask, dt_s: float, listen: Mask | None = None) -> None:
        """Take in one frame: propagate the robots told to move (B, N), then update with the poses of the frame.

        Pickets that ``listen`` (N,) leaves out are as if no camera saw them.
        """
        gyro, accel = (np.asarray(a.numpy()[:, :, -1], dtype=np.float64) for a in (measured.gyro, measured.accel))
        for r in range(self.shape[1]):
            self.velocity[~moving[:, r], r] = 0.0
            who = np.flatnonzero(moving[:, r])
            if who.size and self.settings.motion_model:
                self._propagate(who, r, gyro[who, r], accel[who, r], dt_s)
            elif who.size:
                self._wander(who, r, dt_s)
        for j in range(1, self.shape[1]):
            if listen is None or listen[j]:
                self._look(measured, j, moving[:, OBSERVER])

    def _propagate(self, who: NDArray[np.intp], r: int, gyro: Array, accel: Array, dt: float) -> None:
        """Eq (5.5), one sample: state, transition and noise of robot r of these teams."""
        R = self.rotation[who, r]
        force = np.einsum("bij,bj->bi", R, accel - self.accel_bias[who, r])
        eye = np.broadcast_to(np.eye(3), R.shape)
        phi = np.zeros((who.size, SIZE, SIZE))
        phi[:, range(SIZE), range(SIZE)] = 1.0
        phi[:, THETA, GYRO] = -R * dt
        phi[:, VELOCITY, THETA] = -skew(force) * dt
        phi[:, VELOCITY, ACCEL] = -R * dt
        phi[:, POSITION, VELOCITY] = eye * dt
        phi[:, POSITION, THETA] = -0.5 * skew(force) * dt**2
        phi[:, POSITION, ACCEL] = -0.5 * R * dt**2
        velocity = self.velocity[who, r]
        self.position[who, r] += velocity * dt + 0.5 * (force + GRAVITY) * dt**2
        self.velocity[who, r] = velocity + (force + GRAVITY) * dt
        turn = Rotation.from_rotvec((gyro - self.gyro_bias[who, r]) * dt).as_matrix()
        self.rotation[who, r] = R @ turn
        self._carry(who, r, phi, self._noise(dt))

    def _noise(self, dt: float) -> Array:
        """(15, 15) that a sample adds: its white noise held over dt, and the walk of the biases."""
        s = self.settings
        rate, push = np.zeros((SIZE, 3)), np.zeros((SIZE, 3))
        rate[THETA] = np.eye(3) * dt
        push[VELOCITY], push[POSITION] = np.eye(3) * dt, np.eye(3) * 0.5 * dt**2
        noise = s.gyro_variance * rate @ rate.T + s.accel_variance * push @ push.T
        noise[GYRO, GYRO] += np.eye(3) * s.gyro_walk * dt
        noise[ACCEL, ACCEL] += np.eye(3) * s.accel_walk * dt
        return noise

    def _carry(self, who: NDArray[np.intp], r: int, phi: Array, noise: Array) -> None:
        P, own = self.covariance[who], slice(SIZE * r, SIZE * r + SIZE)
        P[:, own] = phi @ P[:, own]
        P[:, :, own] = P[:, :, own] @ np.swapaxes(phi, 1, 2)
        P[:, own, own] += noise
        self.covariance[who] = P

    def _wander(self, who: NDArray[np.intp], r: int, dt: float) -> None:
        """Without a motion model a robot that moves may be anywhere around where it was."""
        first = SIZE * r
        for part, walk in ((THETA, self.settings.walk_rad2_s), (POSITION, self.settings.walk_m2_s)):
            for k in range(first + part.start, first + part.stop):
                self.covariance[who, k, k] += walk * dt

    def _look(self, measured: Measurements, j: int, observer_moves: Mask) -> None:
        """Update with the pose of picket j where this frame has one within range: eqs (5.9)-(5.16)."""
        p_z = np.asarray(measured.p_camera_body.numpy()[:, OBSERVER, j], dtype=np.float64)
        seen = measured.seen.numpy()[:, OBSERVER, j].astype(bool) & (
            np.linalg.norm(p_z, axis=-1) <= self.settings.range_m
        )
        who = np.flatnonzero(seen)
        if not who.size:
            return
        R_z = np.asarray(measured.R_camera_body.numpy()[who, OBSERVER, j], dtype=np.float64)
        p_z = p_z[who]
        residual, H = self._compare(who, j, R_z, p_z)
        s = self.settings
        weight = np.where(observer_moves[who], s.moving_weight, s.resting_weight)
        variance = np.diagonal(self._pose_covariance(j, R_z, p_z), axis1=1, axis2=2) / weight[:, None]
        self._update(who, residual, H, variance)

    def _compare(self, who: NDArray[np.intp], j: int, R_z: Array, p_z: Array) -> tuple[Array, Array]:
        """Residual (b, 6) and Jacobian (b, 6, 15 N) of the pose of picket j, rotation first, in camera axes."""
        R_CG = np.swapaxes(self.rotation[who, OBSERVER] @ self.R_body_camera, 1, 2)
        away = self.position[who, j] - self.position[who, OBSERVER]
        p_hat = np.einsum("bij,bj->bi", R_CG, away) - self.R_body_camera.T @ self.p_body_camera
        R_hat = R_CG @ self.rotation[who, j]
        theta = Rotation.from_matrix(R_z @ np.swapaxes(R_hat, 1, 2)).as_rotvec()
        H = np.zeros((who.size, 6, SIZE * self.shape[1]))
        first = SIZE * j
        H[:, :3, THETA], H[:, :3, first : first + 3] = -R_CG, R_CG
        H[:, 3:, THETA] = R_CG @ skew(away)
        H[:, 3:, POSITION], H[:, 3:, first + 3 : first + 6] = -R_CG, R_CG
        return np.concatenate([theta, p_z - p_hat], axis=1), H

    def _pose_covariance(self, j: int, R: Array, p: Array) -> Array:
        """Eq (5.7): (J^T J)^-1 times the variance of a pixel, over all of the hat's LEDs; (b, 6, 6)."""
        arms = np.einsum("bij,kj->bki", R, self.hats[j])
        at = arms + p[:, None]
        x, y, z = at[..., 0], at[..., 1], at[..., 2]
        zero = np.zeros_like(z)
        u = np.stack([1.0 / z, zero, -x / z**2], axis=-1) * self.focal_px[0]
        v = np.stack([zero, 1.0 / z, -y / z**2], axis=-1) * self.focal_px[1]
        rows = np.concatenate([u, v], axis=1)
        arms = np.concatenate([arms, arms], axis=1)
        J = np.concatenate([np.cross(arms, rows), rows], axis=-1)
        return np.linalg.inv(np.swapaxes(J, 1, 2) @ J) * self.settings.pixel_px**2

    def _update(self, who: NDArray[np.intp], residual: Array, H: Array, variance: Array) -> None:
        """Kalman's update with diagonal noise (b, 6), and the corrections to the states."""
        P = self.covariance[who]
        PH = P @ np.swapaxes(H, 1, 2)
        S = H @ PH
        S[:, range(6), range(6)] += variance
        K = np.swapaxes(np.linalg.solve(S, np.swapaxes(PH, 1, 2)), 1, 2)
        P = P - K @ np.swapaxes(PH, 1, 2)
        self.covariance[who] = 0.5 * (P + np.swapaxes(P, 1, 2))
        d = np.einsum("bij,bj->bi", K, residual).reshape(who.size, self.shape[1], SIZE)
        turn = Rotation.from_rotvec(d[..., THETA].reshape(-1, 3)).as_matrix().reshape(*d.shape[:2], 3, 3)
        self.rotation[who] = turn @ self.rotation[who]
        self.position[who] += d[..., POSITION]
        self.velocity[who] += d[..., VELOCITY]
        self.gyro_bias[who] += d[..., GYRO]
        self.accel_bias[who] += d[..., ACCEL]


def skew(v: Array) -> Array:
    """[v]x of vectors (..., 3)."""
    zero = np.zeros_like(v[..., 0])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*v.shape, 3)

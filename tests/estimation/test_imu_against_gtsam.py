"""The filter's IMU against GTSAM's: propagation by preintegration, and two inchworm increments by a batch smoother."""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X
from scipy.spatial.transform import Rotation

from coop_envs.agents.command import allocate_command
from coop_envs.agents.specification import Imu
from coop_envs.estimation.belief import Belief
from coop_envs.estimation.settings import Estimation
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.sensing.camera import body_from_camera
from coop_envs.sensing.measurements import allocate_measurements
from tests.estimation.bench import TEAM
from tests.estimation.teams import Teams

TICK_S = 1.0 / 30.0
PRIOR = Estimation(wheels=False, start_position_m=0.01, start_height_m=0.02, start_yaw_rad=0.03, start_tilt_rad=0.05)
OBSERVER, PICKETS, LANES = 0, (1, 2), (0.0, 0.12, -0.12)
UNBIASED = gtsam.imuBias.ConstantBias()
FIRM = 1e-6


def preintegration(imu: Imu, moving: bool, tick_s: float) -> gtsam.PreintegratedCombinedMeasurements:
    """GTSAM's account of the same IMU: white noise, walks, and what noise within a tick does to the position."""
    gyro, accel = imu.gyro_noise_rad_s_rthz, imu.accel_noise_m_s2_rthz
    if moving:
        gyro, accel = gyro + imu.moving_gyro_noise_rad_s_rthz, accel + imu.moving_accel_noise_m_s2_rthz
    eye, params = np.eye(3), gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    params.setGyroscopeCovariance(gyro**2 * eye)
    params.setAccelerometerCovariance(accel**2 * eye)
    params.setIntegrationCovariance((accel * tick_s) ** 2 / 12.0 * eye)
    params.setBiasOmegaCovariance(imu.gyro_walk_rad_s2_rthz**2 * eye)
    params.setBiasAccCovariance(imu.accel_walk_m_s3_rthz**2 * eye)
    return gtsam.PreintegratedCombinedMeasurements(params, UNBIASED)


def to_ours(pose: gtsam.Pose3) -> np.ndarray:
    """(15, 15) from GTSAM's errors (theta and p in the body, v, b_a, b_g) to ours (theta, p, v, b_g, b_a)."""
    A = np.zeros((15, 15))
    A[:3, :3] = A[3:6, 3:6] = pose.rotation().matrix()
    A[6:9, 6:9] = A[9:12, 12:15] = A[12:15, 9:12] = np.eye(3)
    return A


def insert(values: gtsam.Values, key: int, pose: gtsam.Pose3, velocity: np.ndarray) -> None:
    values.insert(X(key), pose)
    values.insert(V(key), velocity)
    values.insert(B(key), UNBIASED)


def add_prior(graph, values, key: int, start: np.ndarray, settings: Estimation, imu: Imu, exact: bool = False) -> None:
    """A robot as people set it down at x, y, yaw, its IMU as it is switched on."""
    tilt, sigmas = settings.start_tilt_rad, (settings.start_yaw_rad, settings.start_position_m, settings.start_height_m)
    yaw, place, height = (1e-5,) * 3 if exact else sigmas
    on_pose = gtsam.noiseModel.Diagonal.Sigmas(np.array([tilt, tilt, yaw, place, place, height]))
    on_bias = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([imu.accel_bias_m_s2, imu.gyro_bias_rad_s], 3))
    pose = gtsam.Pose3(gtsam.Rot3.Yaw(float(start[2])), np.array([start[0], start[1], 0.0], dtype=float))
    insert(values, key, pose, np.zeros(3))
    graph.add(gtsam.PriorFactorPose3(X(key), pose, on_pose))
    graph.add(gtsam.PriorFactorVector(V(key), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 1e-3)))
    graph.add(gtsam.PriorFactorConstantBias(B(key), UNBIASED, on_bias))


class Mover:
    """A robot that drives and sways for a while: what its IMU says, told to the filter and to GTSAM."""

    start = np.array([[0.3, -0.2, 0.7], [1.0, 0.2, -2.0], [1.0, -0.4, 0.0]])
    robot = 1

    def __init__(self, seconds: float, ticks: int, seed: int, tick_s: float = TICK_S) -> None:
        rng = np.random.default_rng(seed)
        self.windows, self.ticks, self.tick_s = round(seconds / tick_s / ticks), ticks, tick_s
        t = np.arange(self.windows * ticks)[:, None] * tick_s
        rate, phase = rng.uniform(1.0, 4.0, (2, 3)), rng.uniform(0.0, 6.0, (2, 3))
        gyro = np.array([0.4, 0.3, 0.9]) * np.sin(rate[0] * t + phase[0])
        accel = np.array([0.0, 0.0, 9.81]) + np.array([1.0, 0.7, 0.5]) * np.sin(rate[1] * t + phase[1])
        self.gyro, self.accel = gyro.astype(np.float32), accel.astype(np.float32)
        self.imu = TEAM.members[self.robot].robot.imu

    def filtered(self) -> Belief:
        """The belief after it all; all robots feel the same, none is seen."""
        measured, command = allocate_measurements(1, 3, self.ticks, "cpu"), allocate_command(1, 3, self.ticks, "cpu")
        team = TeamFilter(TEAM, PRIOR, measured, command)
        measured.heard.fill_(1)
        measured.wheels.fill_(1.0)
        team.reset(self.start[None])
        for k in range(self.windows):
            window = np.s_[k * self.ticks : (k + 1) * self.ticks]
            measured.gyro.assign(np.tile(self.gyro[window], (1, 3, 1, 1)))
            measured.accel.assign(np.tile(self.accel[window], (1, 3, 1, 1)))
            team.step(self.ticks * self.tick_s)
        return team.belief

    def preintegrated(self) -> tuple[gtsam.Values, gtsam.Marginals]:
        """GTSAM's posterior from the same prior and one factor."""
        pim = preintegration(self.imu, True, self.tick_s)
        for gyro, accel in zip(self.gyro.astype(float), self.accel.astype(float), strict=True):
            pim.integrateMeasurement(accel, gyro, self.tick_s)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        add_prior(graph, values, 0, self.start[self.robot], PRIOR, self.imu)
        graph.add(gtsam.CombinedImuFactor(X(0), V(0), X(1), V(1), B(0), B(1), pim))
        there = pim.predict(gtsam.NavState(values.atPose3(X(0)), np.zeros(3)), UNBIASED)
        insert(values, 1, there.pose(), there.velocity())
        return values, gtsam.Marginals(graph, values)

    def apart(self) -> np.ndarray:
        """(3,) by how much attitude (rad), position and velocity of the two means differ."""
        belief, (values, _) = self.filtered(), self.preintegrated()
        pose = values.atPose3(X(1))
        R, p, v = (getattr(belief, name).numpy()[0, self.robot] for name in ("rotation", "position", "velocity"))
        turn = Rotation.from_matrix(R @ pose.rotation().matrix().T).magnitude()
        return np.array([turn, *(np.linalg.norm(d) for d in (p - pose.translation(), v - values.atVector(V(1))))])


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("seconds", "ticks"), [(1.0, 1), (3.0, 1), (3.0, 6)])
def test_covariance_grows_as_in_preintegration(seconds, ticks, seed):
    mover = Mover(seconds, ticks, seed)
    belief, (values, marginals) = mover.filtered(), mover.preintegrated()
    keys = [X(1), V(1), B(1)]
    joint = marginals.jointMarginalCovariance(keys)
    A = to_ours(values.atPose3(X(1)))
    theirs = A @ np.block([[joint.at(a, b) for b in keys] for a in keys]) @ A.T
    row = 15 * int(belief.slot.numpy()[0, mover.robot])
    ours = belief.covariance.numpy()[0, row : row + 15, row : row + 15]
    sigma = np.sqrt(np.diag(theirs))
    np.testing.assert_allclose(ours / np.outer(sigma, sigma), theirs / np.outer(sigma, sigma), atol=0.01)


@pytest.mark.parametrize("seed", range(2))
def test_attitude_is_the_product_of_its_turns(seed):
    mover = Mover(3.0, 6, seed)
    turned = Rotation.from_euler("z", mover.start[mover.robot, 2])
    for gyro in mover.gyro.astype(float):
        turned = turned * Rotation.from_rotvec(gyro * TICK_S)
    np.testing.assert_allclose(mover.filtered().rotation.numpy()[0, mover.robot], turned.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_means_meet_as_ticks_get_short(seed):
    # GTSAM's preintegration is of first order in the tick, so four times shorter ticks bring it four times closer
    coarse, fine = (Mover(3.0, 6, seed, TICK_S / k).apart() for k in (1, 4))
    assert np.all(fine < [6e-4, 6e-3, 7e-3]), fine
    assert np.all(fine < 0.3 * coarse), (coarse, fine)


class Increments:
    """What a team of three measures, and its filter makes of it, tick by tick over inchworm increments in sight."""

    names = ("stationary", "rest_s", "seen", "averaged", "rotation", "position", "velocity")
    told = ("gyro", "accel", "wheels", "p_camera_body", "R_camera_body", "covariance")

    def __init__(self, increments: int, seed: int) -> None:
        firm = {"slip_position_m_rts": FIRM, "slip_heading_rad_rts": FIRM, "wheels": False}
        every_frame = {"ticks_per_decision": 1}
        self.teams = Teams("u_turn", seed=seed, estimation=firm, sensing={"outlier": 0.0}, rates=every_frame)
        self.ticks: list[dict[str, np.ndarray]] = []
        self.note()
        self.rest(45)
        for _ in range(increments):
            for r in (*PICKETS, OBSERVER):
                for _ in range(48):
                    self.teams.act({r: self.teams.steer(r, LANES[r])})
                    self.note()
                self.rest(30)

    def rest(self, ticks: int) -> None:
        for _ in range(ticks):
            self.teams.rest(1)
            self.note()

    def note(self) -> None:
        told = {name: getattr(self.teams.batch.measurements, name).numpy()[0].astype(float) for name in self.told}
        self.ticks.append(told | {name: self.teams.belief(name)[0] for name in self.names})

    def rest_is_fused(self, k: int, r: int) -> bool:
        """Whether the filter looks at a resting robot's IMU in this tick: for two seconds, then once in two."""
        rest_s = float(self.ticks[k]["rest_s"][r])
        return rest_s < 2.0 or np.floor(rest_s / 2.0) > np.floor((rest_s - np.float32(TICK_S)) / 2.0)

    def is_fused(self, k: int, j: int) -> bool:
        """Whether the filter takes in the sighting of robot j, which it only checks once a view has become old."""
        now, before = self.ticks[k], self.ticks[max(k - 1, 0)]
        rests = now["stationary"][OBSERVER] and now["stationary"][j]
        told_more = k == 0 or now["averaged"][OBSERVER, j] > before["averaged"][OBSERVER, j]
        return bool(now["seen"][OBSERVER, j]) and (not rests or told_more)


class Smoother:
    """A graph of what the filter takes in: IMU between frames, poses kept and no velocity at rest, sightings."""

    def __init__(self, drive: Increments) -> None:
        self.drive, self.members = drive, drive.teams.scenario.team.members
        self.graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        n = len(self.members)
        self.key, self.resting = [100_000 * r for r in range(n)], [[] for _ in range(n)]
        self.unmodelled_s = np.zeros(n)
        camera: Any = self.members[OBSERVER].camera
        self.T_body_camera = gtsam.Pose3(
            gtsam.Rot3(body_from_camera(camera.pitch_down_rad)), np.array(camera.position_m)
        )
        for r in range(n):
            start, imu = drive.teams.batch.pool.starts[0, r], self.members[r].robot.imu
            add_prior(self.graph, self.values, self.key[r], start, drive.teams.scenario.estimation, imu, r == OBSERVER)
        for k in range(len(drive.ticks)):
            self.add_tick(k)
        for r in range(n):
            self.end_rest(r)

    def add_tick(self, k: int) -> None:
        for r in range(len(self.members)):
            if not self.drive.ticks[k]["stationary"][r]:
                self.end_rest(r)
                self.move(k, r)
            elif self.drive.rest_is_fused(k, r):
                self.let_biases_walk(r)
                self.resting[r].append(k)
            else:
                self.end_rest(r)
                self.unmodelled_s[r] += TICK_S
        for j in PICKETS:
            if self.drive.is_fused(k, j):
                self.see(k, j)

    def next_key(self, r: int, pose: gtsam.Pose3, velocity: np.ndarray) -> tuple[int, int]:
        """The robot's last key and a new one."""
        before, self.key[r] = self.key[r], self.key[r] + 1
        insert(self.values, self.key[r], pose, velocity)
        return before, self.key[r]

    def keep_pose(self, r: int) -> tuple[int, int]:
        """A new key of a robot that stays where it is."""
        a, b = self.next_key(r, self.values.atPose3(X(self.key[r])), np.zeros(3))
        six, three = (gtsam.noiseModel.Isotropic.Sigma(size, FIRM) for size in (6, 3))
        self.graph.add(gtsam.BetweenFactorPose3(X(a), X(b), gtsam.Pose3(), six))
        self.graph.add(gtsam.BetweenFactorVector(V(a), V(b), np.zeros(3), three))
        return a, b

    def add_imu(self, r: int, ticks: list[int], a: int, b: int, moving: bool) -> None:
        pim = preintegration(self.members[r].robot.imu, moving, TICK_S)
        for k in ticks:
            tick = self.drive.ticks[k]
            pim.integrateMeasurement(tick["accel"][r, 0], tick["gyro"][r, 0], TICK_S)
        self.graph.add(gtsam.CombinedImuFactor(X(a), V(a), X(b), V(b), B(a), B(b), pim))

    def move(self, k: int, r: int) -> None:
        """One tick on the move; the believed pose starts the search."""
        self.let_biases_walk(r)
        tick = self.drive.ticks[k]
        rotation = gtsam.Rot3(Rotation.from_matrix(tick["rotation"][r]).as_matrix())
        a, b = self.next_key(r, gtsam.Pose3(rotation, tick["position"][r]), tick["velocity"][r])
        self.add_imu(r, [k], a, b, bool(np.linalg.norm(tick["wheels"][r]) > 1e-3))

    def end_rest(self, r: int) -> None:
        """No velocity over the ticks of rest, and what the IMU told in them: its biases and where gravity is."""
        ticks, self.resting[r] = self.resting[r], []
        if ticks:
            still = gtsam.noiseModel.Isotropic.Sigma(3, 1e-3 / np.sqrt(len(ticks)))
            self.graph.add(gtsam.PriorFactorVector(V(self.key[r]), np.zeros(3), still))
            a, b = self.keep_pose(r)
            self.add_imu(r, ticks, a, b, moving=False)

    def let_biases_walk(self, r: int) -> None:
        """Over the ticks of rest in which the filter does not look at the IMU."""
        imu, root = self.members[r].robot.imu, np.sqrt(self.unmodelled_s[r])
        if root > 0.0:
            a, b = self.keep_pose(r)
            walk = root * np.repeat([imu.accel_walk_m_s3_rthz, imu.gyro_walk_rad_s2_rthz], 3)
            self.graph.add(
                gtsam.BetweenFactorConstantBias(B(a), B(b), UNBIASED, gtsam.noiseModel.Diagonal.Sigmas(walk))
            )
        self.unmodelled_s[r] = 0.0

    def see(self, k: int, j: int) -> None:
        """A pose in the camera; our error acts from the left in the camera's axes, GTSAM's in the robot's own."""
        tick = self.drive.ticks[k]
        R = Rotation.from_matrix(tick["R_camera_body"][OBSERVER, j]).as_matrix()
        A = np.kron(np.eye(2), R.T)
        noise = gtsam.noiseModel.Gaussian.Covariance(A @ tick["covariance"][OBSERVER, j] @ A.T)
        seen = self.T_body_camera.compose(gtsam.Pose3(gtsam.Rot3(R), tick["p_camera_body"][OBSERVER, j]))
        self.graph.add(gtsam.BetweenFactorPose3(X(self.key[OBSERVER]), X(self.key[j]), seen, noise))

    def solve(self) -> tuple[gtsam.Values, gtsam.Marginals]:
        values = gtsam.LevenbergMarquardtOptimizer(self.graph, self.values).optimize()
        return values, gtsam.Marginals(self.graph, values)


@pytest.mark.parametrize("seed", range(4))
def test_two_increments_end_where_a_batch_smoother_ends_and_as_sure(seed):
    drive = Increments(2, seed)
    smoother = Smoother(drive)
    values, marginals = smoother.solve()
    assert smoother.graph.error(values) < 0.5 * sum(factor.dim() for factor in factors(smoother.graph))
    for r, key in enumerate(smoother.key):
        pose = values.atPose3(X(key))
        A = to_ours(pose)[:6, :6]
        theirs, ours = A @ marginals.marginalCovariance(X(key)) @ A.T, drive.teams.belief("pose_covariance")[0, r]
        R, p = drive.teams.belief("rotation")[0, r], drive.teams.belief("position")[0, r]
        theta = Rotation.from_matrix(R @ pose.rotation().matrix().T).as_rotvec()
        sigma = np.sqrt(np.diag(theirs))
        assert np.all(np.abs([*theta, *(p - pose.translation())]) < 0.5 * sigma)
        shares = np.linalg.eigvals(np.linalg.solve(theirs, ours)).real
        assert shares.min() > 0.93 and shares.max() < 1.07, shares  # of variance, along any direction


def factors(graph: gtsam.NonlinearFactorGraph) -> list[Any]:
    return [graph.at(k) for k in range(graph.size())]

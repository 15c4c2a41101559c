"""The filter against a batch least-squares smoother that shares none of our code: GTSAM."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coop_envs.sensing.camera import body_from_camera
from tests.estimation.teams import Teams

OBSERVER, PICKETS = 0, (1, 2)
SIGHTINGS = 20


def pose3(R, p) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(Rotation.from_matrix(R).as_matrix()), np.asarray(p, dtype=float))


def right_noise(R: np.ndarray, covariance: np.ndarray):
    """Our error (theta, delta) acts from the left in the axes of the parent; GTSAM's acts in the child's own."""
    A = np.kron(np.eye(2), R.T)
    return gtsam.noiseModel.Gaussian.Covariance(A @ covariance @ A.T)


def prior_noise(settings, member: int):
    """The filter's own prior on a robot that people set down."""
    exact = member == OBSERVER
    yaw, place, height = (
        (1e-5,) * 3 if exact else (settings.start_yaw_rad, settings.start_position_m, settings.start_height_m)
    )
    tilt = settings.start_tilt_rad
    return gtsam.noiseModel.Diagonal.Sigmas(np.array([tilt, tilt, yaw, place, place, height]))


class Batch:
    """A graph of one pose a robot and stay, built from the measurements of one team."""

    def __init__(self, teams: Teams) -> None:
        self.teams, self.graph, self.values = teams, gtsam.NonlinearFactorGraph(), gtsam.Values()
        camera = teams.scenario.team.members[OBSERVER].camera
        assert camera is not None
        self.camera = pose3(body_from_camera(camera.pitch_down_rad), camera.position_m)

    def add_robot(self, key: int, member: int) -> None:
        plan = self.teams.batch.pool.starts[0, member]
        start = pose3(Rotation.from_euler("z", plan[2]).as_matrix(), [plan[0], plan[1], 0.0])
        self.values.insert(key, start)
        self.graph.add(gtsam.PriorFactorPose3(key, start, prior_noise(self.teams.scenario.estimation, member)))

    def add_gravity(self, key: int, member: int, decisions: int) -> None:
        """What the accelerometer told at rest, its bias as known as at switch-on."""
        imu = self.teams.scenario.team.members[member].robot.imu
        sigma = np.hypot(imu.accel_bias_m_s2, imu.accel_noise_m_s2_rthz / np.sqrt(decisions * 0.2)) / 9.81
        noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
        up = self.force[member] / np.linalg.norm(self.force[member])
        self.graph.add(gtsam.AttitudeFactorPose3(key, gtsam.Unit3(np.array([0.0, 0.0, 1.0])), noise, gtsam.Unit3(up)))

    def watch(self, observer_key: int, keys: dict[int, int], decisions: int) -> None:
        """Take in what the camera sees and the accelerometers feel while the team rests, the last decision included."""
        self.force = np.zeros((self.teams.n, 3))
        m = self.teams.batch.measurements
        for k in range(decisions):
            if k > 0:
                self.teams.rest(1)
            self.force += m.accel.numpy()[0].astype(float).mean(axis=1) / decisions
            for j, key in keys.items():
                if m.seen.numpy()[0, OBSERVER, j]:
                    R = m.R_camera_body.numpy()[0, OBSERVER, j].astype(float)
                    p = m.p_camera_body.numpy()[0, OBSERVER, j].astype(float)
                    noise = right_noise(R, m.covariance.numpy()[0, OBSERVER, j])
                    measured = self.camera.compose(pose3(R, p))
                    self.graph.add(gtsam.BetweenFactorPose3(observer_key, key, measured, noise))

    def add_stay(self, key: int, member: int) -> None:
        """A pose that nothing but sightings tells of; the believed one starts the search."""
        self.values.insert(
            key, pose3(self.teams.belief("rotation")[0, member], self.teams.belief("position")[0, member])
        )

    def solve(self) -> tuple[gtsam.Values, gtsam.Marginals]:
        values = gtsam.LevenbergMarquardtOptimizer(self.graph, self.values).optimize()
        return values, gtsam.Marginals(self.graph, values)


def check_against(
    teams: Teams, member: int, values: gtsam.Values, marginals: gtsam.Marginals, key: int, apart_m: float, share: float
) -> None:
    """The filter's pose within a distance of the smoother's and a share of its sigma, and sigmas alike."""
    pose = values.atPose3(key)
    R, p = teams.belief("rotation")[0, member], teams.belief("position")[0, member]
    A = np.kron(np.eye(2), pose.rotation().matrix())
    sigma = np.sqrt(np.diag(A @ marginals.marginalCovariance(key) @ A.T))
    ours = np.sqrt(np.diag(teams.belief("pose_covariance")[0, member]))
    theta = Rotation.from_matrix(R @ pose.rotation().matrix().T).as_rotvec()
    shift = p - pose.translation()
    assert np.linalg.norm(shift) < apart_m
    assert np.all(np.abs([*theta, *shift]) < share * sigma + 1e-4), ([*theta, *shift], sigma)
    np.testing.assert_allclose(ours, sigma, rtol=0.35, atol=2e-4)


@pytest.fixture(params=range(4))
def teams(request):
    """One inchworm team whose robots stand on ground that does not give."""
    firm = {"slip_position_m_rts": 1e-6, "slip_heading_rad_rts": 1e-6}
    return Teams("u_turn", seed=request.param, estimation=firm, sensing={"outlier": 0.0})


def rest_and_solve(teams: Teams) -> Batch:
    """The first stay: everybody where people put them."""
    batch = Batch(teams)
    for member in (OBSERVER, *PICKETS):
        batch.add_robot(member, member)
    batch.watch(OBSERVER, {j: j for j in PICKETS}, SIGHTINGS)
    for member in (OBSERVER, *PICKETS):
        batch.add_gravity(member, member, SIGHTINGS)
    return batch


def test_a_team_at_rest(teams):
    values, marginals = rest_and_solve(teams).solve()
    for member in PICKETS:
        check_against(teams, member, values, marginals, member, apart_m=4e-4, share=0.3)


def test_a_picket_that_moved_in_the_dark_and_an_observer_that_followed(teams):
    batch = rest_and_solve(teams)
    move_in_the_dark(teams, 1, 0.12)
    batch.add_stay(11, 1)
    batch.watch(OBSERVER, {1: 11, 2: 2}, 5)
    move_in_the_dark(teams, OBSERVER, 0.0)
    batch.add_stay(10, OBSERVER)
    batch.watch(10, {1: 11, 2: 2}, SIGHTINGS)
    batch.add_gravity(10, OBSERVER, SIGHTINGS)
    batch.add_gravity(11, 1, SIGHTINGS)
    values, marginals = batch.solve()
    # the filter also has the IMU and the wheels, so the two differ by up to the smoother's own uncertainty
    for member, key in ((1, 11), (OBSERVER, 10)):
        check_against(teams, member, values, marginals, key, apart_m=2e-3, share=2.5)


def move_in_the_dark(teams: Teams, member: int, lane_y_m: float) -> None:
    """Drive a robot 0.2 m on with all hats dark, so that nobody is seen meanwhile."""
    for _ in range(6):
        teams.act({member: teams.steer(member, lane_y_m)}, brightness=-1.0)
    for _ in range(5):
        teams.act({}, brightness=-1.0)
    teams.rest(1)

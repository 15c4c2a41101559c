from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from coop_envs.estimation.fixes import FixFuser
from tests.localization.placed_team import ROBOTS, SIZE, believe, new_filter

R_INDEX = 2
SHIFT = np.array([0.012, -0.008, 0.01, 0.02, -0.015, 0.01])


@pytest.fixture
def bench():
    team = new_filter()
    P = believe(team, np.random.default_rng(3))
    return team, P, FixFuser(team.belief, team.rows)


def fix_covariance() -> np.ndarray:
    A = np.random.default_rng(4).normal(size=(6, 6)) * 0.01
    return A @ A.T + 1e-5 * np.eye(6)


def told(team, shift):
    """Pose of the robot as believed, moved by (theta, p)."""
    state = team.snapshot()
    turn = Rotation.from_rotvec(shift[:3]).as_matrix()
    return state["position"][0, R_INDEX] + shift[3:], turn @ state["rotation"][0, R_INDEX]


def difference(after, before) -> np.ndarray:
    """The error (15 N,) between two beliefs."""
    theta = Rotation.from_matrix(after["rotation"][0] @ np.swapaxes(before["rotation"][0], -1, -2)).as_rotvec()
    names = ("position", "velocity", "gyro_bias", "accel_bias")
    return np.stack([theta, *(after[name][0] - before[name][0] for name in names)], axis=1).ravel()


def transported(P, before, after) -> np.ndarray:
    """A covariance carried from where an update was linearised to where it went, errors by p - [shift]x theta."""
    T = np.eye(len(P))
    for r in range(ROBOTS):
        for first, name in ((3, "position"), (6, "velocity")):
            x, y, z = after[name][0, r] - before[name][0, r]
            row = SIZE * r
            T[row + first : row + first + 3, row : row + 3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return T @ P @ T.T


@pytest.mark.parametrize("whole", [False, True])
def test_a_fix_is_a_textbook_update_of_the_whole_team(bench, whole):
    team, P, fuser = bench
    before = team.snapshot()
    assert np.allclose(before["covariance"][0, : len(P), : len(P)], P)
    covariance = fix_covariance()
    position, rotation = told(team, SHIFT)
    first = SIZE * R_INDEX + (0 if whole else 3)
    H = np.eye(len(P))[first : SIZE * R_INDEX + 6]
    noise = covariance if whole else covariance[3:, 3:]
    residual = SHIFT if whole else SHIFT[3:]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
    assert fuser.fuse(R_INDEX, position, rotation if whole else None, noise)
    after = team.snapshot()
    sigma = np.sqrt(np.diag(P))
    # Exp(theta) of the whole correction is the only step, so that states agree to rounding
    np.testing.assert_allclose(difference(after, before) / sigma, K @ residual / sigma, atol=1e-6)
    A = np.eye(len(P)) - K @ H
    expected = transported(A @ P @ A.T + K @ noise @ K.T, before, after)
    ours = after["covariance"][0, : len(P), : len(P)]
    np.testing.assert_allclose(ours / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-9)
    np.testing.assert_array_equal(ours, ours.T)


def test_the_pose_covariance_follows(bench):
    team, _, fuser = bench
    position, _ = told(team, SHIFT)
    fuser.fuse(R_INDEX, position, None, fix_covariance()[3:, 3:])
    state = team.snapshot()
    for r in range(ROBOTS):
        row = SIZE * int(state["slot"][0, r])
        np.testing.assert_array_equal(
            state["pose_covariance"][0, r], state["covariance"][0, row : row + 6, row : row + 6]
        )


@pytest.mark.parametrize("whole", [False, True])
def test_a_fix_beyond_the_gate_changes_nothing(bench, whole):
    team, _, fuser = bench
    position, rotation = told(team, 20 * SHIFT)
    before = team.snapshot()
    covariance = fix_covariance() if whole else fix_covariance()[3:, 3:]
    assert not fuser.fuse(R_INDEX, position, rotation if whole else None, covariance)
    after = team.snapshot()
    for name in ("position", "rotation", "velocity", "covariance", "pose_covariance"):
        np.testing.assert_array_equal(before[name], after[name])


@pytest.mark.parametrize(("distance", "passes"), [(16.2, True), (16.3, False)])
def test_the_gate_stands_at_999_in_1000_of_three_degrees_of_freedom(bench, distance, passes):
    team, P, fuser = bench
    assert 16.2 < chi2.ppf(0.999, 3) < 16.3
    row = SIZE * R_INDEX + 3
    S = P[row : row + 3, row : row + 3] + 1e-4 * np.eye(3)
    way = np.random.default_rng(6).normal(size=3)
    shift = np.linalg.cholesky(S) @ (np.sqrt(distance) * way / np.linalg.norm(way))
    place = team.snapshot()["position"][0, R_INDEX]
    assert fuser.fuse(R_INDEX, place + shift, None, 1e-4 * np.eye(3)) == passes


def test_a_robot_outside_the_filter_is_refused(bench):
    team, _, fuser = bench
    state = team.snapshot()
    state["slot"][0, R_INDEX] = -1
    team.restore(state)
    assert not fuser.fuse(R_INDEX, state["position"][0, R_INDEX], None, 1e-4 * np.eye(3))

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chi2

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.events import Trajectory
from coop_envs.localization.logs.tum import read_tum, write_tum
from coop_envs.localization.trajectories import covered, drift, in_team_frame, interpolated, nees, path_length_m


def yawed(times, xyz, yaw) -> Trajectory:
    return Trajectory(np.array(times, dtype=float), np.array(xyz, dtype=float), about_z(yaw))


def about_z(yaw) -> np.ndarray:
    return Rotation.from_euler("z", np.atleast_1d(yaw)[:, None]).as_matrix().reshape(-1, 3, 3)


def random_trajectory(count: int, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0.0, 0.3 * count, count))
    return Trajectory(times, rng.normal(size=(count, 3)), Rotation.random(count, rng).as_matrix())


def test_interpolation_against_scipy():
    truth = random_trajectory(50)
    times = np.concatenate([np.linspace(truth.time_s[0], truth.time_s[-1], 333), truth.time_s])
    found = interpolated(truth, times)
    slerp = Slerp(truth.time_s, Rotation.from_matrix(truth.rotation))(times).as_matrix()
    assert np.allclose(found.rotation, slerp, atol=1e-12)
    for axis in range(3):
        assert np.allclose(found.position[:, axis], np.interp(times, truth.time_s, truth.position[:, axis]), atol=1e-12)


def test_interpolation_by_hand():
    between = interpolated(yawed([1, 3], [[0, 0, 0], [4, 2, 0]], [3.0, -3.0]), np.array([1.5]))
    assert np.allclose(between.position, [[1.0, 0.5, 0.0]])
    assert np.allclose(between.rotation, about_z(3.0 + 0.25 * (2 * math.pi - 6.0)))
    with pytest.raises(ConfigError, match=r"time_s: got \[3.5\], expected within 1.5 to 1.5 s"):
        interpolated(between, np.array([3.5]))


def test_what_the_truth_covers():
    truth = yawed([0, 0.4, 2, 2.4], np.zeros((4, 3)), np.zeros(4))
    asked = np.array([-0.1, 0.0, 0.2, 0.4, 1.0, 2.0, 2.4, 2.5])
    assert covered(truth, asked).tolist() == [False, True, True, True, False, True, True, False]
    lone = yawed([1.0], np.zeros((1, 3)), [0.0])
    assert covered(lone, np.array([0.9, 1.0, 1.1])).tolist() == [False, True, False]
    assert np.array_equal(interpolated(lone, np.array([1.0, 1.0])).position, np.zeros((2, 3)))


def test_drift_by_hand():
    """A square of 1 m, half of it: 2 m of path; the estimate ends 3 cm and 4 cm off, turned by 2 degrees."""
    truth = yawed(np.arange(5) * 0.25, [[0, 0, 0], [0.5, 0, 0], [1, 0, 0], [1, 0.5, 0], [1, 1, 0]], [0, 0, 0, 1.5, 1.5])
    estimate = yawed([0.0, 0.3, 1.0], [[0, 0, 0], [0.6, 0, 0], [1.03, 0.96, 0]], [0, 0, 1.5 - math.radians(2)])
    found = drift(estimate, truth)
    assert found.position_m == pytest.approx(0.05) and found.planar_m == pytest.approx(0.05)
    assert found.heading_rad == pytest.approx(math.radians(2)) and found.tilt_rad == pytest.approx(0.0)
    assert found.path_m == pytest.approx(2.0) and found.percent_of_path == pytest.approx(2.5)
    late = yawed([0.0, 1.0, 7.0], [[0, 0, 0], [1, 1, 0.12], [9, 9, 9]], [0, 1.5, 0])
    assert drift(late, truth).position_m == pytest.approx(0.12) and drift(late, truth).planar_m == pytest.approx(0.0)
    with pytest.raises(ConfigError, match="expected times that overlap with the estimate's"):
        drift(yawed([7.0], [[0, 0, 0]], [0.0]), truth)


def test_tilt_and_heading_are_told_apart():
    truth = Trajectory(np.array([0.0]), np.zeros((1, 3)), np.eye(3)[None])
    tilted = Trajectory(
        np.array([0.0]), np.zeros((1, 3)), Rotation.from_euler("y", [[0.1]]).as_matrix().reshape(1, 3, 3)
    )
    found = drift(tilted, truth)
    assert found.tilt_rad == pytest.approx(0.1) and found.heading_rad == pytest.approx(0.0)
    assert math.isnan(found.percent_of_path)


def test_heading_error_across_the_turn():
    found = drift(yawed([0.0], np.zeros((1, 3)), [3.1]), yawed([0.0], np.zeros((1, 3)), [-3.1]))
    assert found.heading_rad == pytest.approx(2 * math.pi - 6.2)


def test_noise_at_rest_is_no_path():
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(size=(1000, 3)) * 1e-3, [[1.0, 0.0, 0.0]]])
    assert path_length_m(points) > 2.0
    assert path_length_m(points, 0.02) == pytest.approx(1.0, abs=0.005)


def test_the_teams_frame_is_where_its_first_robot_began():
    first = yawed([0, 1], [[2, 1, 0.05], [2, 2, 0.05]], [math.pi / 2, math.pi / 2])
    second = yawed([0, 1], [[1, 1, 0.05], [1, 2, 0.05]], [0, 0])
    found = in_team_frame({"a": first, "b": second}, "a", 0.0)
    assert np.allclose(found["a"].position, [[0, 0, 0], [1, 0, 0]]) and np.allclose(found["a"].rotation, np.eye(3))
    assert np.allclose(found["b"].position, [[0, 1, 0], [1, 1, 0]])
    assert np.allclose(found["b"].rotation, about_z([-math.pi / 2] * 2))
    with pytest.raises(ConfigError, match=r"truth: got 3\.0, expected to say where a was at this time"):
        in_team_frame({"a": first}, "a", 3.0)
    with pytest.raises(ConfigError, match=r"truth: got \['a'\], expected a trajectory of b"):
        in_team_frame({"a": first}, "b", 0.0)


@pytest.mark.parametrize(("planar", "freedoms"), [(False, 6), (True, 3)])
def test_nees_has_its_distribution(planar, freedoms):
    """Errors drawn from the covariances give chi-square; twice the errors four times as much."""
    rng, T = np.random.default_rng(0), 4000
    truth = random_trajectory(T)
    A = rng.normal(size=(T, 6, 6)) * 0.01
    P = A @ np.swapaxes(A, 1, 2) + 1e-6 * np.eye(6)
    if planar:
        used = np.array([0, 0, 1, 1, 1, 0], dtype=bool)
        P[:, ~used] = 0.0
        P[:, :, ~used] = 0.0
    e = np.einsum("tij,tj->ti", np.linalg.cholesky(P + 1e-18 * np.eye(6)), rng.normal(size=(T, 6)))

    def distances(scale: float) -> np.ndarray:
        turn = Rotation.from_rotvec(-scale * e[:, :3]) * Rotation.from_matrix(truth.rotation)
        return nees(Trajectory(truth.time_s, truth.position - scale * e[:, 3:], turn.as_matrix()), P, truth, planar)

    low, high = chi2.ppf([0.001, 0.999], freedoms * T) / T
    assert low < distances(1.0).mean() < high
    assert distances(2.0).mean() == pytest.approx(4.0 * distances(1.0).mean(), rel=1e-6)


def test_nees_by_hand_and_where_nothing_is_known():
    truth = yawed([0, 0.5], np.zeros((2, 3)), [0, 0])
    estimate = yawed([0.2, 3.0], [[0.1, 0, 0], [0, 0, 0]], [0.2, 0])
    P = np.tile(np.diag([0.01, 0.01, 0.01, 0.04, 0.04, 0.04]), (2, 1, 1))
    found = nees(estimate, P, truth)
    assert found[0] == pytest.approx(0.2**2 / 0.01 + 0.1**2 / 0.04) and np.isnan(found[1])


def test_tum_comes_back(tmp_path):
    trajectory = random_trajectory(40)
    write_tum(tmp_path / "a.txt", trajectory)
    back = read_tum(tmp_path / "a.txt")
    assert np.allclose(back.time_s, trajectory.time_s, atol=1e-9)
    assert np.allclose(back.position, trajectory.position, atol=1e-9)
    assert np.allclose(back.rotation, trajectory.rotation, atol=1e-8)
    first = (tmp_path / "a.txt").read_text().splitlines()[1].split()
    quaternion = Rotation.from_matrix(trajectory.rotation[0]).as_quat(canonical=True)
    assert np.allclose(
        [float(word) for word in first], [trajectory.time_s[0], *trajectory.position[0], *quaternion], atol=1e-9
    )


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("", "a.txt: got 'no poses', expected a line for each pose"),
        ("# t\n0 0 0 0 0 0 1", "a.txt line 2: got '7 values', expected 8: timestamp tx"),
        ("0 0 0 x 0 0 0 1", "a.txt line 1, tz: got 'x', expected a number"),
        ("0 0 0 nan 0 0 0 1", "a.txt line 1, tz: got 'nan', expected a finite number"),
        ("0 0 0 0 0 0 1 1", r"a.txt line 1, qx, qy, qz, qw: got \[0.0, 0.0, 1.0, 1.0\], expected a norm within 0.01"),
        (
            "1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1",
            "a.txt line 2, timestamp: got 1.0, expected a time after the line before's",
        ),
    ],
)
def test_tum_refused(tmp_path, lines, message):
    (tmp_path / "a.txt").write_text(lines)
    with pytest.raises(ConfigError, match=message):
        read_tum(tmp_path / "a.txt")


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=100))
def test_any_bytes_give_a_plain_refusal(tmp_path, content):
    (tmp_path / "a.txt").write_bytes(content)
    with pytest.raises(ConfigError):
        read_tum(tmp_path / "a.txt")

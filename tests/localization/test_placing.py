from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coop_envs.localization.placing import (
    BodyFix,
    Placement,
    Unplaced,
    carried,
    closed_form,
    gauge,
    place,
    place_by_points,
    place_by_pose,
)
from tests.localization.placed_team import (
    ROBOTS,
    SIZE,
    believe,
    draw_truth,
    new_filter,
    noisy_fix,
    pose_block,
    pose_errors,
    random_frame,
)

POSITIONS, POSE, BOTH = [(0, False), (1, False), (2, False)], [(2, True)], [(0, False), (3, True), (1, False)]


@pytest.fixture(scope="module")
def team():
    return new_filter()


def make_fixes(which, R, p, rng, times=1.0):
    return [noisy_fix(robot, R[robot], p[robot], whole, rng, times) for robot, whole in which]


def test_points_without_noise_are_placed_exactly():
    rng = np.random.default_rng(1)
    R, p = random_frame(rng)
    points = rng.normal(size=(5, 3))
    for K in (3, 5):
        found = place_by_points(
            points[:K], 1e-8 * np.eye(3 * K), points[:K] @ R.T + p, np.tile(1e-6 * np.eye(3), (K, 1, 1))
        )
        assert isinstance(found, Placement)
        np.testing.assert_allclose(found.rotation, R, atol=1e-9)
        np.testing.assert_allclose(found.position, p, atol=1e-9)


def test_closed_form_against_scipy():
    rng = np.random.default_rng(2)
    R, p = random_frame(rng)
    points, weight = rng.normal(size=(6, 3)), rng.uniform(0.5, 2.0, 6)
    seen = points @ R.T + p + rng.normal(size=(6, 3)) * 0.05
    ours, shift = closed_form(points, seen, weight, upright=False)
    centred = (points - weight @ points / weight.sum(), seen - weight @ seen / weight.sum())
    theirs = Rotation.align_vectors(centred[1], centred[0], weights=weight)[0]
    np.testing.assert_allclose(ours, theirs.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(shift, weight @ (seen - points @ ours.T) / weight.sum(), atol=1e-12)


@pytest.mark.parametrize("level_rad", [None, 0.01])
def test_covariance_of_a_placement_by_points(level_rad):
    rng = np.random.default_rng(3)
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, 0.1], [0.3, -0.9, 0.0]])
    A, B = rng.normal(size=(9, 9)) * 0.004, rng.normal(size=(3, 3, 3)) * 0.006
    P_team, P_world = A @ A.T + 1e-6 * np.eye(9), B @ np.swapaxes(B, 1, 2) + 1e-6 * np.eye(3)
    nees = []
    for _ in range(400):
        R, p = random_frame(rng, level_rad)
        believed = points + (np.linalg.cholesky(P_team) @ rng.normal(size=9)).reshape(3, 3)
        seen = points @ R.T + p + (np.linalg.cholesky(P_world) @ rng.normal(size=(3, 3, 1)))[:, :, 0]
        found = place_by_points(believed, P_team, seen, P_world, level_rad)
        assert isinstance(found, Placement)
        e = np.concatenate([Rotation.from_matrix(R @ found.rotation.T).as_rotvec(), p - found.position])
        nees.append(e @ np.linalg.solve(found.covariance, e) / 6)
    # 400 draws of 6 degrees of freedom: the mean has a standard deviation of 0.03
    assert abs(np.mean(nees) - 1.0) < 0.12


def test_covariance_of_a_placement_by_a_pose():
    rng = np.random.default_rng(4)
    team_R, team_p = random_frame(rng)
    own = noisy_fix(0, team_R, team_p, True, rng).covariance
    nees = []
    for _ in range(400):
        R, p = random_frame(rng)
        e = np.linalg.cholesky(own) @ rng.normal(size=6)
        true_R, true_p = Rotation.from_rotvec(e[:3]).as_matrix() @ team_R, team_p + e[3:]
        fix = noisy_fix(0, R @ true_R, R @ true_p + p, True, rng)
        found = place_by_pose(team_R, team_p, own, fix)
        e = np.concatenate([Rotation.from_matrix(R @ found.rotation.T).as_rotvec(), p - found.position])
        nees.append(e @ np.linalg.solve(found.covariance, e) / 6)
    assert abs(np.mean(nees) - 1.0) < 0.12


@pytest.mark.parametrize(
    ("points", "level_rad", "reason"),
    [
        ([[0, 0, 0], [1, 0, 0]], None, "2 positions, where 3"),
        ([[0, 0, 0], [1, 1, 0], [2, 2, 0], [5, 5, 0]], None, "in a line"),
        ([[0, 0, 0], [0, 0, 0], [0, 0, 0]], None, "in a line"),
        ([[0, 0, 0], [1, 1, 0], [2, 2.002, 0]], None, "too near to a line"),
        ([[0, 0, 0]], 0.01, "1 positions, where 2"),
        ([[0, 0, 0], [0, 0, 1]], 0.01, "on one spot"),
        ([], None, "0 positions"),
    ],
)
def test_what_cannot_be_placed_is_said_so(points, level_rad, reason):
    points = np.array(points, dtype=float).reshape(-1, 3)
    noise = np.tile(1e-4 * np.eye(3), (len(points), 1, 1))
    found = place_by_points(points, 1e-4 * np.eye(3 * len(points)), points + 1.0, noise, level_rad)
    assert isinstance(found, Unplaced)
    assert reason in found.reason


def test_a_refused_team_is_left_as_it_was(team):
    rng = np.random.default_rng(5)
    P = believe(team, rng)
    R, p = draw_truth(team, P, rng)
    before = team.snapshot()
    assert isinstance(place(team, make_fixes(POSITIONS[:2], R, p, rng)), Unplaced)
    torn = make_fixes(POSITIONS, R, p, rng)
    torn[1] = BodyFix(1, torn[1].position + [3.0, 0.0, 0.0], None, torn[1].covariance)
    assert isinstance(found := place(team, torn), Unplaced)
    assert "contradict" in found.reason
    after = team.snapshot()
    assert all(np.array_equal(before[name], after[name]) for name in before)


def test_gauge_against_finite_differences():
    rng = np.random.default_rng(6)
    R, p = random_frame(rng)
    own_p, own_v = rng.normal(size=(2, 3))
    own_R = Rotation.random(rng=rng).as_matrix()

    def state(e):
        turned = Rotation.from_rotvec(e[:3]).as_matrix() @ R
        theta = Rotation.from_matrix(turned @ own_R @ (R @ own_R).T).as_rotvec()
        return np.concatenate([theta, turned @ own_p + p + e[3:], turned @ own_v])

    step = 1e-6
    numeric = np.stack([(state(step * u) - state(-step * u)) / (2 * step) for u in np.eye(6)], axis=1)
    np.testing.assert_allclose(gauge(R @ own_p, R @ own_v), numeric, atol=1e-8)


def test_a_carried_belief_says_the_same_of_what_robots_see_of_each_other(team):
    """What is known of robot 2 from robot 1, by finite differences, is untouched by the world's frame."""
    rng = np.random.default_rng(7)
    believe(team, rng)
    before = team.snapshot()
    R, p = random_frame(rng)
    after = carried(before, Placement(R, p, np.diag([0.01, 0.02, 0.03, 0.4, 0.5, 0.6])))

    def relative(state, e):
        turned = [Rotation.from_rotvec(e[6 * k : 6 * k + 3]).as_matrix() @ state["rotation"][0, 1 + k] for k in (0, 1)]
        places = [state["position"][0, 1 + k] + e[6 * k + 3 : 6 * k + 6] for k in (0, 1)]
        R_1_2 = turned[0].T @ turned[1]
        R_hat = state["rotation"][0, 1].T @ state["rotation"][0, 2]
        return np.concatenate(
            [Rotation.from_matrix(R_1_2 @ R_hat.T).as_rotvec(), turned[0].T @ (places[1] - places[0])]
        )

    known = []
    for state in (before, after):
        step = 1e-6
        J = np.stack(
            [(relative(state, step * u) - relative(state, -step * u)) / (2 * step) for u in np.eye(12)], axis=1
        )
        rows = np.concatenate([SIZE * state["slot"][0, r] + np.arange(6) for r in (1, 2)])
        known.append(J @ state["covariance"][0][np.ix_(rows, rows)] @ J.T)
    np.testing.assert_allclose(known[1], known[0], atol=1e-8)


@pytest.mark.parametrize(
    ("which", "level_rad"), [(POSITIONS, None), (POSE, None), (BOTH, None), (POSITIONS[:2], 0.01), (POSITIONS, 0.01)]
)
def test_a_placed_team_knows_how_well_it_is_placed(team, which, level_rad):
    nees = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        P = believe(team, rng)
        R_team, p_team = draw_truth(team, P, rng)
        R, p = random_frame(rng, level_rad)
        R_world, p_world = R @ R_team, p_team @ R.T + p
        found = place(team, make_fixes(which, R_world, p_world, rng), level_rad)
        assert isinstance(found, Placement), found
        e, C = pose_errors(team, R_world, p_world), pose_block(team)
        assert np.linalg.eigvalsh(C)[0] > 0
        nees.append(e @ np.linalg.solve(C, e) / len(e))
    # 60 teams of 24 degrees of freedom: the mean has a standard deviation of 0.04
    assert abs(np.mean(nees) - 1.0) < 0.15, np.mean(nees)


@pytest.mark.parametrize("which", [POSITIONS, POSE, BOTH])
def test_against_gtsam(team, which):
    """A graph of the frame's pose, the robots' poses in it and the fixes, solved at once."""
    rng = np.random.default_rng(8)
    # small errors: the filter linearises once, the graph until nothing changes
    P = believe(team, rng, independent=True, times=0.1)
    before = team.snapshot()
    R_team, p_team = draw_truth(team, P, rng)
    R, p = random_frame(rng)
    fixes = make_fixes(which, R @ R_team, p_team @ R.T + p, rng, times=0.1)
    found = place(team, fixes)
    assert isinstance(found, Placement)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(100, gtsam.Pose3(gtsam.Rot3(R), p))
    for r in range(ROBOTS):
        own, place_ = before["rotation"][0, r], before["position"][0, r]
        noise = right_noise(own, P[SIZE * r : SIZE * r + 6, SIZE * r : SIZE * r + 6])
        graph.add(gtsam.BetweenFactorPose3(100, r, gtsam.Pose3(gtsam.Rot3(own), place_), noise))
        values.insert(r, gtsam.Pose3(gtsam.Rot3(R @ own), R @ place_ + p))
    for fix in fixes:
        if fix.rotation is None:
            graph.add(gtsam.GPSFactor(fix.robot, fix.position, gtsam.noiseModel.Gaussian.Covariance(fix.covariance)))
        else:
            noise = right_noise(fix.rotation, fix.covariance)
            graph.add(gtsam.PriorFactorPose3(fix.robot, gtsam.Pose3(gtsam.Rot3(fix.rotation), fix.position), noise))
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    marginals = gtsam.Marginals(graph, values)
    R_ours, p_ours, C = team.snapshot()["rotation"][0], team.snapshot()["position"][0], pose_block(team)
    for r in range(ROBOTS):
        pose = values.atPose3(r)
        A = np.kron(np.eye(2), pose.rotation().matrix())
        theirs = A @ marginals.marginalCovariance(r) @ A.T
        ours = C[6 * r : 6 * r + 6, 6 * r : 6 * r + 6]
        sigma = np.sqrt(np.diag(theirs))
        theta = Rotation.from_matrix(R_ours[r] @ pose.rotation().matrix().T).as_rotvec()
        apart = np.concatenate([theta, p_ours[r] - pose.translation()])
        assert np.all(np.abs(apart) < 0.02 * sigma), apart / sigma
        np.testing.assert_allclose(ours / np.outer(sigma, sigma), theirs / np.outer(sigma, sigma), atol=0.01)


def right_noise(R, covariance):
    """Our error (theta, p) acts from the left in the axes of the parent; GTSAM's acts in the child's own."""
    A = np.kron(np.eye(2), R.T)
    return gtsam.noiseModel.Gaussian.Covariance(A @ covariance @ A.T)

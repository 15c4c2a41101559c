from __future__ import annotations

import dataclasses

import gtsam
import numpy as np
import pytest

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.driving import driven
from coop_envs.localization.planar.filter import PlanarFilter, PlanarFix, plain_jacobian
from coop_envs.localization.planar.settings import PlanarSettings
from coop_envs.localization.planar.sightings import KNOWN, Sightings, linearised, point_of, sightings_now
from tests.localization.planar.world import STEP_S, World, error, nees, started

SETTINGS = PlanarSettings()


def random_team(seed: int = 0, robots: int = 4) -> PlanarFilter:
    """Robots with correlated errors."""
    rng = np.random.default_rng(seed)
    team = PlanarFilter(SETTINGS)
    for k in range(robots):
        team.add(f"robot_{k}", np.array([*rng.uniform(-2, 2, 2), rng.uniform(-3, 3)]), np.eye(3))
    A = rng.normal(size=(3 * robots, 3 * robots)) * 0.02
    team.covariance = A @ A.T + 1e-5 * np.eye(3 * robots)
    return team


def moved(pose, e):
    return se2.composed(se2.exp(e), pose)


def some_sightings(team: PlanarFilter) -> Sightings:
    """Of robots and of a known place, now and earlier."""
    seer, subject = np.array([0, 2, 3]), np.array([1, 0, KNOWN])
    made = sightings_now(seer, subject, np.full((3, 2), 3.0), np.array([[1.0, 0.2]] * 3), np.full((3, 2), 0.05))
    then = np.array([[0.0, 0, 0], [0.3, -0.2, 0.4], [0.1, 0.1, -0.2]])
    return dataclasses.replace(made, seer_then=then, subject_then=np.array([[0.0, 0], [0.2, 0.1], [0, 0]]))


def test_jacobian_of_sightings_against_finite_differences():
    team = random_team()
    seen, step = some_sightings(team), 1e-6
    told = linearised(team.pose, seen)
    for m in range(len(seen)):
        for who, sign in ((seen.seer[m], -1.0), (seen.subject[m], 1.0)):
            if who == KNOWN:
                continue
            numeric = np.zeros((2, 3))
            for k, unit in enumerate(np.eye(3)):
                for way in (1, -1):
                    pose = team.pose.copy()
                    pose[who] = moved(pose[who], way * step * unit)
                    numeric[:, k] -= way * linearised(pose, seen).residual[m] / (2 * step)
            np.testing.assert_allclose(sign * told.jacobian[m], numeric, atol=1e-7)


def test_a_common_error_of_the_whole_team_is_never_felt():
    """Not by any sighting within it, wherever it is linearised: the update cannot gain about it."""
    team = random_team()
    common = np.kron(np.ones((4, 1)), np.eye(3))
    before = team.covariance.copy()
    team.covariance = before + common @ np.diag([0.5, 2.0, 3.0]) @ common.T
    only = some_sightings(team).part(np.array([True, True, False]))
    told = linearised(team.pose, only)
    aimed = dataclasses.replace(only, measured=only.measured - told.residual)
    team.update(aimed)
    twin = random_team()
    twin.update(aimed)
    np.testing.assert_allclose(
        team.covariance, twin.covariance + common @ np.diag([0.5, 2.0, 3.0]) @ common.T, atol=1e-9
    )


def test_update_is_the_textbook_one_and_the_covariance_stays_symmetric():
    team = random_team()
    seen = some_sightings(team)
    told = linearised(team.pose, seen)
    seen = dataclasses.replace(seen, measured=seen.measured - told.residual + 0.02)
    H = np.zeros((6, 12))
    for m in range(3):
        H[2 * m : 2 * m + 2, 3 * seen.seer[m] : 3 * seen.seer[m] + 3] -= told.jacobian[m]
        if seen.subject[m] != KNOWN:
            H[2 * m : 2 * m + 2, 3 * seen.subject[m] : 3 * seen.subject[m] + 3] += told.jacobian[m]
    P, R = team.covariance.copy(), np.diag(seen.sigma.ravel() ** 2)
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    expected = moved(team.pose, (K @ np.full(6, 0.02)).reshape(-1, 3))
    assert team.update(seen).accepted.all()
    np.testing.assert_allclose(team.pose, expected, atol=1e-12)
    np.testing.assert_allclose(team.covariance, (np.eye(12) - K @ H) @ P, atol=1e-12)
    np.testing.assert_array_equal(team.covariance, team.covariance.T)


def test_arcs_are_exact_and_do_not_depend_on_how_they_are_cut():
    whole, pieces = random_team(), random_team()
    robots = np.arange(4)
    forward, turn = np.array([0.3, 0.2, -0.1, 0.4]), np.array([0.5, 0.0, 1.2, -0.7])
    whole.move(robots, *driven(whole.settings, forward, turn, 2.0))
    for _ in range(40):
        pieces.move(robots, *driven(pieces.settings, forward, turn, 0.05))
    np.testing.assert_allclose(pieces.pose, whole.pose, atol=1e-12)
    radius = 0.3 / 0.5
    start = random_team().pose[0]
    turned = se2.seen_from(start, whole.pose[0, :2])
    np.testing.assert_allclose(turned, [radius * np.sin(1.0), radius * (1 - np.cos(1.0))], atol=1e-12)
    # yaw noise is white: its sum over pieces is exact, and what it does to places nearly
    np.testing.assert_allclose(np.diag(pieces.covariance)[::3], np.diag(whole.covariance)[::3], rtol=1e-9)
    np.testing.assert_allclose(np.diag(pieces.covariance), np.diag(whole.covariance), rtol=0.05)


def test_noise_of_driving_against_samples():
    """Many robots that err as odometry does at every small step spread as the filter says."""
    rng, K, steps = np.random.default_rng(1), 4000, 50
    forward, turn = np.full(K, 0.4), np.full(K, 0.6)
    pose = np.zeros((K, 3))
    team = PlanarFilter(SETTINGS)
    team.add("robot", np.zeros(3), np.zeros((3, 3)))
    for _ in range(steps):
        step, noise = driven(SETTINGS, forward, turn, 0.05)
        wander = (np.linalg.cholesky(noise) @ rng.normal(size=(K, 3, 1)))[:, :, 0]
        pose = se2.composed(se2.composed(pose, step), se2.exp(wander))
        team.move(np.array([0]), *driven(team.settings, forward[:1], turn[:1], 0.05))
    e = error(np.broadcast_to(team.pose[0], (K, 3)), pose)
    sigma = np.sqrt(np.diag(team.covariance))
    np.testing.assert_allclose(np.cov(e.T) / np.outer(sigma, sigma), team.covariance / np.outer(sigma, sigma), atol=0.1)


@pytest.mark.parametrize("yaw_rad", [None, 0.7])
def test_a_fix_of_an_earlier_pose_against_finite_differences(yaw_rad):
    team = random_team()
    then, step = np.array([0.2, -0.1, 0.3]), 1e-6
    at = se2.composed(team.pose[1], then)
    numeric = np.stack(
        [
            (se2.composed(moved(team.pose[1], step * u), then) - se2.composed(moved(team.pose[1], -step * u), then))
            / (2 * step)
            for u in np.eye(3)
        ],
        axis=1,
    )[[2, 0, 1]]
    np.testing.assert_allclose(plain_jacobian(at), numeric, atol=1e-8)
    H = np.zeros((3, 12))
    H[:, 3:6] = numeric
    covariance = np.diag([0.01, 0.02, 0.03]) ** 2
    residual = np.array([0.005, 0.01, -0.02])
    if yaw_rad is None:
        H, covariance, residual = H[1:], covariance[1:, 1:], residual[1:]
    P = team.covariance.copy()
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + covariance)
    told = PlanarFix(at[:2] + residual[-2:], None if yaw_rad is None else at[2] + residual[0], covariance, then)
    expected = moved(team.pose, (K @ residual).reshape(-1, 3))
    assert team.fix("robot_1", told)
    np.testing.assert_allclose(team.pose, expected, atol=1e-7)
    np.testing.assert_allclose(team.covariance, (np.eye(12) - K @ H) @ P, atol=1e-9)


def test_a_fix_beyond_the_gate_changes_nothing():
    team = random_team()
    before = team.snapshot()
    assert not team.fix("robot_1", PlanarFix(team.pose[1, :2] + 2.0, None, 1e-4 * np.eye(2)))
    np.testing.assert_array_equal(team.pose, before.pose)
    np.testing.assert_array_equal(team.covariance, before.covariance)


def test_robots_that_leave_take_nothing_with_them():
    team = random_team()
    seen = some_sightings(team)
    told = linearised(team.pose, seen)
    team.update(dataclasses.replace(seen, measured=seen.measured - told.residual))
    pose, P = team.pose.copy(), team.covariance.copy()
    team.remove("robot_1")
    kept = [0, 1, 2, 6, 7, 8, 9, 10, 11]
    np.testing.assert_array_equal(team.pose, pose[[0, 2, 3]])
    np.testing.assert_array_equal(team.covariance, P[np.ix_(kept, kept)])
    assert team.index == {"robot_0": 0, "robot_2": 1, "robot_3": 2}


def test_snapshot_and_restore():
    team = random_team()
    before = team.snapshot()
    team.move(np.arange(4), *driven(team.settings, np.full(4, 0.3), np.full(4, 0.1), 1.0))
    team.add("late", np.zeros(3), np.eye(3))
    team.remove("robot_0")
    team.restore(before)
    np.testing.assert_array_equal(team.covariance, before.covariance)
    assert team.names == [f"robot_{k}" for k in range(4)]


def test_a_moved_landmark_is_doubted_and_found_again():
    team = PlanarFilter(SETTINGS)
    team.add("robot", np.zeros(3), 1e-8 * np.eye(3))
    sigma = np.array([0.02, 0.01])
    team.add_landmark("box", "robot", np.array([2.0, 0.0]), sigma)

    def look(measured):
        return sightings_now(np.array([0]), np.array([1]), np.zeros((1, 2)), np.array([measured]), sigma[None])

    for _ in range(10):
        assert team.update(look([2.0, 0.0])).accepted.all()
    verdicts = [team.update(look([2.0, 0.3])) for _ in range(12)]
    assert [verdict.accepted[0] for verdict in verdicts[:5]] == [False] * 5
    assert set(verdicts[4].doubted) == {"robot", "box"}
    assert verdicts[5].accepted[0] and verdicts[-1].accepted[0]
    q = se2.seen_from(team.pose[0], team.pose[1, :2])
    np.testing.assert_allclose(q, [2.0 * np.cos(0.3), 2.0 * np.sin(0.3)], atol=0.03)


def test_where_something_is_seen_and_how_exactly():
    rng = np.random.default_rng(2)
    measured, sigma = np.array([[2.0, 0.7]]), np.array([[0.05, 0.02]])
    drawn = measured + rng.normal(size=(20000, 2)) * sigma
    places, _ = point_of(drawn, np.tile(sigma, (20000, 1)))
    place, spread = point_of(measured, sigma)
    np.testing.assert_allclose(places.mean(0), place[0], atol=3e-3)
    np.testing.assert_allclose(np.cov(places.T), spread[0], rtol=0.05, atol=1e-4)


@pytest.mark.parametrize("steps", [20, pytest.param(60, marks=pytest.mark.slow)])
def test_discovered_landmarks_are_mapped_consistently(steps):
    """Three robots, six landmarks of unknown place: NEES of robots and landmarks over seeds."""
    robots, landmarks = [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        pose = np.column_stack([rng.uniform(-1, 1, (3, 2)), rng.uniform(-3, 3, 3)])
        world = World(SETTINGS, pose, rng.uniform(-3, 3, (6, 2)), rng)
        team = started(world)
        for _ in range(steps):
            forward, turn = np.full(3, 0.3), rng.normal(0.3, 0.5, 3)
            world.drive(forward, turn)
            team.move(np.arange(3), *driven(team.settings, forward, turn, STEP_S))
            team.update(world.look())
            seer, subject, measured = world.look_at_landmarks()
            known = np.array([f"l{k}" in team.index for k in subject], dtype=bool)
            who = np.array([team.index.get(f"l{k}", 0) for k in subject], dtype=np.intp)
            told = sightings_now(seer, who, np.zeros((len(seer), 2)), measured, world.sigma(len(seer)))
            team.update(told.part(known))
            for i, k, z in zip(seer, subject, measured, strict=True):
                if f"l{k}" not in team.index:
                    team.add_landmark(f"l{k}", f"robot_{i}", z, world.sigma(1)[0])
        robots += nees(team, world.pose).tolist()
        for name, k in team.index.items():
            if name.startswith("l"):
                d = world.landmarks[int(name[1:])] - team.pose[k, :2]
                landmarks.append(d @ np.linalg.solve(team.covariance_of(name)[1:, 1:], d) / 2)
    assert len(landmarks) > 40
    assert 0.6 < np.mean(robots) < 1.4
    assert 0.6 < np.mean(landmarks) < 1.5


def gtsam_noise(covariance: np.ndarray):
    """Ours is (yaw, x, y), GTSAM's (x, y, yaw)."""
    order = [1, 2, 0]
    return gtsam.noiseModel.Gaussian.Covariance(covariance[np.ix_(order, order)])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_against_gtsam(seed):
    """The last poses and covariances of a run against a batch smoother that shares none of our code."""
    rng = np.random.default_rng(seed)
    fine = PlanarSettings(yaw_rad_rtm=0.02, yaw_rad_rtrad=0.02, start_position_m=0.02, start_yaw_rad=0.02)
    pose = np.array([[0.0, 0.0, 0.3], [1.5, 0.5, 2.0], [-0.5, 1.5, -1.0]])
    world = World(fine, pose, np.zeros((0, 2)), rng, range_sigma_m=0.02, bearing_sigma_rad=0.01)
    team = started(world)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def key(k, step):
        return 1000 * k + step

    for k in range(3):
        C = team.covariance_of(f"robot_{k}")
        axes = np.eye(3)
        axes[1:, 1:] = se2.rotation(team.pose[k, 2]).T
        graph.add(gtsam.PriorFactorPose2(key(k, 0), gtsam.Pose2(*team.pose[k]), gtsam_noise(axes @ C @ axes.T)))
        values.insert(key(k, 0), gtsam.Pose2(*team.pose[k]))
    taken = 0
    for step in range(1, 31):
        forward, turn = np.full(3, 0.3), rng.normal(0.3, 0.3, 3)
        world.drive(forward, turn)
        team.move(np.arange(3), *driven(team.settings, forward, turn, STEP_S))
        step_poses, noise = driven(fine, forward, turn, STEP_S)
        for k in range(3):
            between = gtsam.BetweenFactorPose2(
                key(k, step - 1), key(k, step), gtsam.Pose2(*step_poses[k]), gtsam_noise(noise[k] + 1e-14 * np.eye(3))
            )
            graph.add(between)
            values.insert(key(k, step), gtsam.Pose2(*team.pose[k]))
        seen = world.look()
        # one right sighting in a thousand fails the gate: the smoother is not told of it either
        seen = seen.part(team.update(seen).accepted)
        taken += len(seen)
        sigma = gtsam.noiseModel.Diagonal.Sigmas(np.array([world.bearing_sigma_rad, world.range_sigma_m]))
        for i, j, z in zip(seen.seer, seen.subject, seen.measured, strict=True):
            factor = gtsam.BearingRangeFactorPose2(
                key(i, step), key(j, step), gtsam.Rot2.fromAngle(float(z[1])), float(z[0]), sigma
            )
            graph.add(factor)
    assert taken > 100
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    marginals = gtsam.Marginals(graph, values)
    for k in range(3):
        best = values.atPose2(key(k, 30))
        axes = np.eye(3)
        axes[:2, :2] = se2.rotation(np.array(best.theta()))
        theirs = (axes @ marginals.marginalCovariance(key(k, 30)) @ axes.T)[np.ix_([2, 0, 1], [2, 0, 1])]
        sigma = np.sqrt(np.diag(theirs))
        ours = team.pose[k]
        apart = np.array([se2.wrapped(ours[2] - best.theta()), ours[0] - best.x(), ours[1] - best.y()])
        assert np.all(np.abs(apart) < 0.25 * sigma), apart / sigma
        np.testing.assert_allclose(np.sqrt(np.diag(team.covariance_of(f"robot_{k}"))), sigma, rtol=0.1)

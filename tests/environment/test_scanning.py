from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.geometry.arrays import to_numpy
from tests.environment.scanning import Surveyors

QUIET: dict[str, Any] = {"sensing": {"dropout": 0.0, "outlier": 0.0}, "scanning": {"missed": 0.0, "false_spot": 0.0}}


def normalised_errors(teams: int, seed: int, decisions: int) -> list[np.ndarray]:
    """Of teams in the corner that got points, without false lights and outliers: those are another matter."""
    shots = Surveyors("corner", teams=teams, seed=seed, **QUIET).scan(decisions)
    assert sum(len(s.points) > 50 for s in shots) > 0.95 * teams
    return [s.normalised for s in shots if len(s.points)]


def test_points_lie_where_the_laser_landed_within_their_covariance():
    errors = normalised_errors(30, 0, 60)
    assert 0.75 < np.mean([e.mean() for e in errors]) < 1.3
    assert np.mean(np.concatenate(errors) < 9.0) > 0.99


@pytest.mark.slow
def test_the_points_of_the_corner_are_consistent():
    """Mean squared Mahalanobis distance over 3 within 0.9 to 1.1; `pytest -s` shows it."""
    mean = np.mean([e.mean() for e in normalised_errors(300, 1000, 60)])
    print(f"normalised point error: {mean:.3f}")
    assert 0.9 < mean < 1.1


def test_missed_and_false_spots_cost_points_and_place_few_wrong_ones():
    clean = Surveyors("corner", seed=3, **QUIET).scan(100)[0]
    noisy = Surveyors("corner", seed=3, scanning={"missed": 0.2, "false_spot": 0.2}).scan(100)[0]
    assert len(noisy.points) < 0.75 * len(clean.points)
    wrong = np.linalg.norm(noisy.points - noisy.truth, axis=1) > 0.1
    assert wrong.mean() < 0.05, "the gap between the rays tells nearly all"


def test_spots_of_different_frames_do_not_pair():
    late = Surveyors("corner", seed=3, scanning={"stamp_jitter_s": 0.1}).scan(60)[0]
    clean = Surveyors("corner", seed=3).scan(60)[0]
    assert len(late.points) < 0.05 * len(clean.points)


def test_a_team_with_one_camera_measures_no_range():
    blind: dict[str, Any] = {"team.members.picket_0.cameras": []}
    lone = Surveyors("corner", **blind)
    assert not len(lone.scan(30)[0].points)
    assert lone.batch.measurements.spot_sigma.numpy()[0, 0].any(), "though its camera sees spots"


def test_a_scan_maps_the_volume_rightly():
    """Nearly every cell that a scan of the corner calls free or occupied is."""
    team = Surveyors("corner", seed=5)
    team.scan(300, request=1.0)
    volume = team.batch.map.volume.numpy()[0]
    sure = int(np.sum(np.abs(volume) >= 36))
    bits = float(team.batch.score.information.numpy()[0]) * 1e-6
    assert sure > 500 and bits > 0.8 * np.count_nonzero(volume) * 0.5


def test_scanning_costs_what_the_power_model_says():
    """Every lit frame 1/30 s of the laser at 0.05 W, every count 10 ms of the motors at 0.5 W."""
    team = Surveyors("corner", seed=1)
    team.rest(1)
    before = team.batch.state.energy.numpy()[0, :, 3].copy()
    lit, moved = np.zeros(team.n), np.zeros(team.n)
    for _ in range(50):
        actions = np.zeros((1, team.n, 8), dtype=np.float32)
        actions[:, :, 0], actions[:, :, 4], actions[:, :, 6] = 1.0, 0.5, -0.2
        team.batch.actions.assign(actions)
        team.batch.step()
        lit += (team.batch.command.laser.numpy()[0] > 0).sum(axis=1)
        moved += np.abs(team.batch.command.galvo.numpy()[0]).max(axis=2).sum(axis=1)
    spent = team.batch.state.energy.numpy()[0, :, 3] - before
    np.testing.assert_allclose(spent, 0.05 * lit / 30 + 0.5 * 0.01 * moved, rtol=0.02)


def pose_nees(team: Surveyors) -> np.ndarray:
    """Mean squared Mahalanobis distance of each team's poses over 6, (B,)."""
    score = team.batch.score
    return score.nees_sum.numpy() / np.maximum(score.nees_count.numpy(), 1) / 6.0


def test_badly_calibrated_cameras_cost_what_the_covariance_says():
    """Focal lengths off by 1 % and centres by 2 px, known as such: points err more, and their covariance knows."""
    off: dict[str, Any] = {"sensing": {**QUIET["sensing"], "calibration": {"focal_share": 0.01, "centre_px": 2.0}}}
    nothing: dict[str, Any] = {}
    known: dict[str, Any] = {"estimation": {"focal_sigma": 0.01, "centre_sigma_px": 2.0}}
    teams = [Surveyors("corner", teams=60, seed=7, **{**QUIET, **off, **extra}) for extra in (nothing, known)]
    unaware, aware = (np.mean([s.normalised.mean() for s in t.scan(40) if len(s.points) > 20]) for t in teams)
    assert unaware > 1.5
    assert 0.4 < aware < 1.3, "what a camera's pose and its spot have in common is not taken off"
    off_pose, known_pose = (np.mean(pose_nees(team)) for team in teams)
    assert off_pose > 10.0
    assert 0.5 < known_pose < 1.3


def test_teams_that_wait_keep_their_rasters_and_observations():
    """A masked reset of the second team leaves the first as it was, in the middle of a move of its mirror."""
    env = exploration_v0.vector_env(2, "corner", device="cpu")
    env.reset(seed=4)
    actions = np.zeros((2, 2, 8), dtype=np.float32)
    actions[..., 0], actions[..., 4] = 1.0, 1.0
    observations = env.step(actions)[0]
    before = {key: value[0].copy() for key, value in observations.items()}
    raster = to_numpy(env.batch.raster)
    after, _ = env.reset(mask=np.array([False, True]))
    for name, array in to_numpy(env.batch.raster).items():
        np.testing.assert_array_equal(array[0], raster[name][0])
    for key, value in before.items():
        np.testing.assert_array_equal(after[key][0], value)


def test_a_restored_episode_shows_its_points():
    env = exploration_v0.parallel_env("corner", seed=2)
    env.reset(seed=2)
    action = np.array([1, 0, 0, 0, 0.5, 0, -0.25, 0], dtype=np.float32)
    while len(env.scan()) < 3:
        env.step(dict.fromkeys(env.agents, action))
    state, points_m = env.get_state(), env.scan().points_m
    env.step(dict.fromkeys(env.agents, action))
    env.set_state(state)
    np.testing.assert_array_equal(env.scan().points_m, points_m)

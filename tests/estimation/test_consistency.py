"""Whether the filter's covariance tells the truth: NEES over many teams, many robots and a long way."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.teams import Teams, filter_covariance, is_sane

LANES = (0.0, 0.12, -0.12)
THETA, POSITION = np.s_[:3], np.s_[3:]


@pytest.fixture(scope="module")
def inchworm():
    """Squared errors over degrees of freedom, (increments, B, N) for heading and tilt, place, and both.

    Five inchworm increments on the flat: each picket advances 0.3 m, the observer follows, some robot always rests.
    """
    teams = Teams("u_turn", teams=100, seed=1, sensing={"outlier": 0.0})
    teams.rest(10)
    theta, place, pose = [], [], []
    for _ in range(5):
        for r in (1, 2, 0):
            for decisions, forward in ((8, 0.95), (4, None)):
                if forward is None:
                    teams.rest(decisions)
                else:
                    teams.drive_lane(r, LANES[r], decisions, forward)
                theta.append(teams.nees(THETA))
                place.append(teams.nees(POSITION))
                pose.append(teams.nees())
    return teams, np.array(theta), np.array(place), np.array(pose)


def test_attitude_is_consistent(inchworm):
    _, theta, _, _ = inchworm
    # 100 teams of 3 degrees of freedom: the mean of one instant has a standard deviation of 0.08
    assert np.all(np.abs(theta[6:].mean(axis=1) - 1.0) < 0.25)
    assert abs(theta[6:].mean() - 1.0) < 0.1


def test_place_is_consistent_and_never_overconfident(inchworm):
    _, _, place, pose = inchworm
    mean = place[6:].mean(axis=(0, 1))
    # slip counts as white noise of its spectrum at zero, which is more than it does in a short move
    assert np.all((mean > 0.45) & (mean < 1.1)), mean
    assert np.all(place.mean(axis=1) < 1.3)
    total = pose[6:].mean(axis=(0, 1))
    assert np.all((total > 0.6) & (total < 1.1)), total


def test_no_tail_of_lost_teams(inchworm):
    _, _, _, pose = inchworm
    # chi2(6) / 6 exceeds 3.74 once in a thousand
    assert np.mean(pose > 3.74) < 0.004


def test_drift_is_small(inchworm):
    teams, *_ = inchworm
    path = teams.state("path")[:, 0].mean()
    assert path > 1.2
    assert np.sqrt(np.mean(teams.position_error_m()[:, 0] ** 2)) < 0.01 * path


def test_nobody_is_declared_lost_and_covariances_stay_sane(inchworm):
    teams, *_ = inchworm
    assert np.all(teams.belief("declared") == 1)
    assert all(is_sane(filter_covariance(teams, b)) for b in range(0, 100, 10))


@pytest.mark.parametrize("seed", [0, 100])
def test_one_in_ten_sightings_wrong_does_little_harm(seed):
    clean, dirty = (
        Teams("u_turn", teams=30, seed=seed, sensing={"outlier": share, "dropout": 0.0}) for share in (0.0, 0.1)
    )
    error_m = []
    for teams in (clean, dirty):
        teams.rest(10)
        for _ in range(2):
            for r in (1, 2, 0):
                teams.drive_lane(r, LANES[r], 8)
                teams.rest(4)
        error_m.append(np.sqrt(np.mean(teams.position_error_m() ** 2)))
    assert error_m[1] < 2.0 * error_m[0] + 0.002, error_m
    assert dirty.position_error_m().max() < 0.05

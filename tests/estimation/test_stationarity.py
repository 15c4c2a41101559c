from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.teams import Teams, filter_covariance, is_sane

OBSERVER, PICKET = 0, 1


def standing(**overrides) -> Teams:
    """Ten inchworm teams, at rest for as long as the estimator takes to settle and no longer fuses what it sees."""
    teams = Teams("u_turn", teams=10, seed=3, **overrides)
    teams.rest(40)
    return teams


def test_a_driven_robot_is_never_called_stationary():
    teams = standing()
    for k in range(15):
        teams.act({PICKET: (0.5, 0.2 * (-1) ** k)})
        assert not teams.belief("stationary")[:, PICKET].any()
    assert teams.belief("stationary")[:, [0, 2]].all()


@pytest.mark.parametrize(("rest_s", "decisions"), [(0.3, 2), (0.9, 5)])
def test_rest_is_declared_after_its_time_and_not_before(rest_s, decisions):
    teams = standing(**{"estimation.rest_s": rest_s, "sensing.outlier": 0.0})
    teams.drive({PICKET: (0.5, 0.0)}, 5)
    quiet = np.zeros(teams.B, dtype=int)
    for _ in range(12):
        teams.act({})
        quiet += np.all(teams.batch.measurements.wheels.numpy()[:, PICKET] == 0.0, axis=-1)
        assert np.array_equal(teams.belief("stationary")[:, PICKET] == 1, quiet >= decisions)


def test_the_pose_of_a_robot_at_rest_does_not_move_with_its_imu():
    teams = standing(**{"sensing.dropout": 0.99999, "sensing.outlier": 0.0})
    before, P = teams.belief("position"), teams.belief("pose_covariance")
    teams.rest(100)
    np.testing.assert_allclose(teams.belief("position"), before, atol=2e-3)
    grown = np.diagonal(teams.belief("pose_covariance") - P, axis1=-2, axis2=-1)[..., 3:]
    slip = teams.scenario.estimation.slip_position_m_rts**2 * 20.0
    np.testing.assert_allclose(grown, slip, rtol=0.1)


def test_biases_walk_on_at_rest():
    teams = standing()
    teams.rest(600)
    rms = np.sqrt(np.mean((teams.state("gyro_bias") - teams.belief("gyro_bias")) ** 2))
    variance = np.stack([np.diagonal(filter_covariance(teams, b)).reshape(3, 15)[:, 9:12] for b in range(teams.B)])
    assert 0.5 < rms / np.sqrt(variance.mean()) < 1.5


@pytest.mark.parametrize("shift_m", [(0.05, -0.04), (0.3, 0.2)])
def test_a_picket_moved_by_hand_is_no_landmark_until_it_is_found_again(shift_m):
    teams = standing()
    others = teams.belief("position")[:, [0, 2]]
    teams.push_truth(PICKET, shift_m)
    revoked = np.zeros(teams.B, dtype=bool)
    for _ in range(6):
        teams.act({})
        revoked |= teams.belief("stationary")[:, PICKET] == 0
    assert revoked.all()
    teams.rest(40)
    assert teams.position_error_m().max() < 0.01
    assert teams.belief("stationary").all()
    np.testing.assert_allclose(teams.belief("position")[:, [0, 2]], others, atol=5e-3)
    assert all(is_sane(filter_covariance(teams, b)) for b in range(teams.B))


def test_an_observer_moved_by_hand_finds_itself_by_its_pickets():
    teams = standing()
    teams.push_truth(OBSERVER, (-0.08, 0.0))  # back, so that both pickets stay in view
    teams.rest(40)
    assert teams.position_error_m().max() < 0.01


def test_single_outliers_demote_nobody():
    teams = standing(**{"sensing.outlier": 0.05})
    demoted = 0
    for _ in range(100):
        teams.act({})
        demoted += int((teams.belief("stationary") == 0).sum())
    assert demoted < 0.01 * 100 * teams.belief("stationary").size


def slide(teams: Teams, r: int, speed_m_s: float, seconds: float) -> int:
    """Robot r, at rest, slides sideways; how many of the teams noticed."""
    noticed = np.zeros(teams.B, dtype=bool)
    tick_s = teams.scenario.rates.tick_s
    for _ in range(round(seconds / tick_s)):
        teams.push_truth(r, (0.0, speed_m_s * tick_s))
        teams.rest(1)
        noticed |= teams.belief("demoted")[:, r] == 1
    return int(noticed.sum())


def test_a_landmark_that_slides_too_slowly_to_feel_is_demoted_and_placed_anew():
    teams = Teams("u_turn", teams=20, seed=2, rates={"ticks_per_decision": 1})
    teams.rest(90)
    assert slide(teams, 1, 0.004, 4.0) == 20  # 16 mm in all
    teams.rest(60)
    assert np.median(teams.position_error_m()[:, 1]) < 0.004
    assert teams.nees()[:, 1].mean() < 3.0


def test_nobody_at_rest_is_doubted_without_reason():
    teams = Teams("u_turn", teams=50, seed=5, rates={"ticks_per_decision": 1}, sensing={"outlier": 0.1})
    doubted = 0
    for _ in range(600):
        teams.rest(1)
        doubted += int(teams.belief("demoted").sum())
    assert doubted == 0

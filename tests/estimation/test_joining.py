from __future__ import annotations

import numpy as np
import pytest

from coop_envs.estimation.belief import SPARE_SLOTS, Declared
from coop_envs.simulation.state import Status
from coop_envs.worlds.world import Hazard
from tests.estimation.teams import Teams, filter_covariance, is_sane, set_state

BARRIER = (Hazard("trap", (0.8, 0.8), (0.1, 0.9)), Hazard("trap", (0.45, 0.8), (0.05, 0.05)))
OPEN = {
    "environment.geometry.size_m": (1.6, 1.6),
    "environment.geometry.walls": (),
    "task.collect_lost": False,
}


def scouts(teams=6, hazards=BARRIER, **overrides) -> Teams:
    """Chapter 2's team of one observer and twelve pickets before a trap that nobody gets past."""
    return Teams("arena", teams=teams, seed=11, hazards=hazards, **OPEN, **overrides)


LANES = {1: 0.5, 2: -0.5, 3: 0.25, 4: -0.25, 5: 0.0}


def send_until_lost(teams: Teams, picket: int, limit: int = 100) -> None:
    """Drive a picket along its lane, wiggling, until every team has declared it lost."""
    for k in range(limit):
        forward, yaw = teams.steer(picket, LANES[picket], 0.8)
        teams.act({picket: (forward, yaw + 0.3 * (-1) ** (k // 3))})
        if np.all(teams.belief("declared")[:, picket] == Declared.LOST):
            return
    pytest.fail(f"picket {picket} not declared in {limit} decisions")


def working(teams: Teams, robot: int) -> bool:
    return bool(np.all(teams.belief("declared")[:, robot] == Declared.ACTIVE))


@pytest.fixture(scope="module")
def after_five_losses():
    teams = scouts()
    for picket in range(1, 6):
        send_until_lost(teams, picket)
        teams.rest(10)
    return teams


def test_a_loss_calls_exactly_one_reserve():
    teams = scouts(teams=3)
    teams.rest(5)
    assert np.all(teams.belief("declared")[:, 2:] == Declared.DOCKED)
    send_until_lost(teams, 1)
    teams.rest(10)
    assert working(teams, 2)
    assert np.all(teams.belief("declared")[:, 3:] == Declared.DOCKED)
    assert np.all(teams.state("status")[:, 2] == Status.ACTIVE)
    assert teams.position_error_m()[:, 2].max() < 0.01


def test_a_reserve_joins_as_uncertain_as_it_is_set_down():
    teams = scouts(teams=3, **{"sensing.dropout": 0.99999, "estimation.silent_s": 0.4})
    teams.drive_lane(1, 0.0, 10)
    energy = teams.state("energy")
    energy[:, 1, 0] = 1e9
    set_state(teams, "energy", energy)
    teams.rest(8)
    assert working(teams, 2)
    settings = teams.scenario.estimation
    sigma = np.sqrt(np.diagonal(teams.belief("pose_covariance")[:, 2], axis1=-2, axis2=-1))
    np.testing.assert_allclose(sigma[:, 3:5], settings.start_position_m, rtol=0.1)
    np.testing.assert_allclose(sigma[:, 2], settings.start_yaw_rad, rtol=0.1)


def test_slots_are_used_again_and_held_once(after_five_losses):
    teams = after_five_losses
    slot, declared = teams.belief("slot"), teams.belief("declared")
    total = teams.belief("covariance").shape[1] // 15
    assert total == 2 + SPARE_SLOTS
    for b in range(teams.B):
        held = slot[b][slot[b] >= 0]
        assert len(set(held)) == len(held) == total
        assert held.max() < total
        assert np.all(slot[b][declared[b] == Declared.ACTIVE] >= 0)
        assert np.all(slot[b][declared[b] == Declared.DOCKED] == -1)
        lost = np.flatnonzero(declared[b] == Declared.LOST)
        assert list(lost) == [1, 2, 3, 4, 5]
        assert list(slot[b][lost] >= 0) == [False, False, True, True, True]


def test_covariances_are_sane_after_losses(after_five_losses):
    teams = after_five_losses
    assert all(is_sane(filter_covariance(teams, b)) for b in range(teams.B))
    lost = teams.belief("pose_covariance")[:, 1:6]
    assert np.all(np.diagonal(lost, axis1=-2, axis2=-1) > 0.0)


def test_those_at_work_know_where_they_are(after_five_losses):
    teams = after_five_losses
    work = teams.belief("declared")[0] == Declared.ACTIVE
    assert work.sum() == 2
    assert teams.position_error_m()[:, work].max() < 0.02
    assert teams.nees()[:, work].mean() < 1.3


def test_the_lost_stay_where_they_were_seen_last(after_five_losses):
    teams = after_five_losses
    assert np.quantile(teams.position_error_m()[:, 1:6], 0.95) < 0.12


def test_a_silent_robot_gives_up_its_slot():
    hole = (Hazard("hole", (0.8, 0.8), (0.2, 0.9)),)
    teams = scouts(teams=3, hazards=hole)
    send_until_lost(teams, 1)
    assert np.all(teams.state("status")[:, 1] == Status.SWALLOWED)
    teams.rest(3)
    assert np.all(teams.belief("slot")[:, 1] == -1)
    assert all(is_sane(filter_covariance(teams, b)) for b in range(teams.B))

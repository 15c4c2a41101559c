from __future__ import annotations

import numpy as np
import pytest

from coop_envs.estimation.belief import Declared
from coop_envs.mapping.ground_map import GROUND
from coop_envs.simulation.state import Status
from coop_envs.worlds.world import Hazard
from tests.estimation.teams import Teams, set_state

PICKET = 1
DECISION_S = 0.2
TRAP = (Hazard("trap", (0.0, -0.5), (0.3, 0.5)),)
HOLE = (Hazard("hole", (0.0, -0.5), (0.3, 0.5)),)


def lane_with(hazards, teams=30, **overrides) -> Teams:
    """Inchworm teams at (-1.5, -0.6); their pickets, half a metre ahead, meet the hazard after 0.7 m."""
    return Teams("u_turn", teams=teams, seed=5, hazards=hazards, **overrides)


def drive_and_time(teams: Teams, decisions: int, wiggle: float) -> tuple[np.ndarray, np.ndarray]:
    """Seconds at which each team's picket got lost in truth and was declared lost, infinity if never."""
    caught, declared = np.full((2, teams.B), np.inf)
    for k in range(decisions):
        forward, yaw = teams.steer(PICKET, 0.12)
        teams.act({PICKET: (forward, yaw + wiggle * (-1) ** (k // 3))})
        now = (k + 1) * DECISION_S
        caught[(teams.state("status")[:, PICKET] > Status.ACTIVE) & np.isinf(caught)] = now
        declared[(teams.belief("declared")[:, PICKET] == Declared.LOST) & np.isinf(declared)] = now
    return caught, declared


def test_a_trapped_robot_that_drives_and_turns_is_declared_within_five_seconds():
    teams = lane_with(TRAP)
    caught, declared = drive_and_time(teams, 60, wiggle=0.4)
    assert np.isfinite(caught).all()
    delay = declared - caught
    assert np.all(delay >= teams.scenario.estimation.stuck_s - 0.4)
    assert np.all(delay <= 5.0), delay


def test_the_hazard_is_marked_where_it_reaches_under_the_robot():
    teams = lane_with(TRAP)
    drive_and_time(teams, 60, wiggle=0.4)
    for b in range(teams.B):
        x, y = teams.true_position()[b, PICKET, :2]
        edge = -0.3 - teams.state("frame")[b, 0]
        assert x < edge < x + 0.06
        around = [ground_at(teams, b, np.array([edge + 0.005, y + dy])) for dy in (-0.02, 0.0, 0.02)]
        assert min(around) < 0 and ground_at(teams, b, np.array([edge + 0.05, y])) <= 0


def ground_at(teams: Teams, b: int, xy: np.ndarray) -> int:
    """Log-odds, in sixteenths, of the map cell at a point of the team frame."""
    model, corner = teams.batch.map_model, teams.batch.map.corner.numpy()[b]
    i, j = np.floor((xy - corner) / model.cell).astype(int)
    return int(teams.batch.map.log_odds.numpy()[b, int(GROUND), i * model.ny + j])


def test_a_robot_against_a_wall_that_turns_now_and_then_is_never_declared():
    teams = lane_with((), teams=10)
    teams.drive({PICKET: (0.0, 1.0)}, 8)
    for k in range(300):  # one minute at the fence, 0.9 m to its left
        teams.act({PICKET: (1.0, 0.6 if k % 15 < 2 else (-0.6 if k % 15 in (8, 9) else 0.0))})
    assert np.all(np.abs(teams.state("position")[:, PICKET]).max(axis=-1) > 1.3)
    assert np.all(teams.belief("declared") == Declared.ACTIVE)


def test_one_that_only_pushes_in_sight_is_declared_after_four_times_as_long():
    teams = lane_with(TRAP, teams=20, **{"sensing.outlier": 0.0})
    caught = np.full(teams.B, np.inf)
    in_sight = np.ones(teams.B, dtype=bool)
    for k in range(100):
        teams.act({PICKET: (1.0, 0.0)})
        in_sight &= teams.belief("unseen_s")[:, PICKET] < 1.0
        caught[(teams.state("status")[:, PICKET] == Status.TRAPPED) & np.isinf(caught)] = k
        declared = teams.belief("declared")[:, PICKET] == Declared.LOST
        waited_s = (k - caught) * DECISION_S
        assert not declared[waited_s < 11.5].any()
        assert declared[in_sight & (waited_s > 14.5)].all()
    assert in_sight.sum() > 5


def test_one_that_drives_straight_on_out_of_sight_is_not_declared():
    blind = {"sensing.dropout": 0.99999, "environment.geometry.size_m": (12.0, 3.0)}
    teams = lane_with((), teams=10, **blind, **{"environment.geometry.start": (-5.5, 0.0, 0.0)})
    teams.drive({PICKET: (1.0, 0.0)}, 150)
    assert np.all(teams.true_position()[:, PICKET, 0] > 4.0)
    assert np.all(teams.belief("declared") == Declared.ACTIVE)


@pytest.mark.parametrize("brightness", [0.0, -1.0])
def test_a_robot_held_out_of_sight_is_declared_and_its_place_is_known(brightness):
    teams = lane_with(TRAP, teams=20)
    for k in range(70):
        forward, yaw = teams.steer(PICKET, 0.12)
        seen = teams.true_position()[:, PICKET, 0].max() < 0.6
        teams.act({PICKET: (forward, yaw + 0.4 * (-1) ** (k // 3))}, 0.0 if seen else brightness)
    assert np.all(teams.state("status")[:, PICKET] == Status.TRAPPED)
    assert np.all(teams.belief("declared")[:, PICKET] == Declared.LOST)
    assert np.quantile(teams.position_error_m()[:, PICKET], 0.9) < 0.1


def test_one_that_a_hole_swallows_falls_silent_and_marks_it():
    teams = lane_with(HOLE, teams=10)
    caught, declared = drive_and_time(teams, 60, wiggle=0.0)
    silent_s = teams.scenario.estimation.silent_s
    np.testing.assert_allclose(declared - caught, silent_s - DECISION_S, atol=0.21)
    assert all(ground_at(teams, b, teams.true_position()[b, PICKET, :2]) < 0 for b in range(teams.B))


def test_an_empty_battery_is_a_loss_but_no_hazard():
    teams = lane_with((), teams=4)
    teams.rest(5)
    energy = teams.state("energy")
    energy[:, PICKET, 0] = teams.scenario.team.members[PICKET].robot.battery.energy_j - 5.0
    set_state(teams, "energy", energy)
    for _ in range(40):
        teams.act({PICKET: teams.steer(PICKET, 0.12)})
    assert np.all(teams.state("status")[:, PICKET] == Status.DEPLETED)
    assert np.all(teams.belief("declared")[:, PICKET] == Declared.LOST)
    assert np.all(teams.batch.map.log_odds.numpy()[:, int(GROUND)] >= 0)


def random_phases(rng: np.random.Generator, teams: Teams) -> np.ndarray:
    """Forward and yaw actions (B, N, 2) of straight runs, arcs and turns on the spot."""
    forward = rng.choice([-0.5, 0.6, 1.0, 0.0], p=[0.15, 0.35, 0.35, 0.15], size=(teams.B, teams.n))
    yaw = rng.choice([-1.0, 0.0, 0.5, 1.0], size=(teams.B, teams.n))
    return np.stack([forward, np.where(forward == 0.0, np.sign(yaw + 0.1), yaw)], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["arena", "random_arena"])
def test_precision_and_recall_over_random_drives(scenario):
    rng = np.random.default_rng(2)
    teams = Teams(scenario, teams=60, seed=21)
    right = wrong = missed = 0
    caught_s = np.full((teams.B, teams.n), np.inf)
    declared = np.zeros((teams.B, teams.n), dtype=bool)
    for k in range(600):
        if k % 8 == 0:
            motion = random_phases(rng, teams)
        teams.act({r: (motion[:, r, 0], motion[:, r, 1]) for r in range(1, teams.n)})
        lost = teams.state("status") > Status.ACTIVE
        caught_s[lost & np.isinf(caught_s)] = k * DECISION_S
        new = (teams.belief("declared") == Declared.LOST) & ~declared
        right, wrong = right + int((new & lost).sum()), wrong + int((new & ~lost).sum())
        declared |= new
    missed = int(((caught_s < 120.0 - 15.0) & ~declared).sum())
    assert right > 100
    assert right / (right + wrong) >= 0.97, (right, wrong)
    assert right / (right + missed) >= 0.97, (right, missed)

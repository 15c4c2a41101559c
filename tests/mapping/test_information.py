from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy.stats import entropy

from coop_envs.mapping.information import MICRO, cell_information_ubit, held_ubit
from coop_envs.scoring import TERMS
from coop_envs.simulation.state import Status
from tests.estimation.teams import Teams

ODDS = np.arange(-112, 113)


@wp.kernel
def evaluate(table: wp.array[int], odds: wp.array[int], truth: int, out: wp.array[int]):
    i = wp.tid()
    out[i] = held_ubit(table, odds[i], truth == 1)


def held(odds, truth: bool) -> np.ndarray:
    table = wp.array(cell_information_ubit(), dtype=int, device="cpu")
    levels = wp.array(np.atleast_1d(odds), dtype=int, device="cpu")
    out = wp.zeros(len(levels), dtype=int, device="cpu")
    wp.launch(evaluate, len(levels), inputs=[table, levels, int(truth), out], device="cpu")
    return out.numpy()


def test_table_is_the_fall_in_entropy():
    p = 1.0 / (1.0 + np.exp(-ODDS / 16.0))
    bits = 1.0 - entropy(np.stack([p, 1.0 - p]), base=2)
    np.testing.assert_allclose(cell_information_ubit()[ODDS + 128] / MICRO, bits, atol=1e-6)
    assert cell_information_ubit()[128] == 0


def test_a_cell_on_the_wrong_side_counts_negative():
    for truth in (True, False):
        leaning = ODDS != 0
        right = (ODDS > 0) == truth
        values = held(ODDS, truth)
        assert np.all(values[leaning & right] > 0)
        assert np.all(values[leaning & ~right] < 0)
        assert values[ODDS == 0] == 0
        np.testing.assert_array_equal(np.abs(values), cell_information_ubit()[ODDS + 128])


def test_surer_is_more():
    assert np.all(np.diff(held(np.arange(0, 113), True)) > 0)
    assert np.all(np.diff(held(np.arange(0, 113), False)) < 0)


@pytest.fixture
def teams():
    """Eight inchworm teams, just set down: their account stands at nothing, whatever people told them of the ground."""
    return Teams("u_turn", teams=8, seed=2)


def drive_a_while(teams: Teams, decisions: int = 40) -> None:
    rng = np.random.default_rng(0)
    for k in range(decisions):
        if k % 5 == 0:
            motion = rng.uniform(-1, 1, size=(teams.n, 2))
        teams.act({r: (motion[r, 0], motion[r, 1]) for r in range(teams.n)})


def account_bits(teams: Teams) -> np.ndarray:
    return teams.batch.score.information.numpy() / MICRO


def map_bits(teams: Teams, b: int) -> float:
    """Bits that team b's map holds, cell by cell against the world's level, harmless truth."""
    model, world = teams.batch.map_model, teams.batch.pool.worlds[0]
    odds = teams.batch.map.log_odds.numpy()[b].astype(int)
    x, y, _, yaw = teams.state("frame")[b].astype(float)
    cells = np.stack(np.divmod(np.arange(model.nx * model.ny), model.ny), axis=-1)
    local = teams.batch.map.corner.numpy()[b] + (cells + 0.5) * model.cell
    c, s = np.cos(yaw), np.sin(yaw)
    xy = np.stack([x + c * local[:, 0] - s * local[:, 1], y + s * local[:, 0] + c * local[:, 1]], axis=-1)
    x0, y0, x1, y1 = world.ground.bounds_m
    inside = (xy[:, 0] > x0) & (xy[:, 0] < x1) & (xy[:, 1] > y0) & (xy[:, 1] < y1)
    p = 1.0 / (1.0 + np.exp(-odds / 16.0))
    bits = 1.0 - entropy(np.stack([p, 1.0 - p]), base=2)
    right = np.where(odds > 0, [inside, ~inside], [~inside, inside])
    return float(np.sum(np.where(right, bits, -bits)))


def test_the_account_is_what_the_map_gained(teams):
    account, held = account_bits(teams), [map_bits(teams, b) for b in range(teams.B)]
    drive_a_while(teams)
    for b in range(teams.B):
        gain = map_bits(teams, b) - held[b]
        assert gain > 1.0
        assert account_bits(teams)[b] - account[b] == pytest.approx(gain, abs=1e-2)


def test_rewards_add_up_to_the_account(teams):
    weight = teams.scenario.reward.information_per_bit
    before, total = account_bits(teams), np.zeros(teams.B)
    rng = np.random.default_rng(1)
    for _ in range(40):
        teams.act({r: (rng.uniform(-1, 1), rng.uniform(-1, 1)) for r in range(teams.n)})
        total += teams.batch.score.terms.numpy()[:, TERMS.index("information")]
    np.testing.assert_allclose(total, weight * (account_bits(teams) - before), rtol=1e-4, atol=1e-4)


def test_the_account_is_the_same_in_any_company(teams):
    drive_a_while(teams)
    alone = [Teams("u_turn", teams=1, seed=2 + b) for b in range(teams.B)]
    for one in alone:
        drive_a_while(one)
    np.testing.assert_array_equal(account_bits(teams), np.concatenate([account_bits(one) for one in alone]))


def passing_by(trap_m: float, drift_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Bits of teams whose picket passes right of a trap ``trap_m`` wide, and which of them got through."""
    longer = {"size_m": (1.2, 0.6), "trap_centre_m": (0.7, 0.3), "trap_size_m": (trap_m, trap_m)}
    teams = Teams("arena", teams=6, seed=4, environment={"geometry": longer})
    teams.rest(5)
    teams.batch.belief.position.assign(teams.belief("position") + [0.0, drift_m, 0.0])
    for _ in range(28):
        teams.act({1: teams.steer(1, -0.18, 0.8)})
    return account_bits(teams), teams.state("status")[:, 1] == Status.ACTIVE


def test_drift_earns_nothing():
    """The same drive with and without a trap beside it: maps that are true tell the same, drifted ones pay for it."""
    for drift_m in (0.0, 0.15):
        (with_trap, passed), (without, _) = passing_by(0.15, drift_m), passing_by(0.0, drift_m)
        assert passed.sum() >= 4
        loss = (without - with_trap)[passed]
        assert np.all(loss > 3.0) if drift_m > 0 else np.all(loss == 0.0), (drift_m, loss)

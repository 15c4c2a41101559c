"""The same keys give the same bits, whatever the batch."""

from __future__ import annotations

import numpy as np
import pytest

from coop_envs.geometry.arrays import to_numpy
from coop_envs.geometry.keyed_random import team_key
from coop_envs.simulation.fast import Placement
from coop_envs.worlds.world import Hazard
from tests.simulation.builders import ROACH, ZUMY, ground_of, led_model, physics_of, team_of, wheels_of, world_of

ROBOTS = (ZUMY, ROACH, ZUMY, ROACH)
HILLS = ground_of(lambda x, y: 0.05 * np.sin(3.0 * x) * np.cos(4.0 * y) + 0.3 * (x > 1.0), (-1.5, -1.5, 1.5, 1.5))
STARTS = [(-0.6, 0.0, 0.0), (-0.2, 0.2, 0.1), (-0.2, -0.2, -0.1), (-1.0, 0.0, 0.0)]
WORLDS = (
    world_of(HILLS, STARTS, [Hazard("trap", (0.5, 0.0), radius_m=0.2)], dock=STARTS[3]),
    world_of(ground_of(lambda x, y: 0.02 * np.cos(9.0 * x), (-1.5, -1.5, 1.5, 1.5)), STARTS, dock=STARTS[3]),
)
TEAMS = 16


def start(seeds, order=None):
    """A batch of teams with these seeds; odd seeds live in world 1."""
    seeds = np.asarray(seeds if order is None else np.asarray(seeds)[order])
    leds = led_model(dropout=0.1, outlier=0.05)
    team = team_of(*ROBOTS, reserves=1)
    physics = physics_of(team, *WORLDS, teams=len(seeds), leds=leds, placement=Placement())
    keys = np.array([team_key(int(seed), 0) for seed in seeds], dtype=np.uint64)
    physics.reset(np.ones(len(seeds), dtype=np.int32), keys, (seeds % 2).astype(np.int32))
    return physics


def script(seeds, decisions):
    """Wheels (B, N, 2) of each decision, a function of the seeds alone."""
    for k in range(decisions):
        speed, turn = np.sin(np.add.outer(seeds, np.arange(4)) + k / 7), np.cos(np.add.outer(seeds, np.arange(4)) * 3)
        yield np.stack([wheels_of(robot, 0.3 * speed[:, r], turn[:, r]) for r, robot in enumerate(ROBOTS)], axis=1)


def play(physics, seeds, decisions=40):
    """All that is true and measured after every decision, by name."""
    told = []
    for k, wheels in enumerate(script(np.asarray(seeds), decisions)):
        physics.command.wheels.numpy()[:] = wheels
        physics.command.brightness.numpy()[:] = 0.7
        physics.command.undock.numpy()[:, 3] = int(k > 10)
        physics.step()
        told.append(
            {**to_numpy(physics.state), **{f"measured {k}": v for k, v in to_numpy(physics.measurements).items()}}
        )
    return {name: np.stack([moment[name] for moment in told]) for name in told[0]}


@pytest.fixture(scope="module")
def reference():
    return play(start(range(TEAMS)), range(TEAMS))


def test_something_happens(reference):
    assert np.any(reference["status"] == 2) and np.all(reference["status"][-1, :, 3] != 0)
    assert 0.1 < reference["measured seen"][:, :, 0, 1:3].mean() < 0.95
    assert all(np.all(np.isfinite(values)) for values in reference.values())


def test_the_same_seeds_give_the_same_bits(reference):
    again = play(start(range(TEAMS)), range(TEAMS))
    for name, values in reference.items():
        np.testing.assert_array_equal(again[name], values, err_msg=name)


@pytest.mark.parametrize("seed", [0, 7, 15])
def test_a_batch_of_one_is_an_entry_of_a_batch_of_many(reference, seed):
    alone = play(start([seed]), [seed])
    for name, values in reference.items():
        np.testing.assert_array_equal(alone[name][:, 0], values[:, seed], err_msg=name)


def test_the_order_of_teams_does_not_matter(reference):
    order = np.random.default_rng(0).permutation(TEAMS)
    shuffled = play(start(range(TEAMS), order), order)
    for name, values in reference.items():
        np.testing.assert_array_equal(shuffled[name], values[:, order], err_msg=name)


def test_other_seeds_differ(reference):
    assert len(np.unique(reference["position"][-1, ::2, 0, 0])) == TEAMS // 2


def test_resetting_one_team_leaves_the_others_alone(reference):
    physics = start(range(TEAMS))
    play(physics, range(TEAMS), 5)
    chosen = np.zeros(TEAMS, dtype=np.int32)
    chosen[3] = 1
    before = to_numpy(physics.state)
    physics.reset(chosen, np.full(TEAMS, team_key(99, 1), dtype=np.uint64), np.ones(TEAMS, dtype=np.int32))
    after = to_numpy(physics.state)
    others = np.arange(TEAMS) != 3
    for name in before:
        np.testing.assert_array_equal(after[name][others], before[name][others], err_msg=name)
    assert after["tick"][3] == 0 and after["key"][3] == team_key(99, 1) and np.all(after["path"][3] == 0.0)


def test_people_set_robots_down_with_their_spread():
    physics = physics_of(team_of(ZUMY, ZUMY), world_of(starts=STARTS), teams=2000, placement=Placement(0.01, 0.05))
    place, yaw = physics.state.position.numpy()[:, :, :2].astype(float), physics.state.yaw.numpy()
    assert np.ptp(place[:, 0], axis=0).max() == 0.0 and np.ptp(yaw[:, 0]) == 0.0
    np.testing.assert_allclose(place[:, 1].mean(axis=0), STARTS[1][:2], atol=0.001)
    np.testing.assert_allclose(place[:, 1].std(axis=0), 0.01, rtol=0.07)
    assert yaw[:, 1].std() == pytest.approx(0.05, rel=0.07)
    frame = physics.state.frame.numpy()
    np.testing.assert_allclose(frame, np.tile([-0.6, 0.0, ZUMY.body_height_m, 0.0], (2000, 1)), atol=1e-6)

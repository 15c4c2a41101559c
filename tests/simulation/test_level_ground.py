"""Cells around which the ground is known to be level, where footing takes a short cut."""

from __future__ import annotations

import numpy as np

from coop_envs.simulation.parameters import LEVEL_REACH_M, pack_terrain
from tests.simulation.builders import (
    ROACH,
    ZUMY,
    command,
    ground_of,
    physics_of,
    run,
    team_of,
    world_of,
)

CELL_M = 0.02


def terraces(x, y):
    """Blocks and a pit on ground that is level in between; beyond x = 0.8 it rises."""
    blocks = np.where((np.abs(x - 0.4) < 0.05) & (np.abs(y) < 0.3), 0.2, 0.0)
    pit = np.where((np.abs(x + 0.5) < 0.1) & (np.abs(y - 0.4) < 0.1), -0.3, 0.0)
    return blocks + pit + np.maximum(x - 0.8, 0.0)


GROUND = ground_of(terraces, (-1.0, -1.0, 1.2, 1.0), CELL_M)


def test_around_a_level_cell_all_ground_has_one_height():
    terrain, _ = pack_terrain([world_of(GROUND)], "cpu")
    nx, ny = GROUND.heights_m.shape
    level = terrain.level.numpy().reshape(nx, ny)
    assert 0.3 < level.mean() < 0.9
    reach = int(np.ceil(LEVEL_REACH_M / CELL_M))
    for i, j in np.argwhere(level):
        assert reach <= i < nx - 1 - reach and reach <= j < ny - 1 - reach
        around = GROUND.heights_m[i - reach : i + 2 + reach, j - reach : j + 2 + reach]
        assert around.min() == around.max()


def test_the_short_cut_changes_no_motion():
    rng = np.random.default_rng(5)
    teams, robots = 64, (ZUMY, ROACH)
    starts = [(-0.3, -0.3, 0.2), (0.1, 0.2, 2.0)]
    both = [physics_of(team_of(*robots), world_of(GROUND, starts), teams=teams, seed=3) for _ in range(2)]
    both[1].ground.terrain.level.fill_(0)
    for _ in range(20):
        speeds, turns = rng.uniform(-0.3, 0.5, (2, teams)), rng.uniform(-2.0, 2.0, (2, teams))
        for physics in both:
            for index, robot in enumerate(robots):
                command(physics, robot, speeds[index], turns[index], index)
            run(physics, 1.0)
    for name in ("position", "rotation", "status", "path"):
        short, long = (getattr(physics.state, name).numpy() for physics in both)
        np.testing.assert_allclose(short, long, atol=1e-6, err_msg=name)
    assert len(np.unique(both[0].state.status.numpy())) > 1

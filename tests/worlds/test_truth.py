from __future__ import annotations

import numpy as np
import pytest
import shapely

from coop_envs.worlds.arena import ArenaGeometry
from coop_envs.worlds.build import build_world
from coop_envs.worlds.flat import FlatGeometry
from coop_envs.worlds.truth import passable_ground, safe_path_exists, truth_grid
from coop_envs.worlds.world import HeightField, World
from tests.worlds.builders import team_of

BODY, CONTACT, CELL = 0.07, 0.045, 0.05


def centres(truth):
    i, j = np.meshgrid(*(np.arange(n) for n in truth.safe.shape), indexing="ij")
    return truth.origin_m[0] + (i + 0.5) * truth.cell_m, truth.origin_m[1] + (j + 0.5) * truth.cell_m


@pytest.mark.parametrize("cell_m", [0.05, 0.02])
def test_arena_truth_is_what_its_drawing_says(cell_m):
    world = build_world(ArenaGeometry(), team_of(1))
    truth = truth_grid(world, BODY, CONTACT, cell_m)
    floor = shapely.box(-0.45, 0.0, 0.75, 0.60)
    trap = shapely.box(0.30, 0.225, 0.45, 0.375)
    proven = (floor.buffer(-BODY) - trap.buffer(CONTACT)).buffer(CONTACT)
    x, y = centres(truth)
    clear_of = lambda shape: shapely.distance(shape.boundary, shapely.points(x, y)) > 0.012  # noqa: E731
    for got, shape in ((~truth.obstacle, floor), (truth.safe, floor - trap), (truth.reachable, proven)):
        decided = clear_of(shape)
        assert decided.mean() > 0.5
        assert np.array_equal(got[decided], shapely.contains_xy(shape, x, y)[decided])


def test_grid_is_registered_in_the_world_and_covers_it():
    world = build_world(ArenaGeometry(), team_of(2))
    truth = truth_grid(world, BODY, CONTACT, CELL)
    assert np.array(truth.origin_m) / CELL == pytest.approx(np.round(np.array(truth.origin_m) / CELL), abs=1e-9)
    x_min, y_min, x_max, y_max = world.ground.bounds_m
    upper = np.array(truth.origin_m) + CELL * np.array(truth.safe.shape)
    assert np.all(np.array(truth.origin_m) <= [x_min + 1e-9, y_min + 1e-9])
    assert np.all(upper >= [x_max - 1e-9, y_max - 1e-9])


def test_open_ground_is_all_safe_and_reachable_but_for_its_edge():
    truth = truth_grid(build_world(FlatGeometry(), team_of(2)), BODY, CONTACT, CELL)
    assert truth.safe.all()
    assert not truth.obstacle.any()
    assert truth.reachable[1:-1, 1:-1].all()


def heights(profile):
    """Ground 1 m wide whose height along x is given every centimetre."""
    return HeightField(np.repeat(np.asarray(profile, np.float32)[:, None], 101, axis=1), (0.0, 0.0), 0.01)


@pytest.mark.parametrize(
    ("rise", "passes"), [(np.linspace(0, 0.3, 50), True), (np.full(50, 0.02), True), (np.full(50, 0.04), False)]
)
def test_slopes_and_low_steps_pass_and_kerbs_do_not(rise, passes):
    ground = heights(np.concatenate([np.zeros(50), rise]))
    passable = passable_ground(ground, (0.2, 0.5), max_step_m=0.03)
    assert passable[:50].all()
    assert bool(passable[75].all()) is passes


def test_ground_that_is_not_there_is_an_obstacle():
    field = heights(np.where(np.arange(100) // 10 == 7, np.nan, 0.0))
    world = World("gap", field, None, (), ((0.2, 0.5, 0.0),), (0.2, 0.5, 0.0), (0.9, 0.5, 0.05))
    truth = truth_grid(world, BODY, CONTACT, CELL)
    assert truth.obstacle[14:].all()
    assert not truth.safe[14:].any()
    assert not safe_path_exists(world, BODY, CONTACT, 0.03)


def test_a_trap_across_the_arena_cuts_the_goal_off():
    team = team_of(1)
    assert safe_path_exists(build_world(ArenaGeometry(), team), BODY, CONTACT, 0.015)
    barred = build_world(ArenaGeometry(trap_size_m=(0.1, 0.5)), team)
    assert not safe_path_exists(barred, BODY, CONTACT, 0.015)

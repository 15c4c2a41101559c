from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from coop_envs.errors import ConfigError, WorldError
from coop_envs.scenario import load_scenario, scenario_world
from coop_envs.worlds.build import build_world
from coop_envs.worlds.raster import heights_at
from coop_envs.worlds.rubble import RubbleGeometry, reach
from coop_envs.worlds.truth import truth_grid
from tests.geometry.scenes import cast, hidden, terrain_of, true_ranges, unit
from tests.worlds.builders import team_of

UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])


def openings(world):
    """Free ground with something over it: points (n, 3) on the ground and the clearance above them."""
    truth = truth_grid(world, 0.07, 0.05, 0.05, 0.015)
    i, j = np.nonzero(truth.reachable)
    x, y = (np.asarray(o + (k + 0.5) * 0.05, dtype=np.float64) for o, k in zip(truth.origin_m, (i, j), strict=True))
    points = np.column_stack([x, y, heights_at(world.ground, x, y)])
    above = cast(terrain_of(world), points + 0.01 * UP, np.tile(UP, (len(points), 1)), 5.0) + 0.01
    return points[np.isfinite(above)], above[np.isfinite(above)]


@pytest.mark.parametrize("split", ["train", "heldout"])
def test_every_seed_takes_three_surveyors_at_once_and_has_room_under_slabs(split):
    scenario = load_scenario("rubble")
    worlds, under = [], 0
    for index in range(31):
        before = time.perf_counter()
        world = scenario_world(scenario, split, index)
        assert time.perf_counter() - before < 1.0
        worlds.append(world)
        assert len(world.starts) == 3
        assert world.mesh is not None
        assert len(world.hazards) >= 2
        assert np.ptp(heights_at(world.ground, *np.array(world.starts)[:, :2].T)) < 0.15
        if index < 8:
            points, clearance = openings(world)
            under += len(points) > 20
            assert np.all(clearance > 0.15)
    assert under >= 6
    assert len({world.ground.heights_m.tobytes() for world in worlds}) == 31


def test_training_and_heldout_rubble_differ_and_a_seed_gives_the_same():
    def ground(split, index=5):
        return build_world(RubbleGeometry(), team_of(2), split=split, index=index)

    assert not np.array_equal(ground("train").ground.heights_m, ground("heldout").ground.heights_m)
    assert np.array_equal(ground("train").ground.heights_m, ground("train").ground.heights_m)
    assert ground("train").hazards == ground("train").hazards


@pytest.mark.parametrize("index", range(3))
def test_rays_meet_the_rubble_where_trimesh_says(index):
    world = build_world(RubbleGeometry(), team_of(2), index=index)
    assert world.mesh is not None
    mesh = trimesh.Trimesh(world.mesh.vertices_m, world.mesh.faces, process=False)
    rng = np.random.default_rng(index)
    start = rng.uniform([0.2, 0.2, 0.9], [4.8, 4.8, 1.5], (150, 3))
    direction = unit(rng.uniform([0.2, 0.2, 0.0], [4.8, 4.8, 0.4], (150, 3)) - start)
    found, truth = cast(terrain_of(world), start, direction), true_ranges(mesh, start, direction)
    assert np.mean(np.isclose(found, truth, atol=1e-3)) > 0.99
    assert np.mean(np.isfinite(truth)) > 0.85


def test_rays_straight_down_meet_the_ground_but_where_a_slab_is_over_it():
    world = build_world(RubbleGeometry(), team_of(2))
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0.05, 4.95, (2, 3000))
    found = 3.0 - cast(terrain_of(world), np.column_stack([x, y, np.full(3000, 3.0)]), np.tile(DOWN, (3000, 1)))
    ground = heights_at(world.ground, x, y)
    same = np.abs(found - ground) < 1e-4
    assert same.mean() > 0.85
    heights = world.ground.heights_m
    around = np.stack([np.roll(heights, (a, b), (0, 1)) for a in range(-2, 3) for b in range(-2, 3)])
    i, j = (np.round(v / world.ground.cell_m).astype(int) for v in (x, y))
    within_a_cell = np.abs(found - ground) <= np.ptp(around, axis=0)[i, j]
    assert np.all(same | within_a_cell | (found - ground > 0.15))
    assert np.sum(found - ground > 0.15) > 20


@pytest.mark.parametrize("index", range(4))
def test_nothing_stands_between_neighbouring_places_that_robots_reach(index):
    world = build_world(RubbleGeometry(hazards=0), team_of(2), index=index)
    truth = truth_grid(world, 0.07, 0.05, 0.05, 0.015)
    i, j = np.nonzero(truth.reachable[:-1, :-1] & truth.reachable[1:, :-1] & truth.reachable[:-1, 1:])
    x, y = (np.asarray(o + (k + 0.5) * 0.05, dtype=np.float64) for o, k in zip(truth.origin_m, (i, j), strict=True))
    here = np.column_stack([x, y, heights_at(world.ground, x, y) + 0.06])
    for beside in (here + [0.05, 0.0, 0.0], here + [0.0, 0.05, 0.0]):
        beside[:, 2] = heights_at(world.ground, beside[:, 0], beside[:, 1]) + 0.06
        assert not hidden(terrain_of(world), here, beside).any()


def test_without_overhangs_the_ground_is_all_there_is():
    world = build_world(RubbleGeometry(leaning=(0, 0), bridges=(0, 0)), team_of(2))
    assert world.mesh is None
    assert np.isfinite(world.ground.heights_m).all()
    assert np.ptp(world.ground.heights_m) > 0.4


def test_hills_keep_their_relief_and_slope():
    for index in range(5):
        bare = RubbleGeometry(pillars=(0, 0), slabs=(0, 0), leaning=(0, 0), bridges=(0, 0), relief_m=0.25)
        world = build_world(bare, team_of(2), index=index)
        assert world.ground.heights_m.min() == pytest.approx(0.0, abs=1e-6)
        assert 0.1 < world.ground.heights_m.max() <= 0.2501
        assert np.linalg.norm(np.gradient(world.ground.heights_m, world.ground.cell_m), axis=0).max() < 0.23
        assert reach(world, team_of(2)) > 0.9


def test_impossible_rubble_is_refused():
    for field, value in (("size_m", (1.0, 5.0)), ("pillars", (3, 1)), ("steepest", 2.0), ("headroom_m", 0.5),
                         ("cell_m", 0.02), ("hazards", -1)):  # fmt: skip
        fields: dict[str, Any] = {field: value}
        with pytest.raises(ConfigError, match=rf"environment\.geometry\.{field}"):
            RubbleGeometry(**fields)
    giants = tuple(replace(robot, body_radius_m=0.8) for robot in team_of(2))
    with pytest.raises(WorldError, match=r"environment\.geometry\.size_m: .*room for the team") as caught:
        build_world(RubbleGeometry(), giants)
    assert "\n" not in str(caught.value)

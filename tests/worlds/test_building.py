from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coop_envs.errors import ConfigError, WorldError
from coop_envs.scenario import load_scenario, scenario_world
from coop_envs.worlds.build import build_world
from coop_envs.worlds.building import BuildingGeometry
from coop_envs.worlds.truth import clearance_m, components, truth_grid
from tests.worlds.builders import team_of

AREA_M2 = {"small": (9.0, 18.0), "medium": (30.0, 60.0), "large": (90.0, 170.0)}


@pytest.mark.parametrize("size", ["small", "medium", "large"])
@pytest.mark.parametrize("split", ["train", "heldout"])
def test_every_seed_takes_three_surveyors_at_once(size, split):
    scenario = load_scenario("building", **{"environment.geometry.size": size})
    seen = set()
    for index in range(31 if size == "medium" else 5):
        before = time.perf_counter()
        world = scenario_world(scenario, split, index)
        assert time.perf_counter() - before < 1.0
        seen.add(world.ground.heights_m.tobytes())
        assert world.mesh is None
        assert len(world.starts) == 3
        assert len(world.hazards) >= 2
    assert len(seen) == (31 if size == "medium" else 5)
    other = scenario_world(scenario, "train" if split == "heldout" else "heldout", 0)
    assert other.ground.heights_m.tobytes() not in seen


@pytest.mark.parametrize("size", ["small", "medium", "large"])
@pytest.mark.parametrize("index", range(4))
def test_every_room_can_be_reached(size, index):
    world = build_world(BuildingGeometry(size=size, hazards=0), team_of(2), index=index)
    floor = world.ground.heights_m == 0
    wide = clearance_m(floor, world.ground.cell_m) >= 0.1
    labels = components(wide)
    assert labels.max() == 1
    area = floor.sum() * world.ground.cell_m**2
    assert AREA_M2[size][0] < area < AREA_M2[size][1]
    truth = truth_grid(world, 0.07, 0.045, 0.05)
    assert truth.reachable.sum() * 0.05**2 > 0.95 * area


def test_walls_close_the_building_and_doors_open_its_rooms():
    world = build_world(BuildingGeometry(hazards=0, furniture=0.0), team_of(2))
    heights = world.ground.heights_m
    for edge in (heights[:4], heights[-4:], heights[:, :4], heights[:, -4:]):
        assert np.all(edge == 0.5)
    rooms = components(clearance_m(heights == 0, world.ground.cell_m) >= 0.4)
    assert rooms.max() >= 5


def test_the_start_looks_down_a_long_way():
    world = build_world(BuildingGeometry(hazards=0), team_of(2))
    x, y, yaw = world.starts[0]
    ahead = np.arange(0.0, 2.5, 0.02)
    i, j = (np.round((p - o) / 0.025).astype(int) for p, o in zip(
        (x + ahead * np.cos(yaw), y + ahead * np.sin(yaw)), world.ground.origin_m, strict=True))  # fmt: skip
    assert np.all(world.ground.heights_m[i, j] == 0)


def test_furniture_stands_in_rooms_and_is_lower_than_walls():
    with_it = build_world(BuildingGeometry(furniture=1.0, hazards=0), team_of(2)).ground.heights_m
    assert np.mean(with_it == np.float32(0.3)) > 0.005


def test_impossible_buildings_are_refused():
    for field, value in (("room_m", (0.2, 2.0)), ("corridor_m", (1.0, 0.5)), ("door_m", (0.5, 1.6)), ("wall_m", 0.0),
                         ("second_doors", 1.5), ("hazards", -1), ("cell_m", 0.1)):  # fmt: skip
        fields: dict[str, Any] = {field: value}
        with pytest.raises(ConfigError, match=rf"environment\.geometry\.{field}"):
            BuildingGeometry(**fields)
    with pytest.raises(ConfigError, match=r"environment\.geometry\.size: got 'huge', expected 'small', 'medium' or"):
        load_scenario("building", **{"environment.geometry.size": "huge"})


def test_a_building_for_smaller_robots_is_refused_in_one_line():
    giants = tuple(replace(robot, body_radius_m=1.4) for robot in team_of(2))
    with pytest.raises(WorldError, match=r"environment\.geometry\.room_m: .*free level ground for 3 robots"):
        build_world(BuildingGeometry(), giants)

"""The corner of Fig 6.6 and the ramp of chapter 5."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from coop_envs.errors import ConfigError, WorldError
from coop_envs.scenario import load_scenario, scenario_world
from coop_envs.worlds.build import build_world
from coop_envs.worlds.corner import CornerGeometry
from coop_envs.worlds.ramp import RampGeometry
from coop_envs.worlds.raster import heights_at
from coop_envs.worlds.truth import safe_path_exists, truth_grid
from tests.geometry.scenes import cast, terrain_of
from tests.worlds.builders import team_of

HALF_VIEW_RAD = np.arctan(320 / 457.007)


def surveyors(pickets: int):
    return tuple(replace(robot, camera=True) for robot in team_of(pickets))


def bearing(pose, at) -> float:
    """Angle from a pose's heading to a point, to the left."""
    angle = np.arctan2(at[1] - pose[1], at[0] - pose[0]) - pose[2]
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def test_two_robots_stand_where_the_authors_put_them_and_the_second_sees_the_first():
    world = build_world(CornerGeometry(), surveyors(1))
    assert world.starts == ((0.0, 0.0, 0.0), (1.0, 2.0, -np.pi / 2))
    assert world.mesh is None
    assert abs(bearing(world.starts[1], world.starts[0])) < HALF_VIEW_RAD
    third = build_world(CornerGeometry(), surveyors(2)).starts[2]
    assert abs(bearing(third, world.starts[0])) < HALF_VIEW_RAD


def test_the_first_robot_faces_one_wall_and_has_the_other_to_its_right():
    terrain = terrain_of(build_world(CornerGeometry(), surveyors(1)))
    eye = np.array([0.0, 0.0, 0.15])
    directions = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 1.0, 0], [-1.0, 0, 0]])
    ranges = cast(terrain, np.tile(eye, (4, 1)), directions)
    assert ranges[:2] == pytest.approx([2.0, 0.5], abs=0.01)
    assert np.all(np.isinf(ranges[2:]))


def test_both_robots_see_parts_of_floor_and_walls():
    world = build_world(CornerGeometry(), surveyors(1))
    terrain = terrain_of(world)
    for point in ([2.0, -0.2, 0.2], [1.6, -0.5, 0.2], [1.2, 0.2, 0.0]):
        for pose in world.starts:
            eye = np.array([*pose[:2], 0.15])
            ray = np.array(point) - eye
            assert abs(bearing(pose, point)) < HALF_VIEW_RAD
            found = cast(terrain, eye[None], ray[None] / np.linalg.norm(ray))[0]
            assert found == pytest.approx(np.linalg.norm(ray), abs=0.03)


def test_a_team_with_blind_pickets_stands_in_formation_before_the_corner():
    world = build_world(CornerGeometry(), team_of(2, reserves=3))
    assert world.starts[0] == (0.0, 0.0, 0.0)
    assert all(x > 0.3 and abs(y) < 0.2 for x, y, _ in world.starts[1:])
    own = (surveyors(1)[0], replace(surveyors(1)[1], start=(1.0, 1.0, 0.5)))
    assert build_world(CornerGeometry(), own).starts[1] == (1.0, 1.0, 0.5)


def test_reserves_of_seeing_teams_wait_in_the_dock():
    team = tuple(replace(robot, camera=True) for robot in team_of(1, reserves=2))
    world = build_world(CornerGeometry(), team)
    assert world.starts[2:] == (world.dock, world.dock)
    assert world.dock == world.starts[1]


def test_impossible_corners_are_refused():
    with pytest.raises(ConfigError, match=r"environment\.geometry\.starts: .*for each of 4 robots"):
        build_world(CornerGeometry(), surveyors(3))
    with pytest.raises(ConfigError, match=r"environment\.geometry\.wall_ahead_m: got 0\.0"):
        CornerGeometry(wall_ahead_m=0.0)
    with pytest.raises(WorldError, match=r"observer_0.*0\.07 m or more to walls"):
        build_world(CornerGeometry(starts=((1.98, 0.0, 0.0), (1.0, 2.0, 0.0))), surveyors(1))


def test_the_ramp_is_five_metres_from_start_to_goal_and_ends_at_its_height():
    world = build_world(RampGeometry(), team_of(2))
    x, y, _ = world.goal or (0, 0, 0)
    assert x + abs(y) == pytest.approx(5.0, abs=1e-9)
    lane = np.array([[0, 0], [2.4, 0], [2.4, -0.6], [2.4, -1.3], [2.4, -2.0], [x, y]])
    assert heights_at(world.ground, *lane.T.astype(float)) == pytest.approx([0, 0, 0, 0.1, 0.2, 0.2], abs=1e-6)
    beside = heights_at(world.ground, np.array([1.77, 3.03, 0.0]), np.array([-1.3, -1.3, 0.64]))
    assert beside == pytest.approx([0.15, 0.15, 0.05], abs=0.002)


@pytest.mark.parametrize("index", range(4))
def test_rocks_differ_by_seed_and_stop_no_zumy(index):
    team = team_of(2)
    world = build_world(RampGeometry(), team, index=index)
    other = build_world(RampGeometry(), team, split="heldout", index=index)
    assert not np.array_equal(world.ground.heights_m, other.ground.heights_m)
    assert safe_path_exists(world, 0.07, 0.05, 0.015, margin_m=0.05)
    rocks = world.ground.heights_m[145:245, 310:350]
    assert 0.01 < rocks.max() <= 0.03
    slopes = np.linalg.norm(np.gradient(rocks, world.ground.cell_m), axis=0)
    assert slopes.max() < np.tan(0.5)


def test_a_hidden_hole_waits_beyond_the_turn():
    world = build_world(RampGeometry(), team_of(2))
    (hole,) = world.hazards
    assert hole.kind == "hole"
    assert bearing((0.0, 0.0, 0.0), hole.centre_m) > 0
    assert hole.signed_distance_m(np.array([2.4, 0.0])) > 0.15
    truth = truth_grid(world, 0.07, 0.045, 0.05)
    i, j = (int((c - o) / 0.05) for c, o in zip(hole.centre_m, truth.origin_m, strict=True))
    assert not truth.safe[i, j]
    assert build_world(RampGeometry(hole=False), team_of(2)).hazards == ()


def test_impossible_ramps_are_refused():
    for field, value in (("rocks", -1), ("rock_height_m", (0.05, 0.2)), ("ramp_height_m", 2.0), ("kerb_height_m", 0.0)):
        fields: dict[str, Any] = {field: value}
        with pytest.raises(ConfigError, match=rf"environment\.geometry\.{field}"):
            RampGeometry(**fields)


def test_scenarios_of_the_thesis_bring_their_teams():
    corner, ramp = load_scenario("corner"), load_scenario("ramp")
    assert (corner.team.name, corner.task.success) == ("surveyors_pair", "coverage")
    assert (ramp.team.name, ramp.task.success) == ("inchworm", "goal")
    assert scenario_world(corner).starts[1] == (1.0, 2.0, -np.pi / 2)

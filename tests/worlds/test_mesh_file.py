from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from coop_envs.errors import ConfigError, WorldError
from coop_envs.scenario import load_scenario, scenario_world
from coop_envs.worlds.build import Split, build_world
from coop_envs.worlds.mesh_file import MeshFileGeometry
from coop_envs.worlds.raster import heights_at
from coop_envs.worlds.truth import truth_grid
from tests.geometry.scenes import cast, terrain_of
from tests.worlds.builders import box, joined, room, team_of, written

CORRIDOR = Path(__file__).parents[3] / "shared" / "data" / "freiburg079.ply"


@pytest.fixture
def hall(tmp_path):
    return written(tmp_path / "hall.ply", room((5.0, 2.0)))


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_every_format_and_scale_gives_the_same_room(tmp_path, suffix, scale):
    path = written(tmp_path / f"hall{suffix}", room((5.0, 2.0)), scale)
    world = build_world(MeshFileGeometry(path, scale=1 / scale, hazards=0), team_of(2))
    truth = truth_grid(world, 0.07, 0.045, 0.05)
    inside = np.zeros_like(truth.safe)
    inside[2:-2, 2:-2] = True
    assert world.name == "hall"
    assert truth.origin_m == pytest.approx((-0.1, -0.1))
    assert np.array_equal(truth.safe, inside)
    assert np.array_equal(truth.obstacle, ~inside)
    assert truth.reachable[3:-3, 3:-3].all()


def test_the_team_starts_at_one_end_looking_along_the_room(hall):
    world = build_world(MeshFileGeometry(hall, hazards=0), team_of(2, reserves=2))
    x, _, yaw = world.starts[0]
    assert min(x, 5.0 - x) < 0.6
    assert np.cos(yaw) * (2.5 - x) > 1.5
    assert world.dock == world.starts[1] == world.starts[3]
    for px, py, _ in world.starts:
        assert 0.07 <= px <= 4.93
        assert 0.07 <= py <= 1.93


def test_a_narrow_corridor_makes_the_team_close_up(tmp_path):
    path = written(tmp_path / "narrow.ply", room((3.0, 0.42)))
    starts = build_world(MeshFileGeometry(path, hazards=0), team_of(2)).starts
    assert abs(starts[1][1] - starts[2][1]) == pytest.approx(0.16, abs=1e-6)


def test_hidden_traps_are_seeded_reachable_apart_and_away_from_the_start(hall):
    def traps(index: int, split: Split = "train"):
        return build_world(MeshFileGeometry(hall, hazards=3), team_of(1), split=split, index=index)

    world = traps(0)
    assert world.hazards == traps(0).hazards
    assert world.hazards != traps(1).hazards
    assert world.hazards != traps(0, "heldout").hazards
    assert 1 <= len(world.hazards) <= 3
    for hazard in world.hazards:
        assert hazard.kind == "trap"
        assert 0.15 <= hazard.radius_m <= 0.3
        assert hazard.signed_distance_m(np.array(world.starts)[:, :2]).min() > 0.3


def test_a_file_that_changes_is_read_again(tmp_path):
    path = tmp_path / "changing.ply"
    written(path, room((3.0, 2.0)))
    first = build_world(MeshFileGeometry(str(path), hazards=0), team_of(1))
    written(path, room((4.0, 2.0)))
    os.utime(path, ns=(1, 1))
    second = build_world(MeshFileGeometry(str(path), hazards=0), team_of(1))
    assert second.ground.bounds_m[2] == pytest.approx(first.ground.bounds_m[2] + 1.0)


def refusal(path, team=None, **fields):
    with pytest.raises(WorldError) as caught:
        build_world(MeshFileGeometry(str(path), **fields), team or team_of(1))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_broken_meshes_are_refused(tmp_path):
    vertices, faces = room((2.0, 2.0))
    vertices = vertices.copy()
    vertices[3, 1] = np.nan
    assert "1 of 40 are NaN" in refusal(written(tmp_path / "nan.ply", (vertices, faces)))
    garbage = tmp_path / "garbage.ply"
    garbage.write_bytes(b"not a mesh at all")
    assert "a readable mesh" in refusal(garbage)
    empty = tmp_path / "empty.obj"
    empty.write_text("")
    assert "environment.geometry.path" in refusal(empty)
    points = tmp_path / "points.obj"
    points.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    assert "environment.geometry.path" in refusal(points)
    assert "a file that exists" in refusal(tmp_path / "missing.ply")
    assert ".ply, .obj, .stl" in refusal(tmp_path / "picture.png")


def test_files_cut_short_and_faces_of_nothing_are_refused(tmp_path):
    whole = Path(written(tmp_path / "whole.ply", room((2.0, 2.0)))).read_bytes()
    for name, content in (("cut", whole[: len(whole) // 2]), ("head", whole[:60]), ("zero", b"")):
        path = tmp_path / f"{name}.ply"
        path.write_bytes(content)
        assert "environment.geometry.path" in refusal(path)
    flat = tmp_path / "flat.obj"
    flat.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 3\nf 1 1 4\n")
    assert "facing up" in refusal(flat)
    beyond = tmp_path / "beyond.obj"
    beyond.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    assert "environment.geometry.path" in refusal(beyond)


@pytest.mark.parametrize(
    ("scale", "reason"),
    [(0.02, "one that makes rooms.ply 0.3 m or more"), (0.09, "free level ground for 2 robots that need 0.24 m")],
)
def test_a_scale_that_makes_robots_larger_than_rooms_is_refused(tmp_path, scale, reason):
    rooms = written(tmp_path / "rooms.ply", joined(room((8.0, 3.5)), box((3.9, 0.0, 0.0), (4.1, 3.5, 0.5))))
    assert f"environment.geometry.scale: got {scale}, expected {reason}" in refusal(rooms, scale=scale)
    assert build_world(MeshFileGeometry(rooms, scale=0.5), team_of(1)).mesh is not None


def test_meshes_without_room_are_refused(tmp_path):
    assert "environment.geometry.scale: got 1.0, expected one that makes tiny.ply 0.3 m" in refusal(
        written(tmp_path / "tiny.ply", room((0.05, 0.05)))
    )
    assert "scale 0.001" in refusal(written(tmp_path / "mm.ply", room((5.0, 2.0)), 1000.0))
    wall = np.array([[0, 0, 0], [1, 1, 0], [1, 1, 1.0]]), np.array([[0, 1, 2]])
    assert "facing up" in refusal(written(tmp_path / "wall.ply", wall))
    cell = room((0.25, 0.25))
    assert "free level ground for 2 robots that need 0.24 m" in refusal(written(tmp_path / "cell.ply", cell))


def test_starts_in_walls_are_refused(hall):
    assert "walls and edges" in refusal(hall, start=(0.05, 1.0, 0.0))
    assert "observer_0's at z 0.50 m, here z 0.00 m" in refusal(hall, start=(-0.05, 1.0, 0.0))
    assert "environment.geometry.goal" in refusal(hall, goal=(9.0, 1.0, 0.2))


@pytest.mark.parametrize(
    "fields",
    [{"scale": float("inf")}, {"scale": 0.0}, {"hazards": -1}, {"hazard_radius_m": (0.3, 0.1)}, {"headroom_m": 0.0}],
)
def test_impossible_settings_are_refused(fields):
    with pytest.raises(ConfigError, match=rf"environment\.geometry\.{next(iter(fields))}"):
        MeshFileGeometry("room.ply", **fields)


@pytest.mark.slow
@pytest.mark.skipif(not CORRIDOR.is_file(), reason="needs the scanned corridor ../shared/data/freiburg079.ply")
def test_the_real_corridor_takes_a_team():
    world = build_world(MeshFileGeometry(str(CORRIDOR)), team_of(2))
    x, y, yaw = world.starts[0]
    assert -6.3 < x < 28
    assert abs(y) < 1.3
    assert abs(np.sin(yaw)) < 0.3
    assert len(world.hazards) == 6
    assert truth_grid(world, 0.07, 0.045, 0.05).reachable.sum() > 34 * 2 / 0.05**2


@pytest.mark.slow
@pytest.mark.skipif(not CORRIDOR.is_file(), reason="needs the scanned corridor ../shared/data/freiburg079.ply")
def test_surveyors_face_open_ground_in_the_real_corridor():
    scenario = load_scenario("arena", team="surveyors", world=str(CORRIDOR))
    terrain = terrain_of(scenario_world(scenario))
    for index in (0, 29):
        world = scenario_world(scenario, "heldout", index)
        assert len(world.starts) == 3
        for x, y, yaw in world.starts:
            ahead = np.arange(0.0, 2.0, 0.02)[:, None]
            lanes = np.linspace(-0.1, 0.1, 5)
            at_x = x + ahead * np.cos(yaw) - lanes * np.sin(yaw)
            at_y = y + ahead * np.sin(yaw) + lanes * np.cos(yaw)
            floor = heights_at(world.ground, at_x, at_y)
            assert np.isfinite(floor).all()
            assert np.abs(np.diff(floor, axis=0)).max() < 0.015
            eye = np.array([[x, y, heights_at(world.ground, np.array([x]), np.array([y]))[0] + 0.15]])
            assert cast(terrain, eye, np.array([[np.cos(yaw), np.sin(yaw), 0.0]]))[0] > 2.0

"""Overhangs take the mesh, single-valued ground the height field, and both agree where both apply."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh

from coop_envs import exploration_v0
from coop_envs.worlds.bodies import block, ground_mesh, merged, turned
from coop_envs.worlds.build import build_world
from coop_envs.worlds.building import BuildingGeometry
from coop_envs.worlds.corner import CornerGeometry
from coop_envs.worlds.mesh_file import MeshFileGeometry
from coop_envs.worlds.ramp import RampGeometry
from coop_envs.worlds.raster import heights_at, lowest_ground, single_valued
from coop_envs.worlds.rubble import RubbleGeometry
from coop_envs.worlds.truth import passable_ground
from coop_envs.worlds.world import HeightField, Mesh
from tests.geometry.scenes import cast, hidden, terrain_of, unit
from tests.worlds.builders import box, joined, room, team_of, written

SINGLE_VALUED: list[Any] = [
    CornerGeometry(),
    RampGeometry(),
    RubbleGeometry(leaning=(0, 0), bridges=(0, 0)),
    BuildingGeometry(size="small"),
]
TABLE = box((1.2, 0.3, 0.20), (1.8, 1.7, 0.25))


@pytest.mark.parametrize("geometry", SINGLE_VALUED, ids=lambda geometry: geometry.kind)
def test_rays_find_the_same_on_a_height_field_and_on_its_mesh(geometry):
    world = build_world(geometry, team_of(2))
    assert world.mesh is None
    both = terrain_of(world, replace(world, mesh=ground_mesh(world.ground)))
    x0, y0, x1, y1 = world.ground.bounds_m
    rng = np.random.default_rng(0)
    xy = rng.uniform([x0 + 0.05, y0 + 0.05], [x1 - 0.05, y1 - 0.05], (20_000, 2))
    start = np.column_stack([xy, heights_at(world.ground, *xy.T) + rng.uniform(0.02, 0.4, 20_000)])
    direction = unit(rng.normal(size=(20_000, 3)) * [1.0, 1.0, 0.3])
    field, mesh = (cast(both, start, direction, world=w) for w in (0, 1))
    same = np.isclose(field, mesh, atol=1e-3) | (np.isinf(field) & np.isinf(mesh))
    assert np.mean(same) > 0.999
    assert np.isfinite(field).mean() > 0.3
    end = np.column_stack([xy[::-1], heights_at(world.ground, *xy[::-1].T) + 0.15])
    assert np.mean(hidden(both, start, end, world=0) == hidden(both, start, end, world=1)) > 0.999


def test_a_mesh_that_is_only_ground_takes_the_height_field_path(tmp_path):
    hills = build_world(RubbleGeometry(leaning=(0, 0), bridges=(0, 0), slabs=(0, 0), pillars=(0, 0)), team_of(2)).ground
    coarse = HeightField(np.ascontiguousarray(hills.heights_m[::4, ::4]), hills.origin_m, 4 * hills.cell_m)
    surface = ground_mesh(coarse)
    path = written(tmp_path / "hills.ply", (surface.vertices_m, surface.faces))
    world = build_world(MeshFileGeometry(path, hazards=0), team_of(2))
    assert world.mesh is None
    assert world.ground.heights_m[::4, ::4] == pytest.approx(coarse.heights_m, abs=1e-6)


def test_walls_tables_and_creases_off_the_grid_keep_the_mesh(tmp_path):
    table = joined(room((3.0, 2.0)), TABLE)
    assert build_world(MeshFileGeometry(written(tmp_path / "t.ply", table), hazards=0), team_of(2)).mesh is not None
    roof = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0.512, 0.2], [1, 0.512, 0.2]])
    mesh = Mesh(roof.astype(np.float32), np.array([[0, 1, 5], [0, 5, 4], [4, 5, 2], [4, 2, 3]], dtype=np.int32))
    assert not single_valued(mesh, lowest_ground(mesh, 0.025, 0.15))
    roof[4:, 1] = 0.5
    mesh = Mesh(roof.astype(np.float32), mesh.faces)
    assert single_valued(mesh, lowest_ground(mesh, 0.025, 0.15))


def test_rays_pass_under_a_table_and_meet_its_top(tmp_path):
    path = written(tmp_path / "table.ply", joined(room((3.0, 2.0)), TABLE))
    world = build_world(MeshFileGeometry(path, hazards=0), team_of(1))
    terrain = terrain_of(world)
    start = np.array([[0.5, 1.0, 0.1], [0.5, 1.0, 0.225], [1.5, 1.0, 0.1], [1.5, 1.0, 0.5]])
    direction = np.array([[1.0, 0, 0], [1.0, 0, 0], [0, 0, 1.0], [0, 0, -1.0]])
    assert cast(terrain, start, direction) == pytest.approx([2.5, 0.7, 0.1, 0.25], abs=1e-5)
    assert not hidden(terrain, [[0.5, 1.0, 0.1]], [[2.5, 1.0, 0.1]])[0]
    assert hidden(terrain, [[1.5, 1.0, 0.1]], [[0.5, 1.0, 0.9]])[0]
    assert heights_at(world.ground, np.array([1.5]), np.array([1.0])) == pytest.approx([0.0])


def test_a_robot_drives_under_a_deck_and_not_through_a_block(tmp_path):
    for name, low, passes in (("deck", (1.2, -0.05, 0.20), True), ("block", (1.2, -0.05, 0.0), False)):
        path = written(tmp_path / f"{name}.ply", joined(room((3.0, 2.0)), box(low, (1.8, 2.05, 0.25))))
        overrides = {"environment.geometry.hazards": 0, "environment.geometry.start": (0.5, 1.0, 0.0)}
        env = exploration_v0.parallel_env("arena", team="surveyors_pair", world=path, **overrides)
        env.reset(seed=0)
        drive = np.array([-1.0, 1.0, 0, 0, 0, 0, 0, 0], dtype=np.float32)
        hold = np.array([1.0, 0, 0, 0, 0, 0, 0, 1.0], dtype=np.float32)
        for _ in range(120):
            env.step({agent: drive if agent == "picket_0" else hold for agent in env.agents})
            if "picket_0" not in env.agents:
                break
        x = float(env.frame().true_xy_yaw[1][0])
        assert (x > 2.0) is passes
        assert passes or x < 1.2


def test_a_bridge_of_bodies_is_passed_under_and_its_blocks_are_not():
    floor = HeightField(np.zeros((41, 41), dtype=np.float32), (0.0, 0.0), 0.05)
    blocks = [block((0.16, 0.5, 0.4), (1.0 + side * 0.4, 1.0, 0.1), turned(0.0)) for side in (-1, 1)]
    mesh = merged([ground_mesh(floor), block((0.96, 0.5, 0.05), (1.0, 1.0, 0.325), turned(0.0)), *blocks])
    ground = lowest_ground(mesh, 0.025, 0.18)
    at = np.array([[1.0, 1.0], [0.8, 1.1], [0.6, 1.0], [1.4, 0.9], [0.2, 0.2]])
    assert heights_at(ground, *at.T) == pytest.approx([0.0, 0.0, 0.35, 0.35, 0.0], abs=1e-6)


@pytest.mark.parametrize("x", [1.0, 1.008, 1.0124, 1.0126, 1.02])
@pytest.mark.parametrize("thickness_m", [0.0, 0.01])
def test_walls_too_thin_for_the_grid_bar_the_way_all_the_same(x, thickness_m):
    thin = box((x, 0.0, 0.0), (x + thickness_m, 2.0, 0.5))
    vertices, faces = joined(room((2.0, 2.0)), thin)
    ground = lowest_ground(Mesh(vertices.astype(np.float32), faces.astype(np.int32)), 0.025, 0.15)
    passable = passable_ground(ground, (0.5, 1.0), 0.03)
    i = round((x - ground.origin_m[0]) / 0.025)
    assert passable[i - 2, 5:-5].all()
    assert not passable[i + 3 :].any()
    assert np.nanmax(ground.heights_m[i - 2 : i + 3]) == pytest.approx(0.5, abs=1e-3)


def test_table_legs_bar_the_way_and_low_steps_do_not():
    legs = [box((x, y, 0.0), (x + 0.012, y + 0.012, 0.3)) for x in (0.605, 1.405) for y in (0.605, 1.405)]
    low = box((1.7, 0.6, 0.0), (1.712, 1.4, 0.02))
    vertices, faces = joined(room((2.0, 2.0)), box((0.6, 0.6, 0.3), (1.42, 1.42, 0.33)), *legs, low)
    ground = lowest_ground(Mesh(vertices.astype(np.float32), faces.astype(np.int32)), 0.025, 0.15)
    passable = passable_ground(ground, (0.3, 0.3), 0.03)
    assert int((~passable[6:-6, 6:-6]).sum()) in range(4, 17)
    assert heights_at(ground, np.array([1.0, 1.706]), np.array([1.0, 1.0])) == pytest.approx([0.0, 0.0], abs=0.021)


@pytest.mark.parametrize(("yaw", "pitch", "roll"), [(0.3, 0.0, 0.0), (0.0, 0.4, 0.0), (-1.0, 0.2, -0.3)])
def test_bodies_are_closed_and_turn_as_they_are_told(yaw, pitch, roll):
    body = block((1.0, 0.5, 0.2), (1.0, 2.0, 3.0), turned(yaw, pitch, roll))
    solid = trimesh.Trimesh(body.vertices_m, body.faces)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume == pytest.approx(0.1, rel=1e-5)
    assert solid.center_mass == pytest.approx([1.0, 2.0, 3.0], abs=1e-5)
    ahead = turned(yaw, pitch, roll)[:, 0]
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(yaw)
    assert np.arcsin(ahead[2]) == pytest.approx(pitch)

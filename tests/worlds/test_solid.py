from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from coop_envs.worlds.arena import ArenaGeometry
from coop_envs.worlds.bodies import ground_mesh
from coop_envs.worlds.build import build_world
from coop_envs.worlds.raster import lowest_ground
from coop_envs.worlds.solid import SLABS, SolidColumns, lowest_reach_m, solid_columns
from coop_envs.worlds.truth import truth_grid
from coop_envs.worlds.world import HeightField, Mesh, World
from tests.worlds.builders import box, joined, room, team_of

CELL, SLAB = 0.05, 0.025


def world_of_mesh(parts, start=(0.5, 0.5, 0.0)):
    mesh = Mesh(np.asarray(parts[0], np.float32), np.asarray(parts[1], np.int32))
    return World("scene", lowest_ground(mesh, 0.025, 0.15), mesh, (), (start,), start, None)


def world_of_ground(ground: HeightField):
    return World("scene", ground, None, (), (), (0.0, 0.0, 0.0), None)


def is_solid(columns: SolidColumns) -> np.ndarray:
    """(nx, ny, 64)"""
    return (columns.bits[..., None] >> np.arange(SLABS, dtype=np.uint64) & np.uint64(1)).astype(bool)


def heights_of(columns: SolidColumns, x: float, y: float) -> list[float]:
    """Middle heights of the solid slabs over a point."""
    i, j = (int((p - o) // columns.cell_m) for p, o in zip((x, y), columns.origin_m, strict=True))
    return (columns.base_m + columns.slab_m * (np.flatnonzero(is_solid(columns)[i, j]) + 0.5)).round(4).tolist()


def below(height_m: float, lowest_m: float = 0.0) -> list[float]:
    """Middles of all slabs up to one whose middle is ``height_m``, from three below the lowest ground."""
    return np.arange(lowest_m - 3 * SLAB, height_m + SLAB / 2, SLAB).round(4).tolist()


def test_floor_table_and_walls_of_a_room_are_where_they_were_put():
    table = box((0.7, 0.4, 0.20), (1.1, 0.8, 0.25))
    pillar = box((1.41, 0.41, 0.0), (1.49, 0.49, 0.30))
    columns = solid_columns(world_of_mesh(joined(room((2.0, 1.2)), table, pillar), (0.3, 0.3, 0.0)), CELL)
    floor = below(0.0)
    assert heights_of(columns, 0.325, 0.325) == floor
    assert heights_of(columns, 0.925, 0.625) == [*floor, 0.2, 0.225, 0.25]
    assert heights_of(columns, 0.675, 0.625) == floor
    assert heights_of(columns, 0.725, 0.625) == [*floor, 0.2, 0.225, 0.25]
    assert heights_of(columns, 1.425, 0.425) == below(0.3)
    assert heights_of(columns, 0.025, 0.625) == floor
    assert heights_of(columns, -0.025, 0.625) == below(0.5)
    assert heights_of(columns, 1.975, 0.625) == floor
    assert heights_of(columns, 2.025, 0.625) == below(0.5)


def test_a_sheet_on_the_border_of_two_columns_counts_once():
    sheet = np.array([[1.0, 0.3, 0.0], [1.0, 0.9, 0.0], [1.0, 0.9, 0.4], [1.0, 0.3, 0.4]])
    for faces, behind, before in (((0, 1, 2), 0.975, 1.025), ((0, 2, 1), 1.025, 0.975)):
        columns = solid_columns(world_of_mesh(joined(room((2.0, 1.2)), (sheet, np.array([faces])))), CELL)
        assert heights_of(columns, behind, 0.875) == below(0.4)
        assert heights_of(columns, before, 0.875) == below(0.0)


def test_the_arena_is_solid_below_its_floor_and_in_its_walls():
    world = build_world(ArenaGeometry(), team_of(1))
    columns = solid_columns(world, CELL)
    truth = truth_grid(world, 0.07, 0.045, CELL)
    assert columns.bits.shape == truth.safe.shape
    assert columns.origin_m == truth.origin_m
    assert heights_of(columns, 0.4, 0.3) == below(0.0)
    assert heights_of(columns, 0.775, 0.3) == below(0.3)
    assert heights_of(columns, 0.4, 0.625) == below(0.3)
    assert max(heights_of(columns, 0.4, -0.025)) == pytest.approx(0.05)


def test_nothing_is_told_of_what_stands_out_of_the_64_slabs_and_no_ground_is_solid():
    heights = np.zeros((41, 41), dtype=np.float32)
    heights[20:30, 20:30] = 5.0
    heights[:, 35:] = np.nan
    columns = solid_columns(world_of_ground(HeightField(heights, (0.0, 0.0), 0.025)), CELL)
    everything = np.uint64(2**64 - 1)
    assert np.all(columns.bits[11:14, 11:14] == everything)
    assert np.all(columns.bits[:, 18:] == everything)
    assert np.all(columns.bits[:5, :16] == np.uint64(0b1111))


def test_the_base_stands_below_the_ground_that_the_team_can_reach():
    heights = np.zeros((41, 41), dtype=np.float32)
    heights[:, 20:] = -3.0
    ground = HeightField(heights, (0.0, 0.0), 0.025)
    world = World("cliff", ground, None, (), ((0.2, 0.2, 0.0),), (0.2, 0.2, 0.0), None)
    assert lowest_reach_m(world) == 0.0
    assert lowest_reach_m(world_of_ground(ground)) == -3.0


@pytest.mark.parametrize(("cell_m", "map_cell_m"), [(0.025, 0.05), (0.02, 0.05), (0.01, 0.025), (0.025, 0.02)])
def test_a_height_field_equals_dense_samples_of_its_triangles(cell_m, map_cell_m):
    rng = np.random.default_rng(3)
    heights = rng.uniform(0.0, 0.4, (31, 23)).astype(np.float32)
    ground = HeightField(heights, (-0.31, 0.13), cell_m)
    columns = solid_columns(world_of_ground(ground), map_cell_m)
    surface = ground_mesh(ground)
    mesh = trimesh.Trimesh(surface.vertices_m, surface.faces, process=False)
    points = sampled(mesh, 40_000)
    solid = is_solid(columns)
    place = places(columns, points)
    for depth in range(4):
        assert solid[place[:, 0], place[:, 1], place[:, 2] - min(depth, int(place[:, 2].min()))].all()
    highest = np.full(columns.bits.shape, -1)
    np.maximum.at(highest, (place[:, 0], place[:, 1]), place[:, 2])
    above = np.argwhere(solid & (np.arange(SLABS) > highest[..., None]) & (highest[..., None] >= 0))
    for slab in above[rng.permutation(len(above))[:40]]:
        assert touches(mesh, *slab_box(columns, slab))


@pytest.mark.parametrize("seed", range(3))
def test_surfaces_of_meshes_equal_what_trimesh_cuts_out(seed):
    rng = np.random.default_rng(seed)
    torus = trimesh.creation.torus(0.4, 0.1, major_sections=20, minor_sections=10)
    torus.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    torus.apply_translation([0.6, 0.6, 0.7])
    plate = trimesh.creation.box([0.9, 0.5, 0.03], trimesh.transformations.random_rotation_matrix(rng.random(3)))
    plate.apply_translation([1.4, 0.6, 0.6])
    bodies = [torus, plate]
    parts = joined(*((body.vertices, body.faces) for body in bodies))
    scene = trimesh.Trimesh(*parts, process=False)
    floor = box((-0.1, -0.1, -0.1), (2.1, 1.3, 0.0))
    columns = solid_columns(world_of_mesh(joined(floor, parts), (0.0, 0.0, 0.0)), CELL)
    points = sampled(scene, 100_000)
    place = places(columns, points[points[:, 2] < columns.base_m + SLABS * SLAB - 0.001])
    solid = is_solid(columns)
    assert solid[tuple(place.T)].all()
    seen = np.zeros_like(solid)
    seen[tuple(place.T)] = True
    unseen = np.argwhere(solid & ~seen & (np.arange(SLABS) > 4))
    for slab in unseen[rng.permutation(len(unseen))[:60]]:
        low, high = slab_box(columns, slab)
        heights = np.linspace(low[2], high[2], 20)
        centre_line = np.column_stack([*np.broadcast_to((low + high)[:2, None] / 2, (2, 20)), heights])
        assert touches(scene, low, high) or inside(bodies, centre_line)
    contained = places(columns, np.random.default_rng(1).uniform([0, 0, 0.05], [2, 1.2, 1.4], (3000, 3)))
    centres = (contained + 0.5) * [CELL, CELL, SLAB] + [*columns.origin_m, columns.base_m]
    within = np.any([body.contains(centres) for body in bodies], axis=0)
    assert within.sum() > 50
    assert solid[tuple(contained[within].T)].all()


def slab_box(columns: SolidColumns, slab: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) of a slab of a column, a hair wider."""
    low = np.array([*columns.origin_m, columns.base_m]) + slab * [columns.cell_m, columns.cell_m, columns.slab_m]
    return low - 2e-4, low + [columns.cell_m + 2e-4, columns.cell_m + 2e-4, columns.slab_m + 2e-4]


def inside(bodies: list[trimesh.Trimesh], points: np.ndarray) -> bool:
    """Whether any of the points is in any of the bodies."""
    return any(bool(body.contains(points).any()) for body in bodies)


def sampled(mesh: trimesh.Trimesh, count: int) -> np.ndarray:
    """Points on the surface, half a millimetre or more from its triangles' edges, by barycentric coordinates."""
    rng = np.random.default_rng(0)
    face = rng.choice(len(mesh.faces), count, p=mesh.area_faces / mesh.area_faces.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), count)
    inner = weights.min(axis=1) * mesh.area_faces[face] > 1e-5
    points = np.einsum("pk,pkx->px", weights, mesh.triangles[face])[inner]
    return points - 2e-4 * mesh.face_normals[face[inner]]


def places(columns: SolidColumns, points: np.ndarray) -> np.ndarray:
    """Column and slab (p, 3) of points, without those within 0.5 mm of a border."""
    at = (points - [*columns.origin_m, columns.base_m]) / [columns.cell_m, columns.cell_m, columns.slab_m]
    clear = np.abs(at - np.round(at)).min(axis=1) * columns.slab_m > 5e-4
    return np.floor(at[clear]).astype(int)


def touches(mesh: trimesh.Trimesh, low: np.ndarray, high: np.ndarray) -> bool:
    """Whether anything of the surface is left when a box's six planes have cut off the rest."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    origins = np.concatenate([np.tile(low, (3, 1)), np.tile(high, (3, 1))])
    part: trimesh.Trimesh | None = mesh
    for normal, origin in zip(normals, origins, strict=True):
        part = trimesh.intersections.slice_mesh_plane(part, normal, origin)
        if part is None or not len(part.faces):
            return False
    return True


def test_cells_hold_what_their_slabs_hold():
    """A box of 10 cm on a floor at 0: cells in it and under the floor hold something, those over it do not."""
    heights = np.zeros((41, 41), dtype=np.float32)
    heights[20:31, 20:31] = 0.1
    world = dataclasses.replace(world_of_ground(HeightField(heights, (0.0, 0.0), 0.025)), starts=((0.2, 0.2, 0.0),))
    columns = solid_columns(world, CELL, SLAB)
    places = {(0.62, 0.62, 0.05): True, (0.62, 0.62, 0.14): False, (0.2, 0.2, 0.05): False, (0.2, 0.2, -0.03): True}
    places |= {(0.2, 0.2, -5.0): True, (0.2, 0.2, 9.0): False, (-1.0, 0.2, 0.05): True}
    held = columns.holds(np.array(list(places)), 0.05)
    np.testing.assert_array_equal(held, list(places.values()))
    assert columns.top_m == pytest.approx(columns.base_m + 1.6)

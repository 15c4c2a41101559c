from __future__ import annotations

import numpy as np
import pytest
import trimesh

from coop_envs.geometry.terrain import NO_GROUND_M
from coop_envs.worlds.world import HeightField
from tests.geometry.scenes import (
    bumpy,
    cast,
    heights,
    hidden,
    sampled,
    surface_mesh,
    terrain_of,
    true_ranges,
    unit,
    world_of,
)

TOLERANCE_M = 1e-4
PLANE = sampled(lambda x, y: 0.2 + 0.3 * x - 0.1 * y, (2.0, 1.0), 0.05)


def rays_from_above(ground, count, seed):
    """Starts above every height, inside the grid and around it, with directions over the whole sphere."""
    rng = np.random.default_rng(seed)
    x_min, y_min, x_max, y_max = ground.bounds_m
    top = float(ground.heights_m.max())
    low = np.array([x_min - 0.2, y_min - 0.2, top + 0.001])
    start = rng.uniform(low, [x_max + 0.2, y_max + 0.2, top + 0.3], (count, 3))
    return start.astype(np.float32).astype(float), unit(rng.normal(size=(count, 3)))


def assert_same_ranges(terrain, mesh, start, direction):
    """Ranges equal those of trimesh, except where moving the ray by a hair changes what trimesh finds."""
    found, truth = cast(terrain, start, direction), true_ranges(mesh, start, direction)
    far = ~np.isclose(found, truth, rtol=0.0, atol=TOLERANCE_M)
    for k in np.flatnonzero(far):
        hair = TOLERANCE_M * np.concatenate([np.eye(3), -np.eye(3)])
        near = true_ranges(mesh, start[k] + hair, np.repeat(direction[k : k + 1], 6, axis=0))
        between = near.min() - 10 * TOLERANCE_M <= found[k] <= near.max() + 10 * TOLERANCE_M
        assert between or found[k] == near.max(), (start[k], direction[k], found[k], truth[k])
    assert np.mean(far) < 0.01
    assert np.mean(np.isfinite(truth)) > 0.05


@pytest.mark.parametrize("seed", range(3))
def test_height_field_equals_its_triangles(seed):
    ground = bumpy(seed)
    start, direction = rays_from_above(ground, 3000, seed)
    assert_same_ranges(terrain_of(world_of(ground)), surface_mesh(ground), start, direction)


def test_grazing_rays():
    ground = bumpy(5)
    start, direction = rays_from_above(ground, 3000, 5)
    rng = np.random.default_rng(6)
    direction[:, 2] = rng.uniform(-0.1, 0.0, 3000)
    start[:, 2] = ground.heights_m.max() + rng.uniform(0.0, 0.01, 3000).astype(np.float32)
    assert_same_ranges(terrain_of(world_of(ground)), surface_mesh(ground), start, unit(direction))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_rays_along_the_grid(axis, sign):
    ground = bumpy(7)
    start, direction = rays_from_above(ground, 1000, 7)
    direction[:, 1 - axis], direction[:, axis] = 0.0, sign
    direction[:, 2] = np.random.default_rng(8).uniform(-0.5, 0.0, 1000)
    assert_same_ranges(terrain_of(world_of(ground)), surface_mesh(ground), start, unit(direction))


def test_rays_straight_down_meet_the_ground_height():
    ground = bumpy(9)
    terrain = terrain_of(world_of(ground))
    start, _ = rays_from_above(ground, 1000, 9)
    ground_m = heights(terrain, start[:, :2])
    found = cast(terrain, start, np.tile([0.0, 0.0, -1.0], (1000, 1)))
    np.testing.assert_allclose(found, np.where(ground_m == NO_GROUND_M, np.inf, start[:, 2] - ground_m), atol=1e-5)


def test_ground_height_equals_its_triangles():
    ground = bumpy(10)
    x_min, y_min, x_max, y_max = ground.bounds_m
    xy = np.random.default_rng(10).uniform([x_min, y_min], [x_max, y_max], (2000, 2)).astype(np.float32)
    start = np.column_stack([xy.astype(float), np.full(2000, 1.0)])
    truth = 1.0 - true_ranges(surface_mesh(ground), start, np.tile([0.0, 0.0, -1.0], (2000, 1)))
    within = np.isfinite(truth)
    assert np.mean(within) > 0.99
    np.testing.assert_allclose(heights(terrain_of(world_of(ground)), xy)[within], truth[within], atol=1e-4)


def test_ground_height_at_nodes_and_edges():
    ground = bumpy(11, nodes=(4, 3), cell_m=0.25, origin_m=(0.5, -0.5))
    terrain = terrain_of(world_of(ground))
    i, j = (k.ravel() for k in np.meshgrid(np.arange(4), np.arange(3), indexing="ij"))
    nodes = np.stack([0.5 + 0.25 * i, -0.5 + 0.25 * j], axis=-1)
    np.testing.assert_allclose(heights(terrain, nodes), ground.heights_m.ravel(), atol=1e-6)
    beyond = [(0.499, 0.0 - 0.1), (1.251, -0.1), (0.7, -0.501), (0.7, 0.001), (-9.0, 9.0)]
    np.testing.assert_array_equal(heights(terrain, beyond), NO_GROUND_M)


def test_rays_meet_a_plane_where_algebra_says():
    normal = unit(np.array([-0.3, 0.1, 1.0]))
    rng = np.random.default_rng(12)
    start = rng.uniform([0.2, 0.2, 1.0], [1.8, 0.8, 1.5], (2000, 3))
    target = rng.uniform([0.0, 0.0], [2.0, 1.0], (2000, 2))
    aim = np.column_stack([target, 0.2 + 0.3 * target[:, 0] - 0.1 * target[:, 1]])
    direction = unit(aim - start)
    expected = (0.2 * normal[2] - start @ normal) / (direction @ normal)
    np.testing.assert_allclose(cast(terrain_of(world_of(PLANE)), start, direction), expected, atol=1e-5)


def test_a_ray_ends_at_its_limit():
    terrain = terrain_of(world_of(PLANE))
    down = np.array([[0.0, 0.0, -1.0]])
    start = np.array([[0.0, 0.0, 1.0]])
    assert cast(terrain, start, down, limit_m=0.7999)[0] == np.inf
    assert cast(terrain, start, down, limit_m=0.8001)[0] == pytest.approx(0.8, abs=1e-6)


def test_a_ray_from_outside_stops_at_the_edge_it_meets_below_the_ground():
    terrain = terrain_of(world_of(PLANE))
    start = np.array([[-0.5, 0.5, 0.1], [2.4, 0.5, 0.1], [-0.5, 0.5, 0.3]])
    direction = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(cast(terrain, start, direction), [0.5, 0.4, np.inf], atol=1e-6)


def dome(x, y):
    """A sphere of radius 0.3 m sunk 0.2 m into the ground at (0.5, 0.5)."""
    return np.sqrt(np.maximum(0.3**2 - (x - 0.5) ** 2 - (y - 0.5) ** 2, 0.2**2)) - 0.2


def test_rays_at_a_dome_converge_with_the_square_of_the_cell():
    centre, radius = np.array([0.5, 0.5, -0.2]), 0.3
    rng = np.random.default_rng(13)
    start = rng.uniform([0.0, 0.0, 0.2], [1.0, 1.0, 0.6], (2000, 3))
    direction = unit(rng.uniform([0.4, 0.4, 0.02], [0.6, 0.6, 0.06], (2000, 3)) - start)
    b = np.sum((start - centre) * direction, axis=1)
    d2 = b**2 - np.sum((start - centre) ** 2, axis=1) + radius**2
    expected = -b - np.sqrt(np.maximum(d2, 0.0))
    point = start + expected[:, None] * direction
    steep = (d2 > 0) & (np.sum((point - centre) * direction, axis=1) < -0.1) & (point[:, 2] > 0.03)
    assert np.sum(steep) > 1000
    errors = []
    for cell_m in (0.02, 0.01, 0.005):
        terrain = terrain_of(world_of(sampled(dome, (1.0, 1.0), cell_m)))
        errors.append(np.abs(cast(terrain, start, direction) - expected)[steep].mean())
    assert errors[0] > 3.5 * errors[1] > 3.5**2 * errors[2]
    assert errors[2] < 1e-4


def test_rays_pass_where_ground_is_missing():
    heights_m = np.zeros((21, 21), dtype=np.float32)
    heights_m[8:13, 8:13] = np.nan
    terrain = terrain_of(world_of(HeightField(heights_m, (0.0, 0.0), 0.05)))
    down = np.array([[0.0, 0.0, -1.0]] * 2)
    np.testing.assert_allclose(cast(terrain, [[0.5, 0.5, 1.0], [0.2, 0.2, 1.0]], down), [np.inf, 1.0], atol=1e-6)
    assert heights(terrain, [(0.5, 0.5)])[0] == NO_GROUND_M


FLOOR = sampled(lambda x, y: np.zeros_like(x), (4.0, 3.0), 0.1)


def test_rays_in_a_room_of_triangles_meet_its_walls():
    room = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [4.0, 3.0, 2.0]])
    rng = np.random.default_rng(14)
    start = rng.uniform([0.1, 0.1, 0.1], [3.9, 2.9, 1.9], (3000, 3))
    direction = unit(rng.normal(size=(3000, 3)))
    wall = np.where(direction > 0, [4.0, 3.0, 2.0], [0.0, 0.0, 0.0])
    expected = np.min((wall - start) / direction, axis=1)
    np.testing.assert_allclose(
        cast(terrain_of(world_of(FLOOR, room)), start, direction), expected, rtol=1e-5, atol=1e-5
    )


def test_meshes_with_overhangs_equal_trimesh():
    arch = trimesh.creation.torus(major_radius=0.5, minor_radius=0.15, major_sections=24, minor_sections=12)
    rng = np.random.default_rng(15)
    start = rng.uniform(-1.0, 1.0, (3000, 3)).astype(np.float32).astype(float)
    assert_same_ranges(terrain_of(world_of(FLOOR, arch)), arch, start, unit(rng.normal(size=(3000, 3))))


def test_every_world_of_a_pool_has_its_own_ground():
    room = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [4.0, 3.0, 2.0]])
    flats = [sampled(lambda x, y, z=z: np.full_like(x, z), (1.0 + z, 2.0 - z), 0.1, (-z, z)) for z in (0.2, 0.7)]
    terrain = terrain_of(world_of(flats[0]), world_of(FLOOR, room), world_of(flats[1]))
    start, down = np.array([[0.3, 1.0, 1.5]]), np.array([[0.0, 0.0, -1.0]])
    found = [cast(terrain, start, down, world=w)[0] for w in range(3)]
    np.testing.assert_allclose(found, [1.3, 1.5, 0.8], atol=1e-6)
    assert [heights(terrain, [(0.3, 1.0)], world=w)[0] for w in range(3)] == pytest.approx([0.2, 0.0, 0.7])


def wall(x, y):
    return np.where(np.abs(x - 0.5) < 0.051, 0.3, 0.0)


@pytest.mark.parametrize("as_mesh", [False, True])
def test_sight_lines_end_at_walls_from_both_sides(as_mesh):
    ground = sampled(wall, (1.0, 1.0), 0.05)
    terrain = terrain_of(world_of(ground, surface_mesh(ground) if as_mesh else None))
    here = np.array([[0.2, 0.5, 0.1], [0.2, 0.5, 0.4], [0.2, 0.5, 0.1], [0.2, 0.2, 0.1]])
    there = np.array([[0.8, 0.5, 0.1], [0.8, 0.5, 0.4], [0.3, 0.9, 0.1], [0.2, 0.8, 0.1]])
    for a, b in ((here, there), (there, here)):
        np.testing.assert_array_equal(hidden(terrain, a, b), [True, False, False, False])


@pytest.mark.parametrize("as_mesh", [False, True])
def test_the_slack_before_the_target_does_not_count(as_mesh):
    ground = sampled(wall, (1.0, 1.0), 0.05)
    terrain = terrain_of(world_of(ground, surface_mesh(ground) if as_mesh else None))
    eye, lamp = np.array([[0.2, 0.5, 0.5]]), np.array([[0.5, 0.5, 0.298]])
    assert hidden(terrain, eye, lamp)[0]
    assert not hidden(terrain, eye, lamp, slack_m=0.01)[0]
    assert not hidden(terrain, lamp, lamp, slack_m=0.01)[0]

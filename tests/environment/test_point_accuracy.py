"""Distances of measured points to the true surface, against trimesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from coop_envs.point_accuracy import FARTHEST_M, surface_distance_m
from coop_envs.worlds.world import HeightField, Mesh, World


def world(ground: HeightField, mesh: Mesh | None = None) -> World:
    return World("w", ground, mesh, (), ((0.0, 0.0, 0.0),), (0.0, 0.0, 0.0), None)


def bumpy(origin_m: tuple[float, float] = (0.0, 0.0)) -> HeightField:
    heights = np.random.default_rng(3).uniform(0.0, 0.1, (41, 31)).astype(np.float32)
    heights[20:, 10] = 0.6
    heights[:4, :4] = np.nan
    return HeightField(heights, origin_m, 0.05)


def test_distances_to_a_mesh_are_trimeshs():
    shape = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (300, 3))
    mesh = Mesh(shape.vertices.astype(np.float32), shape.faces.astype(np.int32))
    expected = trimesh.proximity.closest_point(shape, points)[1]
    np.testing.assert_allclose(surface_distance_m(world(bumpy(), mesh), points), expected, atol=1e-5)


@pytest.mark.parametrize("origin_m", [(0.0, 0.0), (300.0, -80.0)])
def test_distances_to_the_ground_are_trimeshs_also_far_from_the_origin_and_across_steps(origin_m):
    ground = bumpy(origin_m)
    points = np.random.default_rng(1).uniform((0.3, 0.3, -0.1), (1.9, 1.4, 0.7), (300, 3)) + (*origin_m, 0.0)
    x, y = (origin_m[k] + 0.05 * np.arange(n) for k, n in enumerate(ground.heights_m.shape))
    nodes = np.stack([*np.meshgrid(x, y, indexing="ij"), ground.heights_m], axis=-1)
    a, b, c, d = (part.reshape(-1, 3) for part in (nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, :-1], nodes[1:, 1:]))
    triangles = np.concatenate([np.stack([a, c, b], axis=1), np.stack([d, b, c], axis=1)])
    triangles = triangles[np.isfinite(triangles).all(axis=(1, 2))]
    surface = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    expected = trimesh.proximity.closest_point(surface, points)[1]
    np.testing.assert_allclose(surface_distance_m(world(ground), points), expected, atol=1e-4)


def test_what_is_far_away_counts_as_a_metre():
    points = np.array([[1.0, 1.0, 40.0], [60.0, 60.0, 0.0]])
    assert surface_distance_m(world(bumpy()), points).tolist() == [FARTHEST_M, FARTHEST_M]
    assert surface_distance_m(world(bumpy()), points[1:]).tolist() == [FARTHEST_M]
    assert surface_distance_m(world(bumpy()), np.empty((0, 3))).shape == (0,)

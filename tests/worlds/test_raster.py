from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.worlds import raster
from coop_envs.worlds.raster import lowest_ground
from coop_envs.worlds.world import Mesh
from tests.worlds.builders import box, joined, room


def mesh_of(parts):
    vertices, faces = parts
    return Mesh(np.asarray(vertices, np.float32), np.asarray(faces, np.int32))


def height_at(ground, x, y):
    i, j = (round((p - o) / ground.cell_m) for p, o in zip((x, y), ground.origin_m, strict=True))
    return float(ground.heights_m[i, j])


def test_a_table_is_gone_under_and_a_low_shelf_is_not():
    table = box((0.4, 0.4, 0.20), (0.8, 0.8, 0.25))
    shelf = box((1.2, 0.4, 0.10), (1.6, 0.8, 0.15))
    ground = lowest_ground(mesh_of(joined(room((2.0, 1.2)), table, shelf)), 0.025, headroom_m=0.15)
    assert height_at(ground, 0.6, 0.6) == pytest.approx(0.0)
    assert height_at(ground, 1.4, 0.6) == pytest.approx(0.15)
    assert height_at(ground, 1.0, 0.6) == pytest.approx(0.0)
    assert height_at(ground, -0.05, 0.6) == pytest.approx(0.5)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-1, 1), st.floats(0.1, 1.3))
def test_a_tilted_plane_keeps_its_heights(slope_x, slope_y, level, size):
    corners = np.array([[0, 0], [size, 0], [size, size], [0, size]])
    vertices = np.column_stack([corners, level + corners @ [slope_x, slope_y]])
    ground = lowest_ground(mesh_of((vertices, np.array([[0, 1, 2], [0, 2, 3]]))), 0.025, 0.15)
    i, j = np.nonzero(np.isfinite(ground.heights_m))
    x, y = ground.origin_m[0] + i * ground.cell_m, ground.origin_m[1] + j * ground.cell_m
    assert len(i) >= (int(size / 0.025)) ** 2
    assert ground.heights_m[i, j] == pytest.approx(level + slope_x * x + slope_y * y, abs=1e-5)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_a_triangulated_terrain_has_no_gaps_and_touches_its_vertices(seed):
    rng = np.random.default_rng(seed)
    n = 9
    x, y = np.meshgrid(np.arange(n) * 0.1, np.arange(n) * 0.1, indexing="ij")
    z = rng.uniform(0.0, 0.3, (n, n))
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = (index[corner].ravel() for corner in _corners())
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    vertices = np.stack([x.ravel(), y.ravel(), z.ravel()], 1)
    ground = lowest_ground(mesh_of((vertices, rng.permutation(faces))), 0.025, 0.15)
    assert ground.heights_m.shape == (33, 33)
    assert np.isfinite(ground.heights_m).all()
    assert ground.heights_m[::4, ::4] == pytest.approx(z, abs=1e-5)


def _corners():
    low, high = slice(None, -1), slice(1, None)
    return (low, low), (high, low), (low, high), (high, high)


def test_a_terrain_wound_upside_down_is_ground_all_the_same():
    vertices, faces = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    ground = lowest_ground(mesh_of((vertices, faces[:, ::-1])), 0.025, 0.15)
    assert np.isfinite(ground.heights_m).all()


def test_no_ground_where_the_mesh_has_none():
    ground = lowest_ground(mesh_of(joined(box((0, 0, 0), (1, 1, 0.1)), box((2, 0, 0), (3, 1, 0.1)))), 0.025, 0.15)
    assert np.isnan(height_at(ground, 1.5, 0.5))
    assert height_at(ground, 2.5, 0.5) == pytest.approx(0.1)


def test_vertical_faces_alone_make_no_ground():
    wall = np.array([[0, 0, 0], [1, 0, 0], [1, 0.0, 1]]), np.array([[0, 1, 2]])
    assert np.isnan(lowest_ground(mesh_of(wall), 0.025, 0.15).heights_m).all()


def test_chunks_do_not_change_the_result(monkeypatch):
    mesh = mesh_of(room((2.0, 1.2)))
    whole = lowest_ground(mesh, 0.025, 0.15).heights_m
    monkeypatch.setattr(raster, "CHUNK", 100)
    assert np.array_equal(whole, lowest_ground(mesh, 0.025, 0.15).heights_m, equal_nan=True)

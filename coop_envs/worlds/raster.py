"""From a triangle mesh to the ground that carries robots: the lowest surface facing up with headroom above it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from coop_envs.worlds.world import HeightField, Mesh

CHUNK = 2_000_000
FLAT = 1e-12
EDGE = 1e-6
SAME_M = 1e-4
ALONG_EDGE = 8

Mask = NDArray[np.bool_]
Crossings = tuple[NDArray[np.int64], NDArray[np.float64], Mask]


def lowest_ground(mesh: Mesh, cell_m: float, headroom_m: float) -> HeightField:
    """Height field on nodes at multiples of ``cell_m``; NaN where nothing faces up with headroom.

    Every node's vertical line is cut with every triangle over it. One stands on a surface that faces up if the next one
    above faces down and leaves ``headroom_m``, or there is none. If the next one faces up too, the space between is
    taken for solid: a wall sunk into the floor, or a sheet whose underside nobody has seen.
    """
    corners = np.asarray(mesh.vertices_m, dtype=np.float64)[mesh.faces]
    low = np.floor(corners.min(axis=(0, 1))[:2] / cell_m + EDGE)
    high = np.ceil(corners.max(axis=(0, 1))[:2] / cell_m - EDGE)
    nx, ny = (int(n) + 1 for n in high - low)
    node, height, faces_up, faces_down = levels(*crossings(corners, low * cell_m, cell_m, (nx, ny)))
    last = np.append(np.diff(node) != 0, True)
    free_above = np.append(np.diff(height) >= headroom_m, True) & np.append(faces_down[1:], True)
    standing = np.flatnonzero(faces_up & (last | free_above))
    nodes, first = np.unique(node[standing], return_index=True)
    heights = np.full(nx * ny, np.nan, dtype=np.float32)
    heights[nodes] = height[standing[first]]
    return HeightField(heights.reshape(nx, ny), (float(low[0]) * cell_m, float(low[1]) * cell_m), cell_m)


def single_valued(mesh: Mesh, ground: HeightField) -> bool:
    """Whether the mesh is no more than its ground: no surface over another, all edges on the height field."""
    corners = np.asarray(mesh.vertices_m, dtype=np.float64)[mesh.faces]
    node, _, _, _ = levels(*crossings(corners, np.array(ground.origin_m), ground.cell_m, ground.heights_m.shape))
    if np.any(np.diff(node) == 0):
        return False
    ends = np.roll(corners, -1, axis=1)
    along = (corners + share * (ends - corners) for share in np.arange(ALONG_EDGE) / ALONG_EDGE)
    return all(np.all(np.abs(heights_at(ground, p[..., 0], p[..., 1]) - p[..., 2]) < SAME_M) for p in along)


def heights_at(ground: HeightField, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights of the ground's triangles at points, NaN beyond the edge and where a corner is missing."""
    nx, ny = ground.heights_m.shape
    u, v = ((p - o) / ground.cell_m for p, o in zip((x_m, y_m), ground.origin_m, strict=True))
    outside = (u < -EDGE) | (v < -EDGE) | (u > nx - 1 + EDGE) | (v > ny - 1 + EDGE)
    i, j = (np.clip(np.floor(w), 0, n - 2).astype(np.int64) for w, n in ((u, nx), (v, ny)))
    u, v, h = u - i, v - j, ground.heights_m.astype(np.float64)
    a, b, c, d = h[i, j], h[i, j + 1], h[i + 1, j], h[i + 1, j + 1]
    low, high = a + (c - a) * u + (b - a) * v, d + (b - d) * (1 - u) + (c - d) * (1 - v)
    return np.where(outside, np.nan, np.where(u + v <= 1, low, high))


def crossings(
    corners: NDArray[np.float64], origin_m: NDArray[np.float64], cell_m: float, shape: tuple[int, int]
) -> Crossings:
    """(node, height, faces up) for each crossing of a node's vertical with a triangle (t, 3, 3)."""
    a, b, c = (corners[:, k, :2] - origin_m for k in range(3))
    area = _cross(b - a, c - a)
    if not np.any(area > FLAT):
        area, b, c, corners = -area, c, b, corners[:, [0, 2, 1]]
    level = np.abs(area) > FLAT
    a, b, c, area, z = a[level], b[level], c[level], area[level], corners[level][:, :, 2]
    flat = np.stack([a, b, c], axis=1) / cell_m
    first = np.maximum(np.ceil(flat.min(axis=1) - EDGE).astype(np.int64), 0)
    last = np.minimum(np.floor(flat.max(axis=1) + EDGE).astype(np.int64), np.array(shape) - 1)
    spans = np.maximum(last - first + 1, 0)
    parts: list[Crossings] = []
    for t, k in chunked_pairs(spans[:, 0] * spans[:, 1], CHUNK):
        i, j = first[t, 0] + k // spans[t, 1], first[t, 1] + k % spans[t, 1]
        p = np.stack([i, j], axis=-1) * cell_m
        w_a = _cross(c[t] - b[t], p - b[t]) / area[t]
        w_b = _cross(a[t] - c[t], p - c[t]) / area[t]
        w_c = 1.0 - w_a - w_b
        inside = np.minimum(np.minimum(w_a, w_b), w_c) >= -EDGE
        height = w_a * z[t, 0] + w_b * z[t, 1] + w_c * z[t, 2]
        parts.append(((i * shape[1] + j)[inside], height[inside], (area[t] > 0)[inside]))
    if not parts:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0, bool)
    nodes, heights, ups = zip(*parts, strict=True)
    return np.concatenate(nodes), np.concatenate(heights), np.concatenate(ups)


def chunked_pairs(counts: NDArray[np.int64], chunk_pairs: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """(triangle, running number) for ``counts[triangle]`` places each, in chunks of about ``chunk_pairs``."""
    ends = np.cumsum(counts)
    begin = 0
    while begin < len(counts):
        done = ends[begin - 1] if begin else 0
        end = max(int(np.searchsorted(ends, done + chunk_pairs, side="right")), begin + 1)
        chunk = counts[begin:end]
        triangles = np.repeat(np.arange(begin, end), chunk)
        yield triangles, np.arange(len(triangles)) - np.repeat(np.cumsum(chunk) - chunk, chunk)
        begin = end


def levels(node: NDArray[np.int64], height: NDArray[np.float64], up: Mask) -> tuple[NDArray, NDArray, Mask, Mask]:
    """(node, height, any faces up, any faces down) of the surfaces, sorted; those ``SAME_M`` apart are one."""
    order = np.lexsort((height, node))
    node, height, up = node[order], height[order], up[order]
    starts = np.flatnonzero(np.append(True, (np.diff(node) != 0) | (np.diff(height) > SAME_M))[: len(node)])
    if not len(starts):
        return node, height, up, up
    return node[starts], height[starts], np.logical_or.reduceat(up, starts), np.logical_or.reduceat(~up, starts)


def _cross(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

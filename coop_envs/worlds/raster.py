"""From a triangle mesh to the ground that carries robots: the lowest surface facing up with headroom above it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coop_envs.worlds.columns import chunked_pairs, column_ranges, cross, inset
from coop_envs.worlds.world import HeightField, Mesh

CHUNK = 2_000_000
FLAT = 1e-12
EDGE = 1e-6
SAME_M = 1e-4
ALONG_EDGE = 8
KERB_M = 0.03
NARROW = 0.5

Mask = NDArray[np.bool_]
Crossings = tuple[NDArray[np.int64], NDArray[np.float64], Mask]


def lowest_ground(mesh: Mesh, cell_m: float, headroom_m: float) -> HeightField:
    """Height field on nodes at multiples of ``cell_m``; NaN where nothing faces up with headroom.

    Every node's vertical line is cut with every triangle over it. One stands on a surface that faces up if the space
    above is free and ``headroom_m`` high or unbounded. A node nearest to a wall, which may stand between two verticals,
    is as high as the wall.
    """
    corners = np.asarray(mesh.vertices_m, dtype=np.float64)[mesh.faces]
    low = np.floor(corners.min(axis=(0, 1))[:2] / cell_m + EDGE)
    high = np.ceil(corners.max(axis=(0, 1))[:2] / cell_m - EDGE)
    nx, ny = (int(n) + 1 for n in high - low)
    node, height, faces_up, faces_down = levels(*crossings(corners, low * cell_m, cell_m, (nx, ny)))
    roomy = np.append((np.diff(node) != 0) | (np.diff(height) >= headroom_m), True)
    standing = np.flatnonzero(faces_up & roomy & free_above(node, faces_up, faces_down))
    nodes, first = np.unique(node[standing], return_index=True)
    heights = np.full(nx * ny, np.nan, dtype=np.float32)
    heights[nodes] = height[standing[first]]
    heights = _with_walls(heights.reshape(nx, ny), corners, low * cell_m, cell_m, headroom_m)
    return HeightField(heights, (float(low[0]) * cell_m, float(low[1]) * cell_m), cell_m)


def _with_walls(
    heights: NDArray[np.float32],
    corners: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    cell_m: float,
    headroom_m: float,
) -> NDArray[np.float32]:
    """Heights (nx, ny) raised to the tops of triangles too narrow, seen from above, for the nodes to tell.

    Such a triangle is a wall to the nodes in whose squares it stands in a robot's way: higher than ``KERB_M`` over the
    ground, lower than the headroom.
    """
    flat = corners[..., :2]
    sides = np.linalg.norm(np.roll(flat, -1, axis=1) - flat, axis=2).max(axis=1)
    area = np.abs(cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]))
    narrow = inset(corners[area <= NARROW * cell_m * sides])
    narrow[..., :2] = (narrow[..., :2] - origin_m) / cell_m + 0.5
    raised = heights.copy()
    for node, low, high in column_ranges(narrow, heights.shape):
        i, j = node.T
        barred = (high > heights[i, j] + KERB_M) & (low < heights[i, j] + headroom_m)
        np.maximum.at(raised, (i[barred], j[barred]), high[barred].astype(np.float32))
    return raised


def free_above(node: NDArray[np.int64], up: Mask, down: Mask) -> Mask:
    """Whether the space between each of the `levels` and the next above it, or all above it, is free.

    Where the surfaces over a node close bodies that stand on one another or on open ground, those bodies are solid.
    Elsewhere, as in scans, space is free if its floor faces up and its ceiling down: between two surfaces that both
    face up it is taken for solid, a wall sunk into the floor, or a sheet whose underside nobody has seen.
    """
    last = np.append(np.diff(node) != 0, True)[: len(node)]
    entered = (up & ~down).astype(np.int64) - (down & ~up)
    column = np.cumsum(last) - last
    total = np.bincount(column, entered, minlength=0).astype(np.int64)
    upwards = np.cumsum(entered)
    before = np.append(0, upwards[last])[:-1]
    depth_above = total[column] - (upwards - before[column])
    closed = (total >= 0) & (total <= 1)
    closed[column[depth_above < 0]] = False
    local = up & (last | np.append(down[1:], True)[: len(node)])
    return np.where(closed[column], depth_above == 0, local)


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
    area = cross(b - a, c - a)
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
        w_a = cross(c[t] - b[t], p - b[t]) / area[t]
        w_b = cross(a[t] - c[t], p - c[t]) / area[t]
        w_c = 1.0 - w_a - w_b
        inside = np.minimum(np.minimum(w_a, w_b), w_c) >= -EDGE
        height = w_a * z[t, 0] + w_b * z[t, 1] + w_c * z[t, 2]
        parts.append(((i * shape[1] + j)[inside], height[inside], (area[t] > 0)[inside]))
    if not parts:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0, bool)
    nodes, heights, ups = zip(*parts, strict=True)
    return np.concatenate(nodes), np.concatenate(heights), np.concatenate(ups)


def levels(node: NDArray[np.int64], height: NDArray[np.float64], up: Mask) -> tuple[NDArray, NDArray, Mask, Mask]:
    """(node, height, any faces up, any faces down) of the surfaces, sorted; those ``SAME_M`` apart are one."""
    order = np.lexsort((height, node))
    node, height, up = node[order], height[order], up[order]
    starts = np.flatnonzero(np.append(True, (np.diff(node) != 0) | (np.diff(height) > SAME_M))[: len(node)])
    if not len(starts):
        return node, height, up, up
    return node[starts], height[starts], np.logical_or.reduceat(up, starts), np.logical_or.reduceat(~up, starts)

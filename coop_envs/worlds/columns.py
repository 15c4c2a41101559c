"""Which columns over a grid of squares triangles pass through, and between which heights."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from coop_envs.worlds.truth import Mask

INSET_M = 1e-4
CHUNK = 500_000
FLAT = 1e-9


def column_ranges(
    corners: NDArray[np.float64], shape: tuple[int, int]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]]:
    """(i, j) (p, 2) of unit squares of a grid, and the least and greatest z of a triangle (t, 3, 3) over each.

    Chunk by chunk, one entry for each square and each triangle that passes over it.
    """
    first = np.floor(corners[..., :2].min(axis=1)).astype(np.int64).clip(0)
    last = np.floor(corners[..., :2].max(axis=1)).astype(np.int64).clip(max=np.array(shape) - 1)
    spans = np.maximum(last - first + 1, 0)
    for t, k in chunked_pairs(spans[:, 0] * spans[:, 1], CHUNK):
        column = first[t] + np.stack([k // spans[t, 1], k % spans[t, 1]], axis=-1)
        local = corners[t]
        local[..., :2] -= column[:, None]
        low, high = _height_range(local, (spans[t] == 1).all(axis=1))
        met = low <= high
        yield column[met], low[met], high[met]


def inset(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Triangles drawn in by ``INSET_M`` from their edges and pushed back by it from the side they face."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    inwards = corners.mean(axis=1, keepdims=True) - corners
    share = np.minimum(INSET_M / np.maximum(np.linalg.norm(inwards, axis=2, keepdims=True), 1e-30), 1.0)
    return corners + inwards * share - INSET_M * normal[:, None]


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


def _height_range(corners: NDArray[np.float64], whole: Mask) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest z of each triangle (p, 3, 3) over the unit square; least above greatest where it misses it.

    The part over the square is a polygon whose corners lie on the triangle's edges or over the square's corners.
    ``whole`` says which triangles lie over the square altogether.
    """
    low, high = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
    cut = np.flatnonzero(~whole)
    if cut.size:
        heights = np.concatenate([_edge_heights(corners[cut]), _corner_heights(corners[cut])], axis=1)
        low[cut], high[cut] = np.fmin.reduce(heights, axis=1), np.fmax.reduce(heights, axis=1)
    return low, high


def _edge_heights(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """z (p, 6) where the edges enter and leave the unit square, NaN where they miss it."""
    step = np.roll(corners, -1, axis=1) - corners
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.stack([-corners[..., :2] / step[..., :2], (1.0 - corners[..., :2]) / step[..., :2]])
    enter, leave = at.min(axis=0), at.max(axis=0)
    still = step[..., :2] == 0
    between = (corners[..., :2] >= 0) & (corners[..., :2] <= 1)
    enter = np.where(still, np.where(between, 0.0, 2.0), enter).max(axis=-1).clip(0.0)
    leave = np.where(still, 1.0, leave).min(axis=-1).clip(max=1.0)
    ends = corners[..., 2, None] + step[..., 2, None] * np.stack([enter, leave], axis=-1)
    return np.where((enter <= leave)[..., None], ends, np.nan).reshape(len(corners), 6)


def _corner_heights(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """z (p, 4) of the triangles over the unit square's corners, NaN where they are not over them."""
    square = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    a, b, c = (corners[:, k, None, :2] for k in range(3))
    area = cross(b - a, c - a)
    weights = [cross(q - p, square - p) for p, q in ((b, c), (c, a), (a, b))]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.stack(weights, axis=-1) / area[..., None]
        heights = np.sum(shares * corners[:, None, :, 2], axis=-1)
        return np.where((shares.min(axis=-1) >= 0) & (np.abs(area) > FLAT), heights, np.nan)


def cross(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """The z component of the cross products of plane vectors (..., 2)."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

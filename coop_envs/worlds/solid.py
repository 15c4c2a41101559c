"""What of the space over each cell of a grid is solid: the truth against which a team's volume map is judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.worlds.bodies import ground_mesh
from coop_envs.worlds.columns import column_ranges, inset
from coop_envs.worlds.raster import crossings, free_above, levels
from coop_envs.worlds.truth import grid_over, passable_ground
from coop_envs.worlds.world import HeightField, World

SLABS = 64
BELOW_SLABS = 3.5
MAX_STEP_M = 0.03


@dataclass(frozen=True)
class SolidColumns:
    """Bit k of ``bits[i, j]`` tells whether slab k of the column over cell (i, j) holds anything solid.

    The cell's lower corner stands at ``origin_m + cell_m * (i, j)`` in the world; the slab spans heights
    ``base_m + slab_m * k`` to ``+ slab_m``. 64 slabs stand on ``base_m``; nothing is told of what is lower or higher.
    """

    origin_m: tuple[float, float]
    cell_m: float
    base_m: float
    slab_m: float
    bits: NDArray[np.uint64]

    def holds(self, middles_m: NDArray[np.float64], size_m: float) -> NDArray[np.bool_]:
        """Whether cells (n,) of this size with these middles (n, 3) hold anything solid.

        A cell is told by the slabs whose middle lies in it, in the column of its own middle; beyond and under the
        columns all is solid, over them nothing is.
        """
        i, j = np.floor((middles_m[:, :2] - self.origin_m) / self.cell_m).astype(np.int64).T
        inside = (i >= 0) & (j >= 0) & (i < self.bits.shape[0]) & (j < self.bits.shape[1])
        low = (middles_m[:, 2] - size_m / 2 - self.base_m) / self.slab_m
        first = np.ceil(low - 0.5).clip(0, SLABS).astype(np.int64)
        after = np.ceil(low + size_m / self.slab_m - 0.5).clip(0, SLABS).astype(np.int64)
        column = np.where(inside, self.bits[i * inside, j * inside], ~np.uint64(0))
        return ((column & (_lowest_bits(after) & ~_lowest_bits(first))) != 0) | (low < -0.5)

    @property
    def top_m(self) -> float:
        """Height up to which truth is known."""
        return self.base_m + SLABS * self.slab_m


def solid_columns(world: World, cell_m: float, slab_m: float = 0.025) -> SolidColumns:
    """Solid slabs of a world on the grid of `truth_grid`.

    A slab is solid if any surface that rays meet passes through it anywhere in the cell's square, if over the cell's
    centre it lies inside a body of the mesh, or if it lies below all of the ground; where there is no ground all slabs
    are. A surface between two columns or slabs, within 0.1 mm, counts to the one behind it. The lowest ground that the
    first robot can drive to lies in the middle of the fourth slab, so that levels a whole number of slabs above it are
    never on a border.
    """
    ground = world.ground
    origin, shape = grid_over(ground, cell_m)
    base = lowest_reach_m(world) - BELOW_SLABS * slab_m
    surface = world.mesh or ground_mesh(ground)
    corners = surface.vertices_m[surface.faces]
    corners = (np.asarray(corners, dtype=np.float64) - (*origin, base)) / (1.0, 1.0, slab_m)
    bits = _surface_bits(corners, cell_m, slab_m, shape)
    if world.mesh is not None:
        bits |= _inside_bits(corners, cell_m, shape)
    level = _lowest_m(ground, origin, cell_m, shape)
    below = np.clip(np.floor((level - base) / slab_m), 0, SLABS)
    below = np.where(np.isnan(level), SLABS, below).astype(np.int64)
    return SolidColumns(origin, cell_m, float(base), slab_m, bits | _lowest_bits(below))


def lowest_reach_m(world: World) -> float:
    """Height of the lowest ground that steps of a few centimetres join with the first start; 0 where there is none."""
    heights = world.ground.heights_m
    if world.starts:
        reached = passable_ground(world.ground, world.starts[0][:2], MAX_STEP_M)
        heights = heights[reached] if reached.any() else heights
    finite = heights[np.isfinite(heights)]
    return float(finite.min()) if finite.size else 0.0


def _surface_bits(
    corners: NDArray[np.float64], cell_m: float, slab_m: float, shape: tuple[int, int]
) -> NDArray[np.uint64]:
    """Slabs (nx, ny) that triangles (t, 3, 3) pass through; x and y in metres from the corner, z in slabs."""
    corners = inset(corners * (1.0, 1.0, slab_m)) / (cell_m, cell_m, slab_m)
    corners = corners[(corners[..., 2].min(axis=1) < SLABS) & (corners[..., 2].max(axis=1) >= 0)]
    bits = np.zeros(shape[0] * shape[1], dtype=np.uint64)
    for column, low, high in column_ranges(corners, shape):
        first, last = (np.floor(z).astype(np.int64) for z in (low, high))
        _set_bits(bits, column[:, 0] * shape[1] + column[:, 1], first, last + 1)
    return bits.reshape(shape)


def _inside_bits(corners: NDArray[np.float64], cell_m: float, shape: tuple[int, int]) -> NDArray[np.uint64]:
    """Slabs (nx, ny) over whose cell's centre lies the inside of a body, as `free_above` takes it."""
    centre = np.array([cell_m / 2, cell_m / 2])
    place, height, up, down = levels(*crossings(corners, centre, cell_m, shape))
    inside = np.flatnonzero((np.diff(place) == 0) & ~free_above(place, up, down)[:-1])
    bits = np.zeros(shape[0] * shape[1], dtype=np.uint64)
    low, high = (np.floor(height[at]).astype(np.int64) for at in (inside, inside + 1))
    _set_bits(bits, place[inside], low, high)
    return bits.reshape(shape)


def _set_bits(
    bits: NDArray[np.uint64], place: NDArray[np.int64], first: NDArray[np.int64], end: NDArray[np.int64]
) -> None:
    """Set bits ``first`` up to ``end`` of the words at these places, which may repeat."""
    if not place.size:
        return
    slabs = _lowest_bits(end.clip(0, SLABS)) & ~_lowest_bits(first.clip(0, SLABS))
    order = np.argsort(place, kind="stable")
    place, starts = np.unique(place[order], return_index=True)
    bits[place] |= np.bitwise_or.reduceat(slabs[order], starts)


def _lowest_bits(count: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Words whose lowest ``count`` (0 to 64) bits are set."""
    ones = np.uint64(0xFFFFFFFFFFFFFFFF)
    some = ones >> np.clip(SLABS - count, 0, SLABS - 1).astype(np.uint64)
    return np.where(count > 0, some, np.uint64(0))


def _lowest_m(
    ground: HeightField, origin_m: tuple[float, float], cell_m: float, shape: tuple[int, int]
) -> NDArray[np.float64]:
    """The lowest node (nx, ny) within each cell or on its border, else the nearest; NaN where there is no ground."""
    heights = ground.heights_m.astype(np.float64)
    for axis in (0, 1):
        nodes = heights.shape[axis]
        edge = (origin_m[axis] + cell_m * np.arange(shape[axis] + 1) - ground.origin_m[axis]) / ground.cell_m
        first, last = np.ceil(edge[:-1] - 1e-4), np.floor(edge[1:] + 1e-4)
        nearest = np.round((edge[:-1] + edge[1:]) / 2)
        first, last = np.where(first > last, nearest, first), np.where(first > last, nearest, last)
        ranges = np.stack([first.clip(0, nodes - 1), last.clip(0, nodes - 1) + 1], axis=-1).astype(np.intp).ravel()
        padded = np.concatenate([heights, np.full_like(heights.take([0], axis=axis), np.nan)], axis=axis)
        heights = np.fmin.reduceat(padded, ranges, axis=axis).take(range(0, len(ranges), 2), axis=axis)
    return heights

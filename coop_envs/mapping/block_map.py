"""A sparse volume map for evaluation: blocks of 16^3 cells, made where rays go, of any extent in all directions.

It takes the rays that a team's own map takes, and tells the same of their cells, in any axes and at all heights. It
also counts the cells whose middle lies in any ray's cylinder: h_v of thesis section 6.2.3 to the precision of its cells
(see `swept_volume` for the exact union, which costs seconds a hundred rays).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from coop_envs.mapping.ground_map import LIMIT
from coop_envs.mapping.sweep import HIT, Sweep, begin_sweep, in_cylinder, span_in_slice, swept_evidence

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

SIDE = 16
CELLS = SIDE**3
BLOCK = wp.constant(SIDE)
WANTED = wp.constant(-2)
GROWTH = 64


@wp.struct
class Table:
    """Which block covers block (i, j, k) from ``low``: ``slot``, -1 for none, -2 for wanted.

    ``cells`` (n, 16^3) log-odds, ``swept`` (n, 16^3) 1 for those in a ray's cylinder.
    """

    slot: wp.array3d[int]
    low: wp.vec3i
    cells: wp.array2d[wp.int8]
    swept: wp.array2d[wp.int8]


@wp.func
def touch(table: Table, cell: wp.vec3i, evidence: int, swept: int):
    """Add evidence to a cell, and whether a ray swept it; where it has no block yet, ask for one."""
    place = cell - table.low * BLOCK  # not negative, so that division rounds down
    b = wp.vec3i()
    inside = int(0)
    for axis in range(3):
        b[axis] = place[axis] // BLOCK
        inside = inside * BLOCK + place[axis] % BLOCK
    slot = table.slot[b[0], b[1], b[2]]
    if slot < 0:
        table.slot[b[0], b[1], b[2]] = WANTED
    else:
        new = wp.clamp(int(table.cells[slot, inside]) + evidence, -LIMIT, LIMIT)
        table.cells[slot, inside] = wp.int8(new)
        table.swept[slot, inside] = wp.max(table.swept[slot, inside], wp.int8(swept))


@wp.func
def touch_ray(table: Table, sweep: Sweep, share: int):
    """Touch every cell that a ray tells of."""
    u = (sweep.main + 1) % 3
    v = (sweep.main + 2) % 3
    cell = wp.vec3i()
    for s in range(sweep.first, sweep.last + 1):
        along_u = span_in_slice(sweep, s, u)
        along_v = span_in_slice(sweep, s, v)
        cell[sweep.main] = s
        for i in range(along_u[0], along_u[1] + 1):
            cell[u] = i
            for j in range(along_v[0], along_v[1] + 1):
                cell[v] = j
                if in_cylinder(sweep, cell):
                    touch(table, cell, swept_evidence(sweep, cell) * share, share)


@wp.kernel
def enter_rays(
    table: Table, starts: wp.array[wp.vec3], ends: wp.array[wp.vec3], tips: wp.array[wp.vec3], radius: float, share: int
):
    """Enter all rays and the points at their tips (in cells) with ``share`` 1; with 0, ask for the blocks they need."""
    low = table.low * BLOCK
    size = wp.vec3i(table.slot.shape[0], table.slot.shape[1], table.slot.shape[2])
    high = low + size * BLOCK - wp.vec3i(1, 1, 1)
    for k in range(starts.shape[0]):
        touch_ray(table, begin_sweep(starts[k], ends[k], radius, low, high), share)
    for k in range(tips.shape[0]):
        tip = tips[k]
        cell = wp.vec3i(int(wp.floor(tip[0])), int(wp.floor(tip[1])), int(wp.floor(tip[2])))
        touch(table, cell, HIT * share, 0)


@dataclass(frozen=True)
class Cells:
    """Known cells: the indices (n, 3) of cells whose lower corner is at ``cell_m * index``; log-odds (n,) / 16."""

    index: NDArray[np.int64]
    log_odds: NDArray[np.int8]
    cell_m: float

    @property
    def middles_m(self) -> NDArray[np.float64]:
        """Middle of every cell (n, 3)."""
        return np.asarray((self.index + 0.5) * self.cell_m, dtype=np.float64)


class BlockMap:
    """Log-odds of "something is here", in sixteenths, on a grid of ``cell_m`` through the world's origin.

    Args:
        cell_m: size of a cell, m.
        sweep_radius_m: rays sweep free what is within it, m.
        device: where rays are entered.
    """

    def __init__(self, cell_m: float = 0.05, sweep_radius_m: float = 0.05, device: str = "cpu") -> None:
        self.cell_m, self._radius, self._device = cell_m, sweep_radius_m / cell_m, device
        self._low = np.zeros(3, dtype=np.int64)
        self._slot = np.full((0, 0, 0), -1, dtype=np.int32)
        self._cells = np.zeros((GROWTH, CELLS), dtype=np.int8)
        self._swept = np.zeros((GROWTH, CELLS), dtype=np.int8)
        self._used = 0

    @property
    def blocks(self) -> int:
        """How many blocks there are, 4 KiB each."""
        return self._used

    @property
    def h_v(self) -> float:
        """Volume of the union of all rays' cylinders, in units of their diameter's cube."""
        return float(np.count_nonzero(self._swept)) / (2.0 * self._radius) ** 3

    def enter(self, starts_m: ArrayLike, ends_m: ArrayLike) -> None:
        """Enter rays from eyes (k, 3) to the points (k, 3) that they measured, m; a point in a row counts once.

        Raises:
            ValueError: the arrays are no points, or hold numbers that are not finite.
        """
        rays = [np.asarray(a, dtype=np.float64).reshape(-1, 3) / self.cell_m for a in (starts_m, ends_m)]
        if rays[0].shape != rays[1].shape or not all(np.isfinite(a).all() for a in rays):
            raise ValueError(f"rays: got shapes {rays[0].shape} and {rays[1].shape}, expected two alike, all finite")
        if not len(rays[0]):
            return
        self._cover(np.concatenate(rays))
        new = np.ones(len(rays[1]), dtype=bool)
        new[1:] = (np.diff(rays[1], axis=0) != 0).any(axis=1)
        inputs = [*rays, rays[1][new]]
        arrays = [wp.array(a.astype(np.float32), dtype=wp.vec3, device=self._device) for a in inputs]
        self._launch(arrays, 0)
        wanted = self._slot == WANTED
        count = int(wanted.sum())
        self._slot[wanted] = self._used + np.arange(count)
        self._used += count
        if self._used > len(self._cells):
            more = max(GROWTH, self._used - len(self._cells), len(self._cells) // 2)
            empty = np.zeros((more, CELLS), dtype=np.int8)
            self._cells, self._swept = (np.concatenate([old, empty]) for old in (self._cells, self._swept))
        self._launch(arrays, 1)

    def known(self) -> Cells:
        """Every cell of which something is known."""
        where = np.argwhere(self._slot >= 0)
        slots = self._slot[tuple(where.T)]
        block, inside = np.nonzero(self._cells[slots])
        place = np.stack(np.unravel_index(inside, (SIDE,) * 3), axis=-1)
        return Cells((where[block] + self._low) * SIDE + place, self._cells[slots[block], inside], self.cell_m)

    def _cover(self, points: NDArray[np.float64]) -> None:
        """Let the table reach all blocks that rays between these points (in cells) may touch."""
        margin = self._radius + 2.0
        low = np.floor((points.min(axis=0) - margin) / SIDE).astype(np.int64)
        high = np.floor((points.max(axis=0) + margin) / SIDE).astype(np.int64) + 1
        if self._slot.size:
            low, high = np.minimum(low, self._low), np.maximum(high, self._low + self._slot.shape)
        if tuple(high - low) == self._slot.shape:
            return
        grown = np.full(high - low, -1, dtype=np.int32)
        at = self._low - low
        if self._slot.size:
            grown[tuple(slice(a, a + n) for a, n in zip(at, self._slot.shape, strict=True))] = self._slot
        self._low, self._slot = low, grown

    def _launch(self, rays: list[wp.array], share: int) -> None:
        table = Table()
        table.slot = wp.array(self._slot, dtype=int, device=self._device)
        table.cells = wp.array(self._cells, dtype=wp.int8, device=self._device)
        table.swept = wp.array(self._swept, dtype=wp.int8, device=self._device)
        table.low = wp.vec3i(*self._low.tolist())
        wp.launch(enter_rays, 1, inputs=[table, *rays, self._radius, share], device=self._device)
        self._slot, self._cells, self._swept = table.slot.numpy(), table.cells.numpy(), table.swept.numpy()

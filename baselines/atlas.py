"""The atlas: every agent's map windows, stitched over time into one grid in the team frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_envs.mapping.planning import UNKNOWN, BeliefGrid

FREE = 64
SPARE_CELLS = 16
SAME_LOSS_M = 0.08
BUMP_OF_LOST_M = 0.15
SHADOW_M = (0.3, 0.15)  # length and half width of what lies behind a bump

Point = tuple[float, float]


@dataclass(frozen=True)
class Survey:
    """What the team knows of the ground.

    ``grid`` is its belief, bumps taken for obstacles; ``doubt`` (nx, ny) counts failures to get to each cell, ``shown``
    is not 0 where some window has shown the cell; ``losses`` are the places of lost robots.
    """

    grid: BeliefGrid
    doubt: NDArray[np.uint8]
    shown: NDArray[np.uint8]
    losses: tuple[Point, ...]

    def around(self, points: ArrayLike, margin_m: float) -> Survey:
        """The part around some points (k, 2)."""
        part = self.grid.part_around(points, margin_m)
        return Survey(self.grid.part(part), self.doubt[part], self.shown[part], self.losses)


class Atlas:
    """A growing grid of P(ground) and P(obstacle) in 255ths, as the agents' windows showed it last.

    A window's corner is a multiple of the cell, so stitching copies cells and loses nothing. The atlas also remembers
    how often pickets failed to get to a cell, where something stopped them, and where robots were lost.
    """

    def __init__(self, cell_m: float) -> None:
        self.cell_m = cell_m
        self._corner = np.zeros(2, dtype=np.intp)
        self._layers = _unknown(0, 0)
        self._losses: list[Point] = []
        self._bumped = False

    @property
    def survey(self) -> Survey:
        """All of it, partly as views: they change with the next window."""
        x, y = (self._corner * self.cell_m).tolist()
        ground, obstacle, doubt, bumps, shown = self._layers
        grid = BeliefGrid(ground, np.maximum(obstacle, bumps), (x, y), self.cell_m)
        return Survey(grid, doubt, shown, self.losses)

    @property
    def losses(self) -> tuple[Point, ...]:
        return tuple(self._losses)

    @property
    def grid(self) -> BeliefGrid:
        return self.survey.grid

    def add(self, corner_m: Point, window: NDArray[np.uint8]) -> None:
        """Take over a window (2 or more, n, m): channels ground and obstacle, lower corner (x, y) in metres."""
        i, j = round(corner_m[0] / self.cell_m), round(corner_m[1] / self.cell_m)
        n, m = window.shape[1:]
        i, j = self._room_for(i, j, n, m)
        part = self._layers[:, i : i + n, j : j + m]
        part[:2] = window[:2]
        part[4] = 1
        if self._bumped:
            part[3][window[1] <= FREE] = 0

    def failed(self, xy_m: Point) -> None:
        """Note that a picket failed to get to a point (x, y)."""
        i, j = self._cell_of(xy_m)
        self._layers[2, i, j] = min(self._layers[2, i, j] + 1, 8)

    def bump(self, from_m: Point, xy_m: Point) -> None:
        """Note that something at a point (x, y) stopped a picket coming from another; what lies behind is doubtful.

        Not noted where a body has passed, and forgotten when one does.
        """
        i, j = self._cell_of(xy_m)
        if self._layers[1, i, j] <= FREE:
            return
        self._bumped = True
        self._layers[3, i, j] = 255
        offset = self.grid.centres_all() - xy_m
        towards = np.subtract(xy_m, from_m) / math.dist(xy_m, from_m)
        behind = offset @ towards
        beside = np.abs(offset @ (-towards[1], towards[0]))
        shadow = (behind > 0.0) & (behind < SHADOW_M[0]) & (beside < SHADOW_M[1])
        self._layers[2][shadow] = np.minimum(self._layers[2][shadow] + 1, 8)

    def lost(self, xy_m: Point) -> None:
        """Note where a lost robot is believed to be, again and again if need be; what stopped it was the hazard."""
        for k, (x, y) in enumerate(self._losses):
            if math.hypot(x - xy_m[0], y - xy_m[1]) < SAME_LOSS_M:
                self._losses[k] = xy_m
                return
        self._losses.append(xy_m)
        self._layers[3][self.grid.within((*xy_m, BUMP_OF_LOST_M))] = 0

    def survey_around(self, points_m: ArrayLike, margin_m: float) -> Survey:
        """What is known around points (k, 2), all of which lie within; views, as in `survey`."""
        points = np.asarray(points_m)
        cells = np.floor(points / self.cell_m).astype(int)
        (i, j), (n, m) = cells.min(axis=0).tolist(), (np.ptp(cells, axis=0) + 1).tolist()
        self._room_for(i, j, n, m)
        return self.survey.around(points, margin_m)

    def at(self, points_m: NDArray[np.float64]) -> NDArray[np.uint8]:
        """P(ground), P(obstacle), failures and bumps (4, k) at points (k, 2); unknown beyond the grid."""
        cells = np.floor(points_m / self.cell_m).astype(int) - self._corner
        inside = np.all((cells >= 0) & (cells < self._layers.shape[1:]), axis=1)
        values = _unknown(len(cells), 1)[:, :, 0]
        values[:, inside] = self._layers[:, cells[inside, 0], cells[inside, 1]]
        return values[:4]

    def _cell_of(self, xy_m: Point) -> tuple[int, int]:
        return self._room_for(math.floor(xy_m[0] / self.cell_m), math.floor(xy_m[1] / self.cell_m), 1, 1)

    def _room_for(self, i: int, j: int, n: int, m: int) -> tuple[int, int]:
        """Grow, if need be, until cells (i, j) .. (i + n, j + m) fit; return (i, j) as indices of the layers."""
        _, nx, ny = self._layers.shape
        i0, j0 = i - int(self._corner[0]), j - int(self._corner[1])
        if i0 < 0 or j0 < 0 or i0 + n > nx or j0 + m > ny:
            self._grow(np.array([i, j]), np.array([i + n, j + m]))
            i0, j0 = i - int(self._corner[0]), j - int(self._corner[1])
        return i0, j0

    def _grow(self, low: NDArray[np.intp], high: NDArray[np.intp]) -> None:
        size = np.array(self._layers.shape[1:])
        if size.any():
            low, high = np.minimum(low, self._corner), np.maximum(high, self._corner + size)
        low, high = low - SPARE_CELLS, high + SPARE_CELLS
        layers = _unknown(*(high - low))
        i, j = self._corner - low
        layers[:, i : i + size[0], j : j + size[1]] = self._layers
        self._corner, self._layers = low, layers


def _unknown(nx: int, ny: int) -> NDArray[np.uint8]:
    """Layers (5, nx, ny) of ground and obstacle never shown, and of no failures and bumps."""
    layers = np.full((5, nx, ny), UNKNOWN, dtype=np.uint8)
    layers[2:] = 0
    return layers

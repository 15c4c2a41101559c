"""Safe paths over a believed grid: over proven ground only, clear of obstacles and of other robots.

The search itself is scikit-image's minimum-cost path; this module says what a cell costs and which cells may be used.

Source: thesis 2.2.5 (a grid of safely navigable points, points near a stuck robot removed, shortest path).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

PROVEN = 230  # P(ground carries robots) in 255ths from which a cell counts as proven
HAZARD = 100  # ... below which it counts as a hazard
BLOCKED = 166  # P(obstacle) in 255ths from which a cell counts as an obstacle

Mask = NDArray[np.bool_]
Points = NDArray[np.float64]
Disc = tuple[float, float, float]
Cell = tuple[int, int]

COMFORT_M = 0.10  # a robot with this much clearance pays nothing for being near an edge
SHYNESS = 3.0  # what a metre along the very edge of the proven ground costs above one in the open, in metres
ENTRY_CELLS = 2.2  # how far from the robot its first safe cell may lie


@dataclass(frozen=True)
class BeliefGrid:
    """P(ground carries robots) and P(obstacle) in 255ths, uint8 (nx, ny); 128 is unknown.

    Cell [i, j] covers the square with lower corner ``origin_m + cell_m * (i, j)`` in the team frame.
    """

    ground: NDArray[np.uint8]
    obstacle: NDArray[np.uint8]
    origin_m: tuple[float, float]
    cell_m: float

    def cell_of(self, xy_m: ArrayLike) -> NDArray[np.intp]:
        """Cell indices (..., 2) of points (..., 2); outside the grid they leave its range."""
        return np.floor((np.asarray(xy_m) - self.origin_m) / self.cell_m).astype(np.intp)

    def centre_of(self, cells: ArrayLike) -> Points:
        """Centres (..., 2) in metres of cell indices (..., 2)."""
        return np.asarray(self.origin_m) + (np.asarray(cells) + 0.5) * self.cell_m

    def centres(self, mask: Mask) -> Points:
        """Centres (k, 2) of the cells where the mask holds."""
        return self.centre_of(np.argwhere(mask))

    def centres_all(self) -> Points:
        """Centres (nx, ny, 2) of all cells."""
        return self.centre_of(np.stack(np.indices(self.ground.shape), axis=-1))

    def within(self, disc: Disc) -> Mask:
        """Cells whose centre lies within the disc (x, y, radius)."""
        x, y, radius = disc
        dx = self.origin_m[0] + (np.arange(self.ground.shape[0]) + 0.5) * self.cell_m - x
        dy = self.origin_m[1] + (np.arange(self.ground.shape[1]) + 0.5) * self.cell_m - y
        return dx[:, None] ** 2 + dy[None, :] ** 2 <= radius**2

    def part_around(self, points: ArrayLike, margin_m: float) -> tuple[slice, slice]:
        """Slices of the cells around some points (k, 2), at least one cell."""
        p = np.asarray(points)
        last = np.array(self.ground.shape) - 1
        low = np.clip(self.cell_of(p.min(axis=0) - margin_m), 0, last).tolist()
        high = np.clip(self.cell_of(p.max(axis=0) + margin_m), 0, last).tolist()
        return slice(low[0], high[0] + 1), slice(low[1], high[1] + 1)

    def part(self, cells: tuple[slice, slice]) -> BeliefGrid:
        """A rectangle of the grid."""
        x, y = self.origin_m
        corner = (x + cells[0].start * self.cell_m, y + cells[1].start * self.cell_m)
        return BeliefGrid(self.ground[cells], self.obstacle[cells], corner, self.cell_m)

    def trusting(self, disc: Disc) -> BeliefGrid:
        """The grid with unknown cells in a disc taken as proven; hazards stay hazards."""
        unknown = (self.ground > HAZARD) & (self.ground < PROVEN)
        return BeliefGrid(
            np.where(self.within(disc) & unknown, np.uint8(255), self.ground), self.obstacle, self.origin_m, self.cell_m
        )


@dataclass(frozen=True)
class Footprint:
    """What a robot covers: the disc of ground that carries it, its body's disc, and how well it keeps to a path."""

    contact_radius_m: float
    body_radius_m: float
    margin_m: float = 0.015

    def reach_m(self, cell_m: float) -> float:
        """Distance that cell centres of unproven ground must keep.

        Contact radius and margin; on coarse grids half a cell's diagonal, so that a line cannot cut a cell's corner.
        """
        return max(self.contact_radius_m + self.margin_m, 0.71 * cell_m)


class Clearance:
    """How far a robot's centre may still move before it meets ground that is not proven, an obstacle or a disc.

    A point is safe where the clearance is positive: every cell whose centre lies within reach is proven, no obstacle
    cell reaches into the body, and the point lies outside the ``keep_out`` discs.
    """

    def __init__(self, grid: BeliefGrid, footprint: Footprint, keep_out: tuple[Disc, ...] = ()) -> None:
        from scipy.spatial import cKDTree

        obstacles = grid.centres(grid.obstacle >= BLOCKED)
        self._limits = [(cKDTree(_unproven_edge(grid)), footprint.reach_m(grid.cell_m))]
        if len(obstacles):
            self._limits.append((cKDTree(obstacles), footprint.body_radius_m + 0.5 * grid.cell_m))
        self._discs = keep_out

    def __call__(self, points: Points) -> NDArray[np.float64]:
        """Clearance (k,) in metres at points (k, 2), negative where the robot may not stand."""
        spare = np.full(len(points), np.inf)
        for tree, distance_m in self._limits:
            spare = np.minimum(spare, tree.query(points)[0] - distance_m)
        for x, y, radius in self._discs:
            spare = np.minimum(spare, np.hypot(points[:, 0] - x, points[:, 1] - y) - radius)
        return spare

    def along(self, start: Points, end: Points) -> float:
        """The least clearance in metres on the straight line between two points."""
        steps = max(2, int(np.ceil(np.hypot(*(end - start)) / 0.01)) + 1)
        return float(self(start + np.linspace(0.0, 1.0, steps)[:, None] * (end - start)).min())


class SafeRoutes:
    """All safe routes of one robot from where it stands, found in one search.

    ``safe`` (nx, ny) tells on which cells' centres the robot may stand, ``cost_m`` (nx, ny) the price of reaching them,
    infinite where no safe route leads. Routes prefer clearance: a metre along the very edge costs ``1 + SHYNESS``.
    """

    def __init__(
        self, grid: BeliefGrid, start_m: ArrayLike, footprint: Footprint, keep_out: tuple[Disc, ...] = ()
    ) -> None:
        self.grid, self.start_m = grid, np.asarray(start_m, dtype=np.float64)
        self.clearance = Clearance(grid, footprint, keep_out)
        proven = grid.ground >= PROVEN
        spare = np.full(grid.ground.shape, -np.inf)
        spare[proven] = self.clearance(grid.centres(proven))
        self.safe = spare > 0.0
        self.cost_m = np.full(grid.ground.shape, np.inf)
        entries = self._entries()
        if entries:
            price = np.where(self.safe, 1.0 + SHYNESS * (1.0 - np.clip(spare / COMFORT_M, 0.0, 1.0)), -1.0)
            self._search = minimum_cost_search(price, diagonal=footprint.reach_m(grid.cell_m) >= grid.cell_m)
            self.cost_m = self._search.find_costs(entries)[0] * grid.cell_m

    def _entries(self) -> list[Cell]:
        """Safe cells near the start, reached straight and with no less clearance than where the robot stands."""
        least = min(0.0, float(self.clearance(self.start_m[None])[0])) - 1e-9
        near = np.argwhere(self.safe & self.grid.within((*self.start_m, ENTRY_CELLS * self.grid.cell_m)))
        return [
            (i, j) for i, j in near.tolist() if self.clearance.along(self.start_m, self.grid.centre_of((i, j))) >= least
        ]

    def nearest_to(self, goal_m: ArrayLike, radius_m: float) -> Cell | None:
        """The reachable cell nearest to a goal, if its centre lies within the goal's radius."""
        reachable = np.isfinite(self.cost_m) & self.grid.within((*np.asarray(goal_m), radius_m))
        if not reachable.any():
            return None
        distance = np.hypot(*(self.grid.centres(reachable) - goal_m).T)
        i, j = np.argwhere(reachable)[int(np.argmin(distance))]
        return int(i), int(j)

    def path_to(self, cell: Cell) -> Points | None:
        """Waypoints (k, 2) in metres from the start to a cell's centre, or None."""
        if not np.isfinite(self.cost_m[cell]):
            return None
        cells = np.array(self._search.traceback(cell))
        return self._straightened(np.vstack([self.start_m, self.grid.centre_of(cells)]))

    def _straightened(self, points: Points) -> Points:
        """Fewer waypoints: a straight line replaces those between its ends if it has no less clearance than they."""
        spare = self.clearance(points)
        kept = [0]
        for k in range(2, len(points)):
            if self.clearance.along(points[kept[-1]], points[k]) < spare[kept[-1] : k + 1].min():
                kept.append(k - 1)
        return points[[*kept, len(points) - 1]]


def safe_path(
    grid: BeliefGrid,
    start_m: ArrayLike,
    goal_m: ArrayLike,
    goal_radius_m: float,
    footprint: Footprint,
    keep_out: tuple[Disc, ...] = (),
) -> Points | None:
    """Waypoints (k, 2) over proven ground to the reachable cell nearest the goal and within its radius, or None."""
    routes = SafeRoutes(grid, start_m, footprint, keep_out)
    cell = routes.nearest_to(goal_m, goal_radius_m)
    return None if cell is None else routes.path_to(cell)


def minimum_cost_search(price: NDArray[np.float64], diagonal: bool) -> Any:
    """scikit-image's search over a grid of prices (nx, ny); negative ones cannot be entered."""
    from skimage.graph import MCP_Geometric

    return MCP_Geometric(price, fully_connected=diagonal)


def _unproven_edge(grid: BeliefGrid) -> Points:
    """Centres (k, 2) of the unproven cells that touch a proven one, beyond the grid's edge included; never empty."""
    from scipy.ndimage import binary_dilation

    proven = np.pad(grid.ground >= PROVEN, 1)
    edge = binary_dilation(proven, np.ones((3, 3), dtype=bool)) & ~proven
    return grid.centre_of(np.argwhere(edge if edge.any() else ~proven) - 1)

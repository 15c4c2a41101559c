"""Safe paths over a believed grid: over proven ground only, clear of obstacles and of other robots.

The search itself is scikit-image's minimum-cost path; this module says what a cell costs and which cells may be used.

Source: thesis 2.2.5 (a grid of safely navigable points, points near a stuck robot removed, shortest path).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

UNKNOWN = 128
PROVEN = 230  # P(ground carries robots) in 255ths from which a cell counts as proven
HAZARD = 100  # ... below which it counts as a hazard
BLOCKED = 166  # P(obstacle) in 255ths from which a cell counts as an obstacle

Mask = NDArray[np.bool_]
Points = NDArray[np.float64]
Disc = tuple[float, float, float]
Node = tuple[int, int]

COMFORT_M = 0.10  # a robot with this much clearance pays nothing for being near an edge
SHYNESS = 3.0  # what a metre along the very edge of the proven ground costs above one in the open, in metres
LINE_STEP_M = 0.01
ENTRY_CELLS = 2.2  # how far from the robot its first safe node may lie


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
        return self.centre_of(np.moveaxis(np.indices(self.ground.shape), 0, -1))

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

    def known(self) -> Points:
        """Centres (k, 2) of the cells of which anything is known."""
        return self.centres((self.ground != UNKNOWN) | (self.obstacle != UNKNOWN))

    def trusting(self, disc: Disc) -> BeliefGrid:
        """The grid with unknown cells in a disc taken as proven; hazards stay hazards."""
        unknown = (self.ground > HAZARD) & (self.ground < PROVEN)
        return BeliefGrid(
            np.where(self.within(disc) & unknown, np.uint8(255), self.ground), self.obstacle, self.origin_m, self.cell_m
        )


@dataclass(frozen=True)
class Footprint:
    """What a robot covers: the disc of ground that carries it, its body's disc, and how well it keeps to a path.

    Cells tell of ground no more finely than their size; next to ground that caught a robot the margin is wider.
    """

    contact_radius_m: float
    body_radius_m: float
    margin_m: float = 0.02
    hazard_margin_m: float = 0.045

    def reach_m(self, cell_m: float) -> float:
        """Distance that centres of unproven cells must keep.

        Contact radius and margin; on coarse grids half a cell's diagonal, so that a line cannot cut a cell's corner.
        """
        return max(self.contact_radius_m + self.margin_m, 0.71 * cell_m)

    def hazard_reach_m(self, cell_m: float) -> float:
        """Distance that centres of hazardous cells must keep."""
        return max(self.contact_radius_m + self.hazard_margin_m, 0.71 * cell_m)


class Clearance:
    """How far a robot's centre may still move before it meets ground that is not proven, an obstacle or a disc.

    A point is safe where the clearance is positive: every cell whose centre lies within reach is proven, hazards are
    farther off, no obstacle cell reaches into the body, and the point lies outside the ``keep_out`` discs.
    """

    def __init__(self, grid: BeliefGrid, footprint: Footprint, keep_out: tuple[Disc, ...] = ()) -> None:
        from scipy.spatial import KDTree

        obstacles = grid.centres(grid.obstacle >= BLOCKED)
        self._limits = [(KDTree(_unproven_edge(grid)), footprint.reach_m(grid.cell_m))]
        if len(obstacles):
            self._limits.append((KDTree(obstacles), footprint.body_radius_m + 0.5 * grid.cell_m))
        self._discs = keep_out

    def __call__(self, points: Points) -> NDArray[np.float64]:
        """Clearance (k,) in metres at points (k, 2), negative where the robot may not stand."""
        spare = np.full(len(points), np.inf)
        for tree, distance_m in self._limits:
            spare = np.minimum(spare, tree.query(points)[0] - distance_m)
        for x, y, radius in self._discs:
            spare = np.minimum(spare, np.hypot(points[:, 0] - x, points[:, 1] - y) - radius)
        return spare

    def along(self, start: Points, ends: Points) -> NDArray[np.float64]:
        """The least clearance (k,) in metres on the straight lines from one point to others (k, 2)."""
        way = ends - start
        steps = max(2, int(np.ceil(np.hypot(way[:, 0], way[:, 1]).max() / LINE_STEP_M)) + 1)
        lines = start + np.linspace(0.0, 1.0, steps)[:, None, None] * way
        return self(lines.reshape(-1, 2)).reshape(steps, len(ends)).min(axis=0)


class SafeRoutes:
    """All safe routes of one robot from where it stands, found in one search.

    Nodes lie at the corners, edges and centres of cells: node (a, b) of a grid of (nx, ny) cells is at
    ``origin + cell / 2 * (a, b)``. ``cost_m`` (2 nx + 1, 2 ny + 1) is the price of reaching each, infinite where no
    safe route leads. Routes prefer clearance: a metre along the very edge of what is safe costs ``1 + SHYNESS``.
    """

    def __init__(
        self, grid: BeliefGrid, start_m: ArrayLike, footprint: Footprint, keep_out: tuple[Disc, ...] = ()
    ) -> None:
        self.grid, self.start_m = grid, np.asarray(start_m, dtype=np.float64)
        self.clearance = Clearance(grid, footprint, keep_out)
        self.spare_m = node_clearance(grid, footprint, keep_out)
        self.cost_m = np.full(self.spare_m.shape, np.inf)
        entries = self._entries()
        if entries:
            price = 1.0 + SHYNESS * (1.0 - np.clip(self.spare_m / COMFORT_M, 0.0, 1.0))
            self._search = minimum_cost_search(np.where(self.spare_m > 0.0, price, -1.0))
            self.cost_m = self._search.find_costs(entries)[0] * (0.5 * grid.cell_m)

    def positions(self, nodes: ArrayLike) -> Points:
        """Places (..., 2) in metres of nodes (..., 2)."""
        return np.asarray(self.grid.origin_m) + 0.5 * self.grid.cell_m * np.asarray(nodes)

    def reachable(self) -> tuple[Points, NDArray[np.float64]]:
        """Places (k, 2) that safe routes lead to, and what it costs to get there (k,)."""
        reached = np.isfinite(self.cost_m)
        return self.positions(np.argwhere(reached)), self.cost_m[reached]

    def _entries(self) -> list[Node]:
        """Safe nodes near the start, reached straight and with no less clearance than where the robot stands."""
        least = min(0.0, float(self.clearance(self.start_m[None])[0])) - 1e-9
        nodes = np.argwhere(self.spare_m > 0.0)
        places = self.positions(nodes)
        near = np.hypot(*(places - self.start_m).T) < ENTRY_CELLS * self.grid.cell_m
        nodes, places = nodes[near], places[near]
        if not len(nodes):
            return []
        return [(a, b) for a, b in nodes[self.clearance.along(self.start_m, places) >= least].tolist()]

    def nearest_to(self, goal_m: ArrayLike, radius_m: float) -> Node | None:
        """The reachable node nearest to a goal, if it lies within the goal's radius."""
        nodes = np.argwhere(np.isfinite(self.cost_m))
        distance = np.hypot(*(self.positions(nodes) - np.asarray(goal_m)).T)
        if not len(nodes) or distance.min() > radius_m:
            return None
        a, b = nodes[int(np.argmin(distance))].tolist()
        return a, b

    def path_to(self, node: Node) -> Points | None:
        """Waypoints (k, 2) in metres from the start to a node, or None."""
        if not np.isfinite(self.cost_m[node]):
            return None
        nodes = np.array(self._search.traceback(node))
        return self._straightened(np.vstack([self.start_m, self.positions(nodes)]))

    def _straightened(self, points: Points) -> Points:
        """Fewer waypoints: a straight line replaces those between its ends if it has no less clearance than they."""
        spare = self.clearance(points)
        kept = [0]
        for k in range(2, len(points)):
            if self.clearance.along(points[kept[-1]], points[k : k + 1])[0] < spare[kept[-1] : k + 1].min():
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
    """Waypoints (k, 2) over proven ground to the reachable node nearest the goal and within its radius, or None."""
    routes = SafeRoutes(grid, start_m, footprint, keep_out)
    node = routes.nearest_to(goal_m, goal_radius_m)
    return None if node is None else routes.path_to(node)


def node_clearance(grid: BeliefGrid, footprint: Footprint, keep_out: tuple[Disc, ...] = ()) -> NDArray[np.float64]:
    """`Clearance` (2 nx + 1, 2 ny + 1) at the nodes of `SafeRoutes`."""
    from scipy.ndimage import distance_transform_edt

    half_m = 0.5 * grid.cell_m
    unproven = at_nodes(np.pad(grid.ground < PROVEN, 1, constant_values=True))
    distance = half_m * np.asarray(distance_transform_edt(~unproven))
    spare = distance[2:-2, 2:-2] - footprint.reach_m(grid.cell_m)
    obstacle = grid.obstacle >= BLOCKED
    if obstacle.any():
        distance = half_m * np.asarray(distance_transform_edt(~at_nodes(obstacle)))
        spare = np.minimum(spare, distance - footprint.body_radius_m - half_m)
    for x, y, radius in keep_out:
        dx = grid.origin_m[0] + half_m * np.arange(spare.shape[0]) - x
        dy = grid.origin_m[1] + half_m * np.arange(spare.shape[1]) - y
        spare = np.minimum(spare, np.hypot(dx[:, None], dy[None]) - radius)
    return spare


def at_nodes(cells: NDArray[Any]) -> NDArray[Any]:
    """Values (nx, ny) of cells put on the nodes at their centres (2 nx + 1, 2 ny + 1), nothing elsewhere."""
    nodes = np.zeros((2 * cells.shape[0] + 1, 2 * cells.shape[1] + 1), dtype=cells.dtype)
    nodes[1::2, 1::2] = cells
    return nodes


def minimum_cost_search(price: NDArray[np.float64]) -> Any:
    """scikit-image's search over a grid of prices, eight neighbours each; negative ones cannot be entered."""
    from skimage.graph import MCP_Geometric

    return MCP_Geometric(price, fully_connected=True)


def _limits(grid: BeliefGrid, footprint: Footprint) -> tuple[tuple[Mask, float], ...]:
    """Cells (nx, ny) besides unproven ones whose centres a robot's centre must keep away from, and by how much."""
    hazard = (grid.ground <= HAZARD, footprint.hazard_reach_m(grid.cell_m))
    return hazard, (grid.obstacle >= BLOCKED, footprint.body_radius_m + 0.5 * grid.cell_m)


def _unproven_edge(grid: BeliefGrid) -> Points:
    """Centres (k, 2) of the unproven cells that touch a proven one, beyond the grid's edge included; never empty."""
    from scipy.ndimage import binary_dilation

    proven = np.pad(grid.ground >= PROVEN, 1)
    edge = np.asarray(binary_dilation(proven, np.ones((3, 3), dtype=bool)), dtype=bool) & ~proven
    return grid.centre_of(np.argwhere(edge if edge.any() else ~proven) - 1)

"""Ways over ground that is not proven yet: what the observer would need, and how pickets get about.

The prospect is the observer's cheapest way to the goal if unknown ground turned out safe; the unproven cells that its
contact disc would touch there are what is worth proving. Unproven ground is dear, the more so the less likely it is to
carry a robot, after each failure to get there (a factor of 2, as in thesis 2.2.3), and near a lost robot, for hazards
are wider than a robot's touch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from baselines.atlas import Point, Survey
from coop_envs.mapping.planning import (
    BLOCKED,
    HAZARD,
    PROVEN,
    BeliefGrid,
    Disc,
    Footprint,
    Mask,
    Points,
    at_nodes,
    minimum_cost_search,
    node_clearance,
)

UNPROVEN_PRICE, OFF_WAY = 2.0, 3.0
SUSPECT_M, SUSPECT_DOUBLINGS = 0.30, 3.0
BLOCKED_PRICE, LIKELY_PRICE = 300.0, 30.0


@dataclass(frozen=True)
class Prospect:
    """The observer's hoped-for way (n, 2), and the centres (k, 2) of the cells it still needs proven."""

    way: Points
    needed: Points


def find_prospect(
    survey: Survey, start: Point, goal: Disc, footprint: Footprint, keep_out: tuple[Disc, ...]
) -> Prospect | None:
    """The observer's prospect, or None if obstacles and lost robots leave none.

    The goal is a disc (x, y, radius), of which any place will do. Start and goal lie in the grid.
    """
    grid = survey.grid
    price = _price_under(_ground_price(survey), survey.grid, footprint)
    hoped = replace(grid, ground=np.full_like(grid.ground, 255))
    price[node_clearance(hoped, footprint, keep_out) <= 0.0] = -1.0
    first = _node(survey, start)
    price[first] = 1.0
    search = minimum_cost_search(price)
    cost = np.where(_within(survey, goal, price.shape), search.find_costs([first])[0], np.inf)
    last = divmod(int(np.argmin(cost)), cost.shape[1])
    if not np.isfinite(cost[last]):
        return None
    nodes = np.array(search.traceback(last))
    way = np.zeros(price.shape, dtype=bool)
    way[tuple(nodes.T)] = True
    touched = _near(way, footprint.reach_m(grid.cell_m), grid.cell_m)[1::2, 1::2] & (grid.ground < PROVEN)
    touched |= _near(way, footprint.hazard_reach_m(grid.cell_m), grid.cell_m)[1::2, 1::2] & (grid.ground <= HAZARD)
    return Prospect(_place(survey, nodes), grid.centres(touched))


def scouting_way(survey: Survey, start: Point, end: Point, footprint: Footprint, prospect: Prospect | None) -> Points:
    """Waypoints (k, 2) for an expendable robot: over proven ground and along the observer's way while it can.

    Hazards and obstacles are dear, not forbidden, so there is always an answer. Both ends must lie in the grid.
    """
    first, last = (_node(survey, p) for p in (start, end))
    search = minimum_cost_search(_scouting_price(survey, footprint, prospect))
    search.find_costs([first], [last])
    middle = _place(survey, np.array(search.traceback(last))[1:-1].reshape(-1, 2))
    return np.vstack([np.asarray(start)[None], middle, np.asarray(end)[None]])


def scouting_costs(
    survey: Survey, start: Point, footprint: Footprint, proven_only: bool
) -> tuple[Points, NDArray[np.float64]]:
    """Places (k, 2) where an expendable robot might go, and what it costs (k,) in metres over proven ground."""
    price = _scouting_price(survey, footprint, None)
    cost_m = minimum_cost_search(price).find_costs([_node(survey, start)])[0] * (0.5 * survey.grid.cell_m)
    likely = price <= (1.0 if proven_only else LIKELY_PRICE)
    return _place(survey, np.argwhere(likely)), cost_m[likely]


def _scouting_price(survey: Survey, footprint: Footprint, prospect: Prospect | None) -> NDArray[np.float64]:
    grid = survey.grid
    price = _ground_price(survey)
    if prospect is not None:
        price = np.where(_mask_of(survey, prospect.way) | (price <= 1.0), price, OFF_WAY * price)
    price = _price_under(price, grid, footprint)
    price[_near(at_nodes(grid.obstacle >= BLOCKED), footprint.body_radius_m, grid.cell_m)] = BLOCKED_PRICE
    return price


def _ground_price(survey: Survey) -> NDArray[np.float64]:
    """Price (nx, ny) of a metre over each cell: 1 where proven."""
    grid = survey.grid
    price = UNPROVEN_PRICE * 255.0 / np.maximum(grid.ground, 1)
    price *= np.exp2(survey.doubt.astype(np.float64)) * suspicion(grid.centres_all(), survey.losses)
    return np.where(grid.ground >= PROVEN, 1.0, price)


def suspicion(points: Points, losses: tuple[Point, ...]) -> NDArray[np.float64]:
    """A factor (...) for points (..., 2): 1 away from lost robots, doubling again and again towards them."""
    nearest = np.full(points.shape[:-1], SUSPECT_M)
    for x, y in losses:
        nearest = np.minimum(nearest, np.hypot(points[..., 0] - x, points[..., 1] - y))
    return np.exp2(SUSPECT_DOUBLINGS * (1.0 - nearest / SUSPECT_M))


def _price_under(price: NDArray[np.float64], grid: BeliefGrid, footprint: Footprint) -> NDArray[np.float64]:
    """Mean price at each node of the cells within reach, and of the hazards within the hazards' wider reach."""
    hazard = np.where(grid.ground <= HAZARD, price, 0.0)
    mean = _mean_around(price, footprint.reach_m(grid.cell_m), grid.cell_m)
    return mean + _mean_around(hazard, footprint.hazard_reach_m(grid.cell_m), grid.cell_m)


def _mean_around(cells: NDArray[np.float64], distance_m: float, cell_m: float) -> NDArray[np.float64]:
    """Mean at each node (2 nx + 1, 2 ny + 1) of the cells (nx, ny) within a distance."""
    from scipy.ndimage import correlate

    disc = _disc(distance_m, 0.5 * cell_m).astype(float)
    total, count = (correlate(at_nodes(values), disc, mode="constant") for values in (cells, np.ones_like(cells)))
    return total / np.maximum(count, 1.0)


def _near(nodes: Mask, distance_m: float, cell_m: float) -> Mask:
    """Nodes within a distance of the nodes of the mask."""
    from scipy.ndimage import binary_dilation

    if not nodes.any():
        return nodes

    return np.asarray(binary_dilation(nodes, _disc(distance_m, 0.5 * cell_m)), dtype=bool)


def _disc(radius_m: float, step_m: float) -> Mask:
    n = int(radius_m / step_m)
    i = np.arange(-n, n + 1) * step_m
    return i[:, None] ** 2 + i[None] ** 2 <= radius_m**2


def _node(survey: Survey, point: Point) -> tuple[int, int]:
    a, b = np.rint((np.asarray(point) - survey.grid.origin_m) / (0.5 * survey.grid.cell_m)).astype(int).tolist()
    return a, b


def _within(survey: Survey, disc: Disc, shape: tuple[int, int]) -> Mask:
    """Nodes within a disc (x, y, radius)."""
    x, y, radius = disc
    place = _place(survey, np.moveaxis(np.indices(shape), 0, -1))
    return np.hypot(place[..., 0] - x, place[..., 1] - y) <= radius


def _place(survey: Survey, nodes: NDArray[np.intp]) -> Points:
    return np.asarray(survey.grid.origin_m, dtype=np.float64) + 0.5 * survey.grid.cell_m * nodes.astype(np.float64)


def _mask_of(survey: Survey, points: Points) -> Mask:
    """The cells that hold these points; points outside the grid are left out."""
    mask = np.zeros(survey.grid.ground.shape, dtype=bool)
    cells = survey.grid.cell_of(points)
    inside = np.all((cells >= 0) & (cells < mask.shape), axis=1)
    mask[tuple(cells[inside].T)] = True
    return mask

"""Where pickets should stand while the observer crosses: seen from its path, on proven ground, not in its way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.team_view import RobotView
from coop_envs.mapping.planning import BLOCKED, BeliefGrid, SafeRoutes

NEAREST_M, FARTHEST_M = 0.15, 1.5  # a hat is seen well between these distances
STEP_M = 0.05
EDGE_RAD = 0.08
TRAVEL_PRICE_1_M = 0.1
APART_M = 0.25


def choose_posts(
    routes: dict[str, SafeRoutes],
    scouts: tuple[RobotView, ...],
    path_m: NDArray[np.float64],
    half_view_rad: float,
    clear_m: float,
) -> dict[str, tuple[float, float]]:
    """A post (x, y) for each scout that can reach one.

    ``routes`` are each scout's own; posts stay ``clear_m`` (centre to centre) off the path (k, 2) and apart from each
    other. The best post is in view along most of the path, less a price for the way there.
    """
    posts: dict[str, tuple[float, float]] = {}
    for scout in scouts:
        places, cost_m = routes[scout.name].reachable()
        free = _distances(places, path_m).min(axis=1, initial=np.inf) >= clear_m
        if posts:
            free &= _distances(places, np.array(list(posts.values()))).min(axis=1) >= APART_M
        if free.any():
            seen = share_in_view(routes[scout.name].grid, places[free], path_m, half_view_rad)
            x, y = places[free][int(np.argmax(seen - TRAVEL_PRICE_1_M * cost_m[free]))].tolist()
            posts[scout.name] = (x, y)
    return posts


def share_in_view(
    grid: BeliefGrid, places: NDArray[np.float64], path_m: NDArray[np.float64], half_view_rad: float
) -> NDArray[np.float64]:
    """Share (k,) of a path's points (n, 2) from which places (k, 2) are in view of a robot that drives along it."""
    ahead = np.gradient(path_m, axis=0)
    offset = places[:, None] - path_m[None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - np.arctan2(ahead[:, 1], ahead[:, 0])
    bearing = (bearing + np.pi) % (2.0 * np.pi) - np.pi
    seen = (np.abs(bearing) < half_view_rad - EDGE_RAD) & (distance > NEAREST_M) & (distance < FARTHEST_M)
    return (seen & ~_hidden(grid, path_m[None], offset)).mean(axis=1)


def _hidden(grid: BeliefGrid, origin: NDArray[np.float64], offset: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether an obstacle cell lies on the straight lines from origins along offsets (k, n, 2)."""
    hidden = np.zeros(offset.shape[:2], dtype=bool)
    last = np.array(grid.obstacle.shape) - 1
    for part in np.linspace(0.1, 0.9, 12):
        cells = np.clip(grid.cell_of(origin + part * offset), 0, last)
        hidden |= grid.obstacle[cells[..., 0], cells[..., 1]] >= BLOCKED
    return hidden


def _distances(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hypot(a[:, None, 0] - b[None, :, 0], a[:, None, 1] - b[None, :, 1])

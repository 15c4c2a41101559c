"""Where pickets should stand while the observer crosses: seen from its path, on likely ground, not in its way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baselines.atlas import Point
from coop_envs.mapping.planning import BLOCKED, BeliefGrid, Points

NEAREST_M, FARTHEST_M = 0.15, 1.5  # a hat is seen well between these distances
EDGE_RAD = 0.08
TURN_RAD = 0.4  # a look aside by this much more than the view shows is worth 1/e of a look ahead
TRAVEL_PRICE_1_M = 0.1
APART_M = 0.25


def choose_posts(
    places: dict[str, tuple[Points, NDArray[np.float64]]],
    grid: BeliefGrid,
    path_m: Points,
    half_view_rad: float,
    clear_m: float,
) -> dict[str, Point]:
    """A post (x, y) for each scout that can go to one.

    ``places`` are where each scout might go (k, 2) and what that costs (k,). Posts stay ``clear_m`` (centre to centre)
    off the path (n, 2), or as far as there is room, and apart from each other. The best one is in view along most of
    the path, less a price for the way there.
    """
    posts: dict[str, Point] = {}
    for name, (place, cost_m) in places.items():
        off_m = _distances(place, path_m).min(axis=1, initial=np.inf)
        free = off_m >= min(clear_m, off_m.max(initial=0.0))
        if posts:
            free &= _distances(place, np.array(list(posts.values()))).min(axis=1) >= APART_M
        if free.any():
            worth = worth_as_landmark(grid, place[free], path_m, half_view_rad) - TRAVEL_PRICE_1_M * cost_m[free]
            x, y = place[free][int(np.argmax(worth))].tolist()
            posts[name] = (x, y)
    return posts


def worth_as_landmark(grid: BeliefGrid, places: Points, path_m: Points, half_view_rad: float) -> NDArray[np.float64]:
    """How well (k,), 0 to 1, places (k, 2) are in view of a robot that drives along a path (n, 2), on its average."""
    ahead = np.gradient(path_m, axis=0)
    offset = places[:, None] - path_m[None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - np.arctan2(ahead[:, 1], ahead[:, 0])
    aside = np.maximum(np.abs((bearing + np.pi) % (2.0 * np.pi) - np.pi) - (half_view_rad - EDGE_RAD), 0.0)
    seen = (distance > NEAREST_M) & (distance < FARTHEST_M) & ~_hidden(grid, path_m[None], offset)
    return (seen * np.exp(-aside / TURN_RAD)).mean(axis=1)


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

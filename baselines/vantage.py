"""Where the observer should stand and look next, when the pickets have proven what they can reach in its view.

Source: inchworm advance of chapter 5 (the observer moves while pickets hold, and the other way round).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coop_envs.mapping.planning import BLOCKED, HAZARD, PROVEN, BeliefGrid, Node, Points, SafeRoutes

RANGE_M = 1.2
HEADINGS = np.linspace(-math.pi, math.pi, 24, endpoint=False)
APART_M = 0.2
TRIED_SHARE = 0.15
TRAVEL_PRICE_1_M = 0.15


def worth_exploring(grid: BeliefGrid, needed: Points | None) -> NDArray[np.float64]:
    """Worth (nx, ny) of proving each cell: needed ones share 1, or else unknown ones count square metres."""
    if needed is None or not len(needed):
        unknown = (grid.ground > HAZARD) & (grid.ground < PROVEN) & (grid.obstacle < BLOCKED)
        return unknown.astype(np.float64) * grid.cell_m**2
    worth = np.zeros(grid.ground.shape)
    worth[tuple(grid.cell_of(needed).T)] = 1.0 / len(needed)
    return worth


def best_heading(
    grid: BeliefGrid, worth: NDArray[np.float64], xy: tuple[float, float], half_view_rad: float, tried: list[float]
) -> tuple[float, float]:
    """The heading (team frame) whose field of view holds the most worth, and that worth; tried ones count little."""
    place = np.argwhere((worth > 0.0) & grid.within((*xy, RANGE_M)))
    offset = grid.centre_of(place) - xy
    bearing = np.arctan2(offset[:, 1], offset[:, 0])
    in_view = np.abs(_wrapped(bearing[None] - HEADINGS[:, None])) < half_view_rad
    gain = in_view @ worth[tuple(place.T)]
    for heading in tried:
        gain[np.abs(_wrapped(HEADINGS - heading)) < half_view_rad] *= TRIED_SHARE
    best = int(np.argmax(gain))
    return float(HEADINGS[best]), float(gain[best])


def best_stand(
    routes: SafeRoutes, worth: NDArray[np.float64], stands: list[tuple[float, float]]
) -> tuple[Node | None, float]:
    """The reachable node with the most worth round it for the way there, and that worth; away from earlier stands."""
    from scipy.ndimage import uniform_filter

    grid = routes.grid
    width = max(1, round(RANGE_M / grid.cell_m))
    around = uniform_filter(worth, size=width, mode="constant") * width**2
    gain = np.where(np.isfinite(cost_m := routes.cost_m[1::2, 1::2]), around - TRAVEL_PRICE_1_M * cost_m, -np.inf)
    for x, y in stands:
        gain[grid.within((x, y, APART_M))] = -np.inf
    i, j = divmod(int(np.argmax(gain)), gain.shape[1])
    return ((2 * i + 1, 2 * j + 1), float(gain[i, j])) if np.isfinite(gain[i, j]) else (None, 0.0)


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi

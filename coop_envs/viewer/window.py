"""Which part of a world to show: all of a small one, and of a large one where the robots are or have been."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.viewer.robots import Trail

POINT_MARGIN_M = 0.15
SLIMMEST = 0.7
Bounds = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max in metres, world frame."""


def window_around(world: WorldPicture, centre_xy: ArrayLike, side_m: float = 4.0) -> Bounds:
    """A square window about a point, moved to lie inside the world; of a smaller world all.

    Its size stays the same wherever the point is, and it moves in steps of a quarter side, so that a live view does
    not swim.
    """
    low, high = np.array(world.bounds).reshape(2, 2)
    side = np.minimum(side_m, high - low)
    step = side_m / 4
    corner = np.clip(low + np.round((np.asarray(centre_xy) - side / 2 - low) / step) * step, low, high - side)
    return _bounds(corner, corner + side)


def episode_window(world: WorldPicture, frames: Sequence[Frame], margin_m: float = 0.6, least_m: float = 2.5) -> Bounds:
    """The window that holds an episode's paths, points and a margin, ``least_m`` wide and high; all of a small world.

    The outermost hundredth of the points on each side does not count: some are false. No side is shorter than a share
    `SLIMMEST` of the other, if the world is not.
    """
    low, high = np.array(world.bounds).reshape(2, 2)
    trail = Trail.from_frames(frames)
    points = np.concatenate([trail.true_xy.reshape(-1, 2), trail.belief_xy.reshape(-1, 2)])
    points = points[np.isfinite(points).all(axis=-1)]
    if points.size == 0:
        return world.bounds
    first, last = points.min(axis=0) - margin_m, points.max(axis=0) + margin_m
    if len(trail.points_m):
        reach = np.quantile(trail.points_m[:, :2], (0.01, 0.99), axis=0)
        first, last = np.minimum(first, reach[0] - POINT_MARGIN_M), np.maximum(last, reach[1] + POINT_MARGIN_M)
    spare = np.maximum(max(least_m, SLIMMEST * (last - first).max()) - (last - first), 0.0) / 2
    first, last = np.maximum(first - spare, low), np.minimum(last + spare, high)
    return _bounds(np.minimum(first, high), np.maximum(last, low))


def _bounds(low: np.ndarray, high: np.ndarray) -> Bounds:
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])

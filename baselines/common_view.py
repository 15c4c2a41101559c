"""What cameras see of level ground in common: only there can lasers measure it.

A camera's field of view is taken as a sector between its nearest and its farthest ground, whose angle may exceed pi.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.team import Member
from coop_envs.mapping.planning import BLOCKED, BeliefGrid, Mask, Points

Angles = NDArray[np.float64]

SPOT_RANGE_M = 2.3  # spots on the ground are dimmer the flatter they are seen
GROUND_RANGE_M = 1.6  # to show ground to be free, spots are needed beyond it
EDGE_RAD = 0.05
LEAST_PARALLAX, GOOD_PARALLAX = 0.3, 0.7  # sine of the angle between two lines of sight: below, points are uncertain
SIGHT_STEP_M = 0.1  # between samples of a line of sight


@dataclass(frozen=True)
class Sector:
    """Ground that a camera sees: half its horizontal field of view, and from how far to how far (m)."""

    half_rad: float
    nearest_m: float
    farthest_m: float

    def up_to(self, range_m: float) -> Sector:
        """Its part within a range."""
        return replace(self, farthest_m=min(self.farthest_m, range_m))


def sector_of(member: Member, view_rad: float | None = None) -> Sector:
    """Where a robot's camera sees spots on the ground; ``view_rad`` replaces its field of view."""
    camera = member.camera
    assert camera is not None
    below = math.atan2(0.5 * camera.height_px, camera.fy_px) + camera.pitch_down_rad
    height_m = member.robot.body_height_m + camera.position_m[2]
    half_rad = math.atan2(0.5 * camera.width_px, camera.fx_px) if view_rad is None else 0.5 * view_rad
    return Sector(half_rad - EDGE_RAD, height_m / math.tan(below), min(SPOT_RANGE_M, camera.max_range_m))


def views(sector: Sector, stands: Points, headings: Angles, points: Points) -> Mask:
    """Whether (s, h, k) points (k, 2) lie in the sectors of cameras at stands (s, 2) with headings (h,)."""
    offset = points[None] - stands[:, None]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    axes = np.stack([np.cos(headings), np.sin(headings)], axis=-1).astype(np.float32)
    ahead = axes @ offset.transpose(0, 2, 1).astype(np.float32)
    in_range = (distance > sector.nearest_m) & (distance < sector.farthest_m)
    return (ahead > math.cos(sector.half_rad) * distance[:, None].astype(np.float32)) & in_range[:, None]


class Walls:
    """Known obstacles, thick enough that a line sampled every `SIGHT_STEP_M` does not miss them."""

    def __init__(self, grid: BeliefGrid) -> None:
        walls = grid.obstacle >= BLOCKED
        self.any = bool(walls.any())
        if self.any and grid.cell_m < SIGHT_STEP_M:
            from scipy.ndimage import binary_dilation

            walls = np.asarray(binary_dilation(walls), dtype=bool)
        self._walls = np.pad(walls, 1)
        self._grid = grid

    def at(self, points: NDArray[Any]) -> Mask:
        """Whether points (..., 2) lie in one."""
        cells = (points - np.asarray(self._grid.origin_m, dtype=points.dtype)) / self._grid.cell_m + 1.0
        x, y = (np.clip(cells[..., k], 0, self._walls.shape[k] - 1).astype(np.int32) for k in (0, 1))
        return self._walls[x, y]


def hidden(grid: BeliefGrid, stands: Points, points: Points) -> Mask:
    """Whether (s, k) an obstacle lies on the straight lines from stands (s, 2) to just before points (k, 2)."""
    blocked, walls = np.zeros((len(stands), len(points)), dtype=bool), Walls(grid)
    if not walls.any or not len(points):
        return blocked
    start, end = stands[:, None].astype(np.float32), points[None].astype(np.float32)
    longest_m = min(float(np.hypot(*np.moveaxis(end - start, -1, 0)).max()), 1.1 * SPOT_RANGE_M)
    samples = math.ceil(longest_m / SIGHT_STEP_M)
    for part in (np.arange(samples) / samples).tolist():
        blocked |= walls.at(start + part * (end - start))
    return blocked


def parallax(stands: Points, other: Points, points: Points) -> NDArray[np.float64]:
    """Sine (s, k) of the angle at points (k, 2) between lines to stands (s, 2) and to another place (2,)."""
    a, b = points[None] - stands[:, None], points - other
    cross = a[..., 0] * b[:, 1] - a[..., 1] * b[:, 0]
    scale = np.hypot(a[..., 0], a[..., 1]) * np.hypot(b[:, 0], b[:, 1])
    return np.abs(cross) / np.maximum(scale, 1e-9)

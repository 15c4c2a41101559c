"""Rock garden, hole and ramp along a path of 5 m: the uneven ground of thesis section 5.3.3, Fig 5.7."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import require
from coop_envs.validation import STRICT
from coop_envs.worlds.placement import Footprint, Formation, formation_poses
from coop_envs.worlds.world import Hazard, HeightField, World

LANE_M = 1.2
ROCKS_X_M = (0.75, 1.75)
TURN_X_M = 2.4
END_X_M = 3.0
BEHIND_M = 0.7
RAMP_TOP_Y_M = -2.0
END_Y_M = -2.9
BORDER_M = 0.05
HOLE = Hazard("hole", (2.72, 0.32), (0.16, 0.16))
GOAL = (TURN_X_M, -2.6, 0.2)


@dataclass(frozen=True)
class RampGeometry:
    """A lane along x through rocks, a right turn before a hidden hole, and a lane along -y up a ramp.

    From the observer's start at (0, 0) to the turn and on to the goal are 5 m. ``rocks`` round bumps, at most
    ``rock_height_m`` high (least, most), are drawn by seed. The lanes are 1.2 m wide, between kerbs that are too high
    to climb and low enough to look over. The thesis gives no lengths but the path's; the rest is assumed.
    """

    __pydantic_config__ = STRICT
    kind: Literal["ramp"] = "ramp"
    rocks: int = 45
    rock_height_m: tuple[float, float] = (0.01, 0.03)
    ramp_height_m: float = 0.2
    kerb_height_m: float = 0.05
    hole: bool = True
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    goal: tuple[float, float, float] = GOAL
    cell_m: float = 0.01

    def __post_init__(self) -> None:
        require(0 <= self.rocks <= 500, "environment.geometry.rocks", self.rocks, "0 to 500")
        least, most = self.rock_height_m
        low = 0 <= least <= most <= 0.1
        require(low, "environment.geometry.rock_height_m", self.rock_height_m, "(least, most) within 0 to 0.1 m")
        climbable = 0 <= self.ramp_height_m <= 0.5
        require(climbable, "environment.geometry.ramp_height_m", self.ramp_height_m, "0 to 0.5 m over 1.4 m")
        require(self.kerb_height_m >= 0.04, "environment.geometry.kerb_height_m", self.kerb_height_m, "0.04 m or more")
        require(self.goal[2] > 0, "environment.geometry.goal", self.goal, "a radius above 0 m")
        require(0.005 <= self.cell_m <= 0.025, "environment.geometry.cell_m", self.cell_m, "0.005 to 0.025 m")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """The lanes with rocks drawn from ``rng``."""
        cell, half = self.cell_m, LANE_M / 2
        low = np.round((np.array([-BEHIND_M, END_Y_M]) - BORDER_M) / cell)
        nodes = np.round((np.array([END_X_M, half]) + BORDER_M) / cell) - low + 1
        x, y = (cell * (low[k] + np.arange(nodes[k])) for k in (0, 1))
        x, y = np.meshgrid(x, y, indexing="ij")
        hair = cell / 100
        along_x = (x >= -BEHIND_M - hair) & (x <= END_X_M + hair) & (np.abs(y) <= half + hair)
        along_y = (np.abs(x - TURN_X_M) <= half + hair) & (y >= END_Y_M - hair) & (y <= 0)
        slope = self.ramp_height_m * np.clip((-half - y) / (-half - RAMP_TOP_Y_M), 0.0, 1.0)
        heights = np.where(along_x | (x > TURN_X_M - half - 0.2), slope, 0.0) + self._rocks(x, y, rng)
        heights += np.where(along_x | along_y, 0.0, self.kerb_height_m)
        ground = HeightField(heights.astype(np.float32), (float(low[0]) * cell, float(low[1]) * cell), cell)
        starts, dock = formation_poses(team, self.start, Formation())
        return World("ramp", ground, None, (HOLE,) if self.hole else (), starts, dock, self.goal)

    def _rocks(self, x: NDArray[np.float64], y: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
        """Height of the rocks alone: the highest of their bells, whose flanks are climbable."""
        heights = np.zeros_like(x)
        for _ in range(self.rocks):
            height = rng.uniform(*self.rock_height_m)
            width = height * rng.uniform(1.6, 3.0)
            at_x, at_y = rng.uniform(*ROCKS_X_M), rng.uniform(-LANE_M / 2, LANE_M / 2)
            bell = height * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / (2 * max(width, 1e-3) ** 2))
            heights = np.maximum(heights, bell)
        return heights

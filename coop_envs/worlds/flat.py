"""Open flat ground, as in the planar U-turn of thesis section 5.3.2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from coop_envs.errors import require
from coop_envs.validation import STRICT
from coop_envs.worlds.placement import Footprint, Formation, formation_poses
from coop_envs.worlds.world import HeightField, World


@dataclass(frozen=True)
class FlatGeometry:
    """A level rectangle centred on the origin, without hazards.

    ``start`` (x, y, yaw) is the first observer's pose, ``goal`` (x, y, radius) or none.
    """

    __pydantic_config__ = STRICT
    kind: Literal["flat"] = "flat"
    size_m: tuple[float, float] = (4.0, 3.0)
    start: tuple[float, float, float] = (-1.5, -0.6, 0.0)
    goal: tuple[float, float, float] | None = None
    cell_m: float = 0.025

    def __post_init__(self) -> None:
        require(min(self.size_m) >= 0.5, "environment.geometry.size_m", self.size_m, "0.5 m or more each way")
        require(max(self.size_m) <= 100, "environment.geometry.size_m", self.size_m, "at most 100 m each way")
        require(0.001 <= self.cell_m <= 0.025, "environment.geometry.cell_m", self.cell_m, "0.001 to 0.025 m")
        require(self.goal is None or self.goal[2] > 0, "environment.geometry.goal", self.goal, "a radius above 0 m")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """The plane; nothing in it is random."""
        del rng
        nodes = [round(size / self.cell_m) + 1 for size in self.size_m]
        origin = (-self.cell_m * (nodes[0] - 1) / 2, -self.cell_m * (nodes[1] - 1) / 2)
        ground = HeightField(np.zeros(nodes, dtype=np.float32), origin, self.cell_m)
        starts, dock = formation_poses(team, self.start, Formation())
        return World("flat", ground, None, (), starts, dock, self.goal)

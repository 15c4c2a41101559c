"""Level floor before a corner of two walls: the scene of thesis Fig 6.6, where two robots scan from fixed poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from coop_envs.errors import require
from coop_envs.validation import STRICT
from coop_envs.worlds.placement import Footprint, Formation, Pose, formation_poses
from coop_envs.worlds.world import HeightField, World


@dataclass(frozen=True)
class CornerGeometry:
    """A floor with one wall ahead of the first robot, facing -x, and one to its right, facing +y.

    Teams whose robots all carry cameras stand at ``starts``: by default where the authors' simulation put them, the
    first robot before both walls and in the second one's view, so that the views overlap on floor and walls; a third
    robot, the thesis has none, sees the first from its left. Other teams stand in formation at the first of the poses.
    The figure gives no lengths: those of the walls here leave the corner in reach of two cameras.
    """

    __pydantic_config__ = STRICT
    kind: Literal["corner"] = "corner"
    wall_ahead_m: float = 2.0
    wall_right_m: float = 0.5
    behind_m: float = 1.0
    left_m: float = 2.5
    wall_height_m: float = 0.5
    wall_thickness_m: float = 0.1
    starts: tuple[Pose, ...] = ((0.0, 0.0, 0.0), (1.0, 2.0, -np.pi / 2), (-0.5, 1.4, -np.pi / 3))
    goal: tuple[float, float, float] | None = None
    cell_m: float = 0.01

    def __post_init__(self) -> None:
        for name in ("wall_ahead_m", "wall_right_m", "behind_m", "left_m"):
            length = getattr(self, name)
            require(0.2 <= length <= 20, f"environment.geometry.{name}", length, "0.2 to 20 m from the first robot")
        require(self.wall_height_m > 0, "environment.geometry.wall_height_m", self.wall_height_m, "more than 0 m")
        thick = self.wall_thickness_m >= 0.05
        require(thick, "environment.geometry.wall_thickness_m", self.wall_thickness_m, "0.05 m or more")
        require(0.005 <= self.cell_m <= 0.025, "environment.geometry.cell_m", self.cell_m, "0.005 to 0.025 m")
        require(bool(self.starts), "environment.geometry.starts", self.starts, "a pose (x, y, yaw) a robot")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """The corner; nothing in it is random."""
        del rng
        low = np.array([-self.behind_m, -self.wall_right_m - self.wall_thickness_m])
        high = np.array([self.wall_ahead_m + self.wall_thickness_m, self.left_m])
        first = np.round(low / self.cell_m)
        nodes = np.round(high / self.cell_m) - first + 1
        x, y = (self.cell_m * (first[k] + np.arange(nodes[k])) for k in (0, 1))
        hair = self.cell_m / 100
        wall = (x[:, None] > self.wall_ahead_m + hair) | (y[None, :] < -self.wall_right_m - hair)
        heights = np.where(wall, self.wall_height_m, 0.0).astype(np.float32)
        ground = HeightField(heights, (float(x[0]), float(y[0])), self.cell_m)
        starts, dock = self._starts(team)
        return World("corner", ground, None, (), starts, dock, self.goal)

    def _starts(self, team: Sequence[Footprint]) -> tuple[tuple[Pose, ...], Pose]:
        formation, dock = formation_poses(team, self.starts[0], Formation())
        active = [robot for robot in team if not robot.reserve]
        if not all(robot.camera for robot in active):
            return formation, dock
        expected = f"a pose for each of {len(active)} robots that are no reserves"
        require(len(self.starts) >= len(active), "environment.geometry.starts", self.starts, expected)
        places = dict(zip((robot.name for robot in active), self.starts, strict=False))
        dock = next((places[robot.name] for robot in active if not robot.observer), dock)
        return tuple(robot.start or places.get(robot.name, dock) for robot in team), dock

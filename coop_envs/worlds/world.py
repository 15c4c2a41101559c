"""What a world is: ground, hazards no sensor can tell from safe ground, light, where robots start and should go."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

HazardKind = Literal["trap", "hole", "slippery"]


@dataclass(frozen=True)
class HeightField:
    """Single-valued ground: heights at the nodes of a regular grid, two triangles a cell, split along b-c.

    ``heights_m[i, j]`` stands at ``origin_m + cell_m * (i, j)``; x runs with i, y with j. Beyond the edge there is no
    ground: robots are blocked there and rays pass.
    """

    heights_m: NDArray[np.float32]
    origin_m: tuple[float, float]
    cell_m: float

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max."""
        nx, ny = self.heights_m.shape
        x, y = self.origin_m
        return x, y, x + (nx - 1) * self.cell_m, y + (ny - 1) * self.cell_m


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh, vertices (v, 3) in metres, faces (f, 3)."""

    vertices_m: NDArray[np.float32]
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class Hazard:
    """A region of ground that looks like any other: a rectangle turned by yaw and rounded by a radius.

    ``half_size_m`` zero and ``radius_m`` above it make a disc. A trap holds and a hole swallows a robot
    whose contact disc touches it; a slippery patch scales the motion of one whose centre is on it by ``motion_scale``.
    """

    kind: HazardKind
    centre_m: tuple[float, float]
    half_size_m: tuple[float, float] = (0.0, 0.0)
    radius_m: float = 0.0
    yaw_rad: float = 0.0
    motion_scale: float = 0.3

    def signed_distance_m(self, xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance from points (..., 2) to the edge, negative inside."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        d = np.asarray(xy_m, dtype=np.float64) - self.centre_m
        local = np.stack([c * d[..., 0] + s * d[..., 1], -s * d[..., 0] + c * d[..., 1]], axis=-1)
        q = np.abs(local) - self.half_size_m
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
        return outside + np.minimum(np.max(q, axis=-1), 0.0) - self.radius_m


@dataclass(frozen=True)
class Medium:
    """What light passes through: absorption per metre of red, green and blue (thesis eq 4.2)."""

    name: str = "air"
    absorption_1_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    particulate: float = 0.0


@dataclass(frozen=True)
class World:
    """One world, ready to be simulated.

    ``ground`` carries the robots: for a mesh it is the lowest surface with headroom. Rays meet ``mesh`` where there is
    one, else the ground. ``starts`` are poses (x, y, yaw), one for each robot of a team; docked reserves undock at
    ``dock``. ``goal`` is (x, y, radius) or None.
    """

    name: str
    ground: HeightField
    mesh: Mesh | None
    hazards: tuple[Hazard, ...]
    starts: tuple[tuple[float, float, float], ...]
    dock: tuple[float, float, float]
    goal: tuple[float, float, float] | None
    friction: float = 0.8
    albedo: float = 0.6
    ambient_lux: float = 0.0
    medium: Medium = field(default_factory=Medium)

"""Walled arenas with hidden hazards, entered from a kerbed start bay: the one of thesis section 2.2.2, and random ones.

The arena's floor spans x 0..size, y 0..size; the bay lies at x < 0. Each of the sides far (+x), left (+y) and right
(-y) is a wall, which also stops rays of light, or a kerb too high for any robot but low enough to look over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from coop_envs.errors import CoopError, WorldError, require
from coop_envs.validation import STRICT
from coop_envs.worlds.placement import Footprint, Formation, Pose, check_placement, formation_length_m, formation_poses
from coop_envs.worlds.truth import safe_path_exists
from coop_envs.worlds.world import Hazard, HazardKind, HeightField, World

Side = Literal["far", "left", "right"]
SIDES: tuple[Side, ...] = ("far", "left", "right")
BORDER_M = 0.05
ATTEMPTS = 100


@dataclass(frozen=True)
class ArenaGeometry:
    """The arena of chapter 2: 75 x 60 cm, two walls, a square trap in the middle.

    Pickets start ``mouth_m`` before the arena's edge, the observer as far behind as it takes to see them all. ``start``
    (x, y, yaw) places the first observer elsewhere. ``goal`` is (x, y, radius).
    """

    __pydantic_config__ = STRICT
    kind: Literal["arena"] = "arena"
    size_m: tuple[float, float] = (0.75, 0.60)
    walls: tuple[Side, ...] = ("far", "left")
    wall_height_m: float = 0.30
    kerb_height_m: float = 0.04
    trap_centre_m: tuple[float, float] = (0.375, 0.30)
    trap_size_m: tuple[float, float] = (0.15, 0.15)
    goal: tuple[float, float, float] = (0.62, 0.30, 0.08)
    start: tuple[float, float, float] | None = None
    mouth_m: float = 0.05
    behind_m: float = 0.20
    cell_m: float = 0.01

    def __post_init__(self) -> None:
        _require_floor(self.size_m, self.cell_m, self.wall_height_m, self.kerb_height_m)
        require(min(self.trap_size_m) >= 0, "environment.geometry.trap_size_m", self.trap_size_m, "0 m or more")
        require(self.goal[2] > 0, "environment.geometry.goal", self.goal, "a radius above 0 m")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """The arena; nothing in it is random."""
        del rng
        half = (self.trap_size_m[0] / 2, self.trap_size_m[1] / 2)
        trap = Hazard("trap", self.trap_centre_m, half)
        return _arena(self, team, self.size_m, self.walls, (), (trap,) if min(half) > 0 else (), self.goal)


@dataclass(frozen=True)
class RandomArenaGeometry:
    """Arenas drawn anew for each index: each pair is a range (least, most).

    ``outer_walls`` counts walled sides, ``inner_walls`` pieces of wall inside. ``hazard_size_m`` is a hazard's width.
    A safe path of the observer from start to goal, ``margin_m`` wider than itself, always exists.
    """

    __pydantic_config__ = STRICT
    kind: Literal["random_arena"] = "random_arena"
    size_x_m: tuple[float, float] = (0.75, 1.5)
    size_y_m: tuple[float, float] = (0.6, 1.2)
    outer_walls: tuple[int, int] = (0, 3)
    inner_walls: tuple[int, int] = (0, 2)
    inner_wall_length_m: tuple[float, float] = (0.15, 0.35)
    hazards: tuple[int, int] = (1, 4)
    hazard_size_m: tuple[float, float] = (0.08, 0.2)
    hazard_kinds: tuple[HazardKind, ...] = ("trap", "hole", "slippery")
    wall_height_m: float = 0.30
    kerb_height_m: float = 0.04
    goal_radius_m: float = 0.08
    margin_m: float = 0.03
    mouth_m: float = 0.05
    behind_m: float = 0.20
    cell_m: float = 0.01

    def __post_init__(self) -> None:
        ranges = "size_x_m size_y_m outer_walls inner_walls inner_wall_length_m hazards hazard_size_m"
        for name in ranges.split():
            least, most = getattr(self, name)
            require(0 <= least <= most, f"environment.geometry.{name}", (least, most), "(least, most), 0 or more")
        require(self.outer_walls[1] <= 3, "environment.geometry.outer_walls", self.outer_walls, "at most 3 sides")
        require(bool(self.hazard_kinds), "environment.geometry.hazard_kinds", self.hazard_kinds, "at least one kind")
        _require_floor((self.size_x_m[0], self.size_y_m[0]), self.cell_m, self.wall_height_m, self.kerb_height_m)
        require(self.goal_radius_m > 0, "environment.geometry.goal_radius_m", self.goal_radius_m, "more than 0 m")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """An arena drawn from ``rng``, again and again until its starts are clear and a safe path exists.

        Raises: `WorldError` when none of many draws will do.
        """
        observer = team[0]
        for _ in range(ATTEMPTS):
            world = self._draw(team, rng)
            try:
                check_placement(world, team)
            except CoopError:
                continue
            if safe_path_exists(
                world, observer.body_radius_m, observer.contact_radius_m, observer.max_step_m, self.margin_m
            ):
                return world
        expected = f"room for a safe path: none in {ATTEMPTS} draws, so fewer or smaller hazards and walls"
        raise WorldError("environment.geometry.hazards", (self.hazards, self.hazard_size_m), expected)

    def _draw(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        size = (_length(rng, self.size_x_m, self.cell_m), _length(rng, self.size_y_m, self.cell_m))
        walls = tuple(str(side) for side in rng.permutation(SIDES)[: rng.integers(*self.outer_walls, endpoint=True)])
        blocks = tuple(self._block(size, rng) for _ in range(rng.integers(*self.inner_walls, endpoint=True)))
        hazards = tuple(self._hazard(size, rng) for _ in range(rng.integers(*self.hazards, endpoint=True)))
        low, high = np.array([0.6 * size[0], 0.15]), np.array([size[0] - 0.12, size[1] - 0.15])
        x, y = rng.uniform(np.minimum(low, high), high)
        return _arena(self, team, size, walls, blocks, hazards, (float(x), float(y), self.goal_radius_m))

    def _block(self, size_m: tuple[float, float], rng: np.random.Generator) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max of a piece of wall."""
        half = np.array([rng.uniform(*self.inner_wall_length_m) / 2, 0.02])
        half = half[::-1] if rng.random() < 0.5 else half
        centre = rng.uniform((0.15, 0.0), size_m)
        x_min, y_min, x_max, y_max = (*(centre - half), *(centre + half))
        return max(x_min, 0.1), max(y_min, 0.0), min(x_max, size_m[0]), min(y_max, size_m[1])

    def _hazard(self, size_m: tuple[float, float], rng: np.random.Generator) -> Hazard:
        """A rectangle at any angle or a disc, in the arena and clear of the bay."""
        kind = self.hazard_kinds[rng.integers(len(self.hazard_kinds))]
        a, b = (rng.uniform(*self.hazard_size_m, size=2) / 2).tolist()
        x, y = rng.uniform((0.1 + max(a, b), 0.0), size_m).tolist()
        if rng.random() < 0.5:
            return Hazard(kind, (x, y), radius_m=a)
        return Hazard(kind, (x, y), (a, b), yaw_rad=rng.uniform(0, np.pi))


def _arena(
    geometry: ArenaGeometry | RandomArenaGeometry,
    team: Sequence[Footprint],
    size_m: tuple[float, float],
    walls: Sequence[str],
    blocks: Sequence[tuple[float, float, float, float]],
    hazards: tuple[Hazard, ...],
    goal: Pose,
) -> World:
    formation = Formation()
    middle = size_m[1] / 2
    anchor = (-geometry.mouth_m - formation_length_m(team, formation), middle, 0.0)
    depth = geometry.behind_m - anchor[0]
    start = getattr(geometry, "start", None) or anchor
    ground = _floor(geometry, size_m, depth, walls, blocks)
    starts, dock = formation_poses(team, start, formation)
    return World(geometry.kind, ground, None, hazards, starts, dock, goal)


def _floor(
    geometry: ArenaGeometry | RandomArenaGeometry,
    size_m: tuple[float, float],
    depth_m: float,
    walls: Sequence[str],
    blocks: Sequence[tuple[float, float, float, float]],
) -> HeightField:
    """Kerb height everywhere, the floor of arena and bay cut out of it, then walls raised."""
    cell, epsilon = geometry.cell_m, geometry.cell_m / 100
    edge = round(BORDER_M / cell) * cell
    origin = (-round(depth_m / cell) * cell - edge, -edge)
    shape = [round((size_m[k] + edge - origin[k]) / cell) + 1 for k in (0, 1)]
    x, y = (origin[k] + cell * np.arange(shape[k]) for k in (0, 1))
    x, y = np.meshgrid(x, y, indexing="ij")
    heights = np.full(shape, geometry.kerb_height_m, dtype=np.float32)
    inside = (x > -depth_m + epsilon) & (x < size_m[0] - epsilon) & (y > epsilon) & (y < size_m[1] - epsilon)
    heights[inside] = 0.0
    beyond = {"far": x >= size_m[0] - epsilon, "left": y >= size_m[1] - epsilon, "right": y <= epsilon}
    for side in walls:
        heights[beyond[side] & (x >= -epsilon)] = geometry.wall_height_m
    for x_min, y_min, x_max, y_max in blocks:
        block = (x >= x_min - epsilon) & (x <= x_max + epsilon) & (y >= y_min - epsilon) & (y <= y_max + epsilon)
        heights[block] = geometry.wall_height_m
    return HeightField(heights, origin, cell)


def _length(rng: np.random.Generator, bounds_m: tuple[float, float], cell_m: float) -> float:
    return round(rng.uniform(*bounds_m) / cell_m) * cell_m


def _require_floor(size_m: tuple[float, float], cell_m: float, wall_m: float, kerb_m: float) -> None:
    require(min(size_m) >= 0.3, "environment.geometry.size_m", size_m, "0.3 m or more each way")
    require(max(size_m) <= 50, "environment.geometry.size_m", size_m, "at most 50 m each way")
    require(0.001 <= cell_m <= 0.025, "environment.geometry.cell_m", cell_m, "0.001 to 0.025 m")
    require(0 < kerb_m <= wall_m, "environment.geometry.kerb_height_m", kerb_m, "above 0, at most wall_height_m")

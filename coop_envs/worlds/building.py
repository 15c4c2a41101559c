"""Rooms on both sides of corridors, joined by doors, drawn anew for each index: single-valued ground."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from coop_envs.errors import WorldError, require
from coop_envs.validation import STRICT
from coop_envs.worlds.placement import Footprint, formation_poses
from coop_envs.worlds.siting import Traps, require_traps, sited, with_traps
from coop_envs.worlds.world import HeightField, World

Size = Literal["small", "medium", "large"]
Box = tuple[float, float, float, float]
CORRIDORS = {"small": 1, "medium": 1, "large": 2}
LENGTH_M = {"small": (4.0, 5.0), "medium": (7.0, 9.0), "large": (11.0, 13.0)}
ROW_DEPTH_M = (1.6, 2.4)
ATTEMPTS = 20


@dataclass(frozen=True)
class BuildingGeometry:
    """One storey: ``small`` has one row of rooms along a corridor, ``medium`` two, ``large`` two corridors with a row
    on each of their sides and a passage between them. Each pair is a range (least, most).

    Every room has a door to its corridor, some to the next room as well, and ``furniture`` is the share of rooms with a
    piece of it in a corner. ``hazards`` hidden traps are laid out on reachable ground, a walk of ``hazard_distance_m``
    from the start, which has the longest view. ``start`` (x, y, yaw) puts the first observer elsewhere.
    """

    __pydantic_config__ = STRICT
    kind: Literal["building"] = "building"
    size: Size = "medium"
    room_m: tuple[float, float] = (1.5, 2.6)
    corridor_m: tuple[float, float] = (0.9, 1.3)
    door_m: tuple[float, float] = (0.5, 0.7)
    wall_m: float = 0.1
    wall_height_m: float = 0.5
    second_doors: float = 0.3
    furniture: float = 0.6
    hazards: int = 4
    hazard_radius_m: tuple[float, float] = (0.1, 0.2)
    hazard_distance_m: tuple[float, float] = (1.0, 10.0)
    start: tuple[float, float, float] | None = None
    goal: tuple[float, float, float] | None = None
    cell_m: float = 0.025

    def __post_init__(self) -> None:
        for name, smallest in (("room_m", 0.8), ("corridor_m", 0.4), ("door_m", 0.2)):
            least, most = getattr(self, name)
            fits = smallest <= least <= most <= 10
            require(fits, f"environment.geometry.{name}", (least, most), f"(least, most) within {smallest} to 10 m")
        narrow = self.door_m[1] <= self.room_m[0] - 0.2
        require(narrow, "environment.geometry.door_m", self.door_m, "0.2 m or more less than the narrowest room")
        require(0.05 <= self.wall_m <= 1, "environment.geometry.wall_m", self.wall_m, "0.05 to 1 m")
        require(self.wall_height_m > 0, "environment.geometry.wall_height_m", self.wall_height_m, "more than 0 m")
        for name in ("second_doors", "furniture"):
            share = getattr(self, name)
            require(0 <= share <= 1, f"environment.geometry.{name}", share, "a share, 0 to 1")
        require_traps(self.hazards, self.hazard_radius_m, self.hazard_distance_m)
        require(0.005 <= self.cell_m <= 0.025, "environment.geometry.cell_m", self.cell_m, "0.005 to 0.025 m")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """A building drawn from ``rng``, again until the team fits.

        Raises: `WorldError` when none of some draws will do.
        """
        refusal: WorldError | None = None
        for _ in range(ATTEMPTS):
            ground = self._ground(rng)
            try:
                start, formation = sited(ground, team, "environment.geometry.room_m", self.room_m)
            except WorldError as error:
                refusal = error
                continue
            starts, dock = formation_poses(team, self.start or start, formation)
            world = World(f"building_{self.size}", ground, None, (), starts, dock, self.goal)
            return with_traps(world, team, Traps(self.hazards, self.hazard_radius_m, self.hazard_distance_m), rng)
        assert refusal is not None
        raise refusal

    def _ground(self, rng: np.random.Generator) -> HeightField:
        """Walls everywhere, rooms, corridors and doors cut out of them, furniture put back."""
        length = rng.uniform(*LENGTH_M[self.size])
        floors, furniture, depth = self._plan(length, rng)
        wall, cell = self.wall_m, self.cell_m
        nodes = [round((side + 2 * wall) / cell) + 1 for side in (length, depth)]
        first = -round(wall / cell)
        x, y = (cell * (first + np.arange(n)) for n in nodes)
        heights = np.full(nodes, self.wall_height_m, dtype=np.float32)
        for boxes, height in ((floors, 0.0), (furniture, 0.6 * self.wall_height_m)):
            for x0, y0, x1, y1 in boxes:
                inside = [
                    slice(*np.searchsorted(axis, (a - 1e-6, b + 1e-6))) for axis, a, b in ((x, x0, x1), (y, y0, y1))
                ]
                heights[inside[0], inside[1]] = height
        return HeightField(heights, (float(x[0]), float(y[0])), cell)

    def _plan(self, length_m: float, rng: np.random.Generator) -> tuple[list[Box], list[Box], float]:
        """Floors and furniture (x_min, y_min, x_max, y_max) of a building this long, and its depth."""
        wall, y = self.wall_m, 0.0
        passage = self._passage(length_m, rng)
        floors: list[Box] = []
        furniture: list[Box] = []
        corridors: list[tuple[float, float]] = []
        for k in range(CORRIDORS[self.size]):
            below, above = rng.uniform(*ROW_DEPTH_M, size=2)
            width = rng.uniform(*self.corridor_m)
            corridor = y + below + wall
            top = corridor + width
            gaps = (passage if k > 0 else None, passage if k + 1 < CORRIDORS[self.size] else None)
            rows = [(y, y + below, corridor, gaps[0])]
            if self.size != "small":
                rows.append((top + wall, top + wall + above, top, gaps[1]))
            for low, high, side, gap in rows:
                new = self._row(low, high, side, length_m, gap, rng)
                floors += new[0]
                furniture += new[1]
            floors.append((0.0, corridor, length_m, top))
            corridors.append((corridor, top))
            y = rows[-1][1] + wall if len(rows) > 1 else top + wall
        if passage:
            floors.append((passage[0], corridors[0][1], passage[1], corridors[1][0]))
        return floors, furniture, y - wall

    def _passage(self, length_m: float, rng: np.random.Generator) -> tuple[float, float] | None:
        """x of the passage between two corridors, None where there is one corridor."""
        if CORRIDORS[self.size] < 2:
            return None
        width, margin = rng.uniform(*self.corridor_m), self.room_m[0] + self.wall_m
        left = rng.uniform(margin, max(length_m - margin - width, margin))
        return left, left + width

    def _row(
        self, low: float, high: float, side: float, length_m: float, gap: tuple[float, float] | None,
        rng: np.random.Generator,
    ) -> tuple[list[Box], list[Box]]:  # fmt: skip
        """Rooms between y ``low`` and ``high`` with doors to the corridor whose near side is ``side``."""
        ends = [(0.0, length_m)] if gap is None else [(0.0, gap[0] - self.wall_m), (gap[1] + self.wall_m, length_m)]
        floors: list[Box] = []
        furniture: list[Box] = []
        for left, right in ends:
            rooms = list(self._rooms(left, right, rng))
            for k, (x0, x1) in enumerate(rooms):
                width = min(rng.uniform(*self.door_m), x1 - x0 - 0.2)
                at = rng.uniform(x0 + 0.1, x1 - 0.1 - width)
                floors += [(x0, low, x1, high), (at, min(side, high), at + width, max(side, low))]
                if k + 1 < len(rooms) and rng.random() < self.second_doors:
                    y0 = rng.uniform(low + 0.1, max(high - 0.1 - width, low + 0.1))
                    floors.append((x1, y0, x1 + self.wall_m, y0 + width))
                if rng.random() < self.furniture:
                    furniture.append(self._piece((x0, low, x1, high), side > high, rng))
        return floors, furniture

    def _rooms(self, left: float, right: float, rng: np.random.Generator) -> Iterator[tuple[float, float]]:
        """x of rooms side by side, walls between them, that fill a length."""
        widest = right - left
        number = max(int((widest + self.wall_m) / (rng.uniform(*self.room_m) + self.wall_m)), 1)
        shares = rng.uniform(1.0, self.room_m[1] / self.room_m[0], size=number)
        widths = shares / shares.sum() * (widest - (number - 1) * self.wall_m)
        x = left
        for width in widths:
            yield x, x + width
            x += width + self.wall_m

    def _piece(self, room: Box, corridor_above: bool, rng: np.random.Generator) -> Box:
        """A piece of furniture in one of the two corners away from the corridor."""
        x0, y0, x1, y1 = room
        along, deep = rng.uniform(0.3, 0.6), rng.uniform(0.25, 0.4)
        left = x0 if rng.random() < 0.5 else x1 - along
        bottom = y0 if corridor_above else y1 - deep
        return left, bottom, left + along, bottom + deep

"""Rolling hills strewn with concrete pillars and slabs, drawn anew for each index: thesis Fig 6.4.

Slabs that lean on pillars or lie on blocks like bridges leave room below: robots and rays pass under them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from coop_envs.errors import WorldError, require
from coop_envs.validation import STRICT
from coop_envs.worlds.bodies import block, ground_mesh, merged, turned
from coop_envs.worlds.placement import Footprint, formation_poses
from coop_envs.worlds.raster import heights_at, lowest_ground
from coop_envs.worlds.siting import Traps, require_traps, sited, with_traps
from coop_envs.worlds.truth import clearance_m, connected, nearest_node, passable_ground
from coop_envs.worlds.world import HeightField, Mesh, World

ATTEMPTS = 20
TRIES = 60
FACET_M = 0.05
GAP_M = 0.35
EDGE_GAP_M = 0.1
SUNK_M = 0.1
LEAST_REACH = 0.5
Kind = Literal["pillar", "slab", "leaning", "bridge"]
RADIUS_M: dict[Kind, float] = {"bridge": 0.65, "leaning": 0.6, "slab": 0.5, "pillar": 0.2}


@dataclass(frozen=True)
class RubbleGeometry:
    """Hills of ``relief_m`` from lowest to highest, nowhere steeper than ``steepest``, with numbers (least, most) of
    upright ``pillars``, ``slabs`` lying on the ground, slabs ``leaning`` on a pillar, and ``bridges`` of a slab on two
    blocks. Bodies stand 0.35 m or more apart; robots pass under what leaves them ``headroom_m``.

    Half of the ground or more can be reached from the start, which has the longest view. ``hazards`` hidden traps are
    laid out on it, a walk of ``hazard_distance_m`` (least, most) from the start. ``start`` (x, y, yaw) puts the first
    observer elsewhere. The figure gives no lengths: all are assumed, for robots 15 cm high.
    """

    __pydantic_config__ = STRICT
    kind: Literal["rubble"] = "rubble"
    size_m: tuple[float, float] = (5.0, 5.0)
    relief_m: float = 0.3
    steepest: float = 0.2
    pillars: tuple[int, int] = (4, 8)
    slabs: tuple[int, int] = (3, 5)
    leaning: tuple[int, int] = (1, 3)
    bridges: tuple[int, int] = (1, 2)
    headroom_m: float = 0.18
    hazards: int = 4
    hazard_radius_m: tuple[float, float] = (0.1, 0.2)
    hazard_distance_m: tuple[float, float] = (0.8, 6.0)
    start: tuple[float, float, float] | None = None
    goal: tuple[float, float, float] | None = None
    cell_m: float = 0.025

    def __post_init__(self) -> None:
        fits = min(self.size_m) >= 1.5 and max(self.size_m) <= 50
        require(fits, "environment.geometry.size_m", self.size_m, "1.5 to 50 m each way")
        require(0 <= self.relief_m <= 5, "environment.geometry.relief_m", self.relief_m, "0 to 5 m")
        require(0 <= self.steepest <= 1, "environment.geometry.steepest", self.steepest, "a slope, 0 to 1")
        for name in ("pillars", "slabs", "leaning", "bridges"):
            least, most = getattr(self, name)
            require(0 <= least <= most, f"environment.geometry.{name}", (least, most), "(least, most), 0 or more")
        require(0.05 <= self.headroom_m <= 0.2, "environment.geometry.headroom_m", self.headroom_m, "0.05 to 0.2 m")
        require_traps(self.hazards, self.hazard_radius_m, self.hazard_distance_m)
        halves = math.isclose(FACET_M / self.cell_m, round(FACET_M / self.cell_m))
        require(halves, "environment.geometry.cell_m", self.cell_m, "0.05 m divided by a whole number")
        require(0.005 <= self.cell_m <= 0.025, "environment.geometry.cell_m", self.cell_m, "0.005 to 0.025 m")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """Rubble drawn from ``rng``, again until the team has a start and room to go.

        Raises: `WorldError` when none of some draws will do.
        """
        for _ in range(ATTEMPTS):
            mesh, ground = self._draw(rng)
            try:
                start, formation = sited(ground, team, "environment.geometry.size_m", self.size_m)
            except WorldError:
                continue
            starts, dock = formation_poses(team, self.start or start, formation)
            world = World("rubble", ground, mesh, (), starts, dock, self.goal)
            if reach(world, team) >= LEAST_REACH:
                return with_traps(world, team, Traps(self.hazards, self.hazard_radius_m, self.hazard_distance_m), rng)
        expected = f"room for the team: none in {ATTEMPTS} draws, so a larger size or fewer bodies"
        raise WorldError("environment.geometry.size_m", self.size_m, expected)

    def _draw(self, rng: np.random.Generator) -> tuple[Mesh | None, HeightField]:
        hills = _hills(self.size_m, self.relief_m, self.steepest, rng)
        numbers: dict[Kind, tuple[int, int]] = {
            "bridge": self.bridges,
            "leaning": self.leaning,
            "slab": self.slabs,
            "pillar": self.pillars,
        }
        kinds: list[Kind] = [k for k, bounds in numbers.items() for _ in range(rng.integers(*bounds, endpoint=True))]
        bodies = [body for kind, at in _places(kinds, self.size_m, rng) for body in _body(kind, at, hills, rng)]
        mesh = merged([ground_mesh(hills), *bodies])
        ground = lowest_ground(mesh, self.cell_m, self.headroom_m)
        overhangs = any(kind in ("bridge", "leaning") for kind in kinds)
        return (mesh if overhangs else None), ground


def reach(world: World, team: Sequence[Footprint]) -> float:
    """Share of the world's area where the widest robot can get to from the start."""
    floor = passable_ground(world.ground, world.starts[0][:2], min(robot.max_step_m for robot in team))
    clear = clearance_m(floor, world.ground.cell_m) >= max(robot.body_radius_m for robot in team)
    return float(connected(clear, nearest_node(world.ground, world.starts[0][:2])).mean())


def _hills(size_m: tuple[float, float], relief_m: float, steepest: float, rng: np.random.Generator) -> HeightField:
    """Hills from 0 up, on facets of 5 cm: a sum of bells half a metre to a metre wide."""
    nodes = [round(size / FACET_M) + 1 for size in size_m]
    x, y = np.meshgrid(*(FACET_M * np.arange(n) for n in nodes), indexing="ij")
    heights = np.zeros(nodes)
    for _ in range(max(round(1.2 * size_m[0] * size_m[1]), 4)):
        at_x, at_y = rng.uniform((-0.5, -0.5), np.add(size_m, 0.5))
        spread, height = rng.uniform(0.4, 0.9), rng.normal()
        heights += height * np.exp(-((x - at_x) ** 2 + (y - at_y) ** 2) / (2 * spread**2))
    slope = np.linalg.norm(np.gradient(heights, FACET_M), axis=0).max()
    heights = (heights - heights.min()) * min(relief_m / np.ptp(heights), steepest / slope)
    return HeightField(heights.astype(np.float32), (0.0, 0.0), FACET_M)


def _places(
    kinds: Sequence[Kind], size_m: tuple[float, float], rng: np.random.Generator
) -> list[tuple[Kind, tuple[float, float]]]:
    """Centres of bodies, so far from one another that robots pass between; what finds no place is left out."""
    placed: list[tuple[Kind, tuple[float, float]]] = []
    for kind in kinds:
        margin = RADIUS_M[kind] + EDGE_GAP_M
        for _ in range(TRIES):
            x, y = (float(rng.uniform(margin, max(size - margin, margin))) for size in size_m)
            if all(math.dist((x, y), at) >= RADIUS_M[kind] + RADIUS_M[other] + GAP_M for other, at in placed):
                placed.append((kind, (x, y)))
                break
    return placed


def _body(kind: Kind, at: tuple[float, float], hills: HeightField, rng: np.random.Generator) -> list[Mesh]:
    return {"pillar": _pillar, "slab": _slab, "leaning": _leaning, "bridge": _bridge}[kind](at, hills, rng)


def _pillar(at: tuple[float, float], hills: HeightField, rng: np.random.Generator) -> list[Mesh]:
    """A square pillar, a little out of plumb."""
    width, height = rng.uniform(0.15, 0.25), rng.uniform(0.4, 0.8)
    R = turned(rng.uniform(0, np.pi), rng.uniform(-0.08, 0.08), rng.uniform(-0.08, 0.08))
    return [block((width, width, height + SUNK_M), (*at, _level(hills, at) + (height - SUNK_M) / 2), R)]


def _slab(at: tuple[float, float], hills: HeightField, rng: np.random.Generator) -> list[Mesh]:
    """A slab that lies as the ground slopes, half sunk in it."""
    size = (rng.uniform(0.5, 0.85), rng.uniform(0.3, 0.5), rng.uniform(0.12, 0.24))
    yaw = rng.uniform(0, 2 * np.pi)
    pitch, roll = _slopes(hills, at, yaw)
    return [block(size, (*at, _level(hills, at)), turned(yaw, pitch, -roll))]


def _leaning(at: tuple[float, float], hills: HeightField, rng: np.random.Generator) -> list[Mesh]:
    """A slab too steep to climb, its foot on the ground and its head on a pillar that stands back under it."""
    yaw, pitch = rng.uniform(0, 2 * np.pi), rng.uniform(0.75, 0.95)
    length, width, thickness = rng.uniform(0.9, 1.1), rng.uniform(0.5, 0.7), rng.uniform(0.04, 0.06)
    run = length * math.cos(pitch)
    foot, head = _along(at, yaw, -run / 2), _along(at, yaw, run / 2)
    rise = length * math.sin(pitch)
    centre = (*at, _level(hills, foot) - 0.02 + rise / 2)
    support = _along(head, yaw, -0.1)
    top = _level(hills, foot) - 0.02 + rise - 0.16 * math.tan(pitch)
    bottom = _level(hills, support) - SUNK_M
    pillar = block((0.12, 0.2, top - bottom), (*support, (top + bottom) / 2), turned(yaw))
    return [block((length, width, thickness), centre, turned(yaw, pitch)), pillar]


def _bridge(at: tuple[float, float], hills: HeightField, rng: np.random.Generator) -> list[Mesh]:
    """A slab on two blocks, high enough to drive under."""
    yaw = rng.uniform(0, 2 * np.pi)
    length, width, thickness = rng.uniform(0.9, 1.15), rng.uniform(0.4, 0.6), rng.uniform(0.04, 0.06)
    height, bearing = rng.uniform(0.24, 0.32), 0.16
    ends = [_along(at, yaw, side * (length - bearing) / 2) for side in (-1, 1)]
    highest = max(_level(hills, _along(at, yaw, share * length / 2)) for share in np.linspace(-1, 1, 9))
    tilt = rng.uniform(-0.08, 0.08)
    tops = [highest + height + side * tilt * length / 2 for side in (-1, 1)]
    bodies = [block((length, width, thickness), (*at, sum(tops) / 2 + thickness / 2), turned(yaw, math.atan(tilt)))]
    for end, top in zip(ends, tops, strict=True):
        bottom = _level(hills, end) - SUNK_M
        bodies.append(block((bearing, 0.9 * width, top - bottom), (*end, (top + bottom) / 2), turned(yaw)))
    return bodies


def _along(at: tuple[float, float], yaw_rad: float, distance_m: float) -> tuple[float, float]:
    return at[0] + distance_m * math.cos(yaw_rad), at[1] + distance_m * math.sin(yaw_rad)


def _level(hills: HeightField, at: tuple[float, float]) -> float:
    """Height of the hills at a point, at their edge beyond it."""
    x0, y0, x1, y1 = hills.bounds_m
    x, y = min(max(at[0], x0), x1), min(max(at[1], y0), y1)
    return float(heights_at(hills, np.array([x]), np.array([y]))[0])


def _slopes(hills: HeightField, at: tuple[float, float], yaw_rad: float) -> tuple[float, float]:
    """Angles by which the ground rises ahead and to the left."""
    ahead, left = (
        (_level(hills, _along(at, yaw, 0.2)) - _level(hills, _along(at, yaw, -0.2))) / 0.4
        for yaw in (yaw_rad, yaw_rad + np.pi / 2)
    )
    return math.atan(ahead), -math.atan(left)

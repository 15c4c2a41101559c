"""Which rasters are worth drawing: those whose rays should measure ground that two cameras see and nobody has tried.

The ground is taken as level; a ray ends at the first known obstacle. Robots are low, cameras a little higher: the line
from a camera to a spot on the ground shows the lower half of what a robot would fill to be free on its last part, the
upper half on the part before. What was aimed at counts as tried, whether points came back or not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from baselines.common_view import LEAST_PARALLAX, SIGHT_STEP_M, SPOT_RANGE_M, Sector, Walls, hidden, parallax, views
from baselines.driving import Scan
from baselines.team_view import RobotView
from coop_envs.agents.raster import raster_axes
from coop_envs.agents.specification import Laser
from coop_envs.agents.team import Member
from coop_envs.mapping.planning import BeliefGrid, Mask, Points

SHARE = 0.2  # of the full raster's width, in one tile
ELEVATIONS_RAD = (-0.11, -0.23, -0.35)
SKY_RAD = 0.02  # less below the horizon than this, a ray meets walls only
TOLD = ((0.4, 0.5, 0.6, 0.67), (0.72, 0.8, 0.9, 1.0))  # parts of a line of sight that tell of upper and lower half
FADE = 0.3  # what trying again is worth, each time
POINTS_S, START_S, MIRROR_RAD_S = 30.0, 0.4, 1.0

Square = tuple[int, int, int]


@dataclass
class Tries:
    """How often each spot of ground was aimed at, by squares (i, j) of the team frame in upper and lower halves."""

    side_m: float = 0.1
    counts: dict[Square, float] = field(default_factory=dict)

    def squares(self, points: Points, half: int) -> list[Square]:
        """One half of the square that each of some points (k, 2) lies in."""
        return [(i, j, half) for i, j in np.floor(points / self.side_m).astype(int).tolist()]

    def around(self, point: tuple[float, float], radius_m: float) -> frozenset[Square]:
        """Both halves of the squares within a radius of a point."""
        steps = np.arange(-radius_m, radius_m + 1e-9, 0.5 * self.side_m)
        disc = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        near = np.array(point) + disc[np.hypot(*disc.T) <= radius_m]
        return frozenset(self.squares(near, 0) + self.squares(near, 1))

    def add(self, squares: frozenset[Square], share: float) -> None:
        """Count halves of squares as aimed at."""
        for square in squares:
            self.counts[square] = self.counts.get(square, 0.0) + share

    def forget(self) -> None:
        """Give everything another chance."""
        self.counts.clear()

    def area_m2(self, squares: frozenset[Square]) -> float:
        """What measuring these halves of squares would still be worth."""
        return 0.5 * self.side_m**2 * sum(FADE ** self.counts.get(square, 0.0) for square in squares)

    def worth(self, points: Points) -> NDArray[np.float64]:
        """What measuring points (k, 2) would still be worth, 1 where nobody has tried."""
        halves = [[self.counts.get(square, 0.0) for square in self.squares(points, half)] for half in (0, 1)]
        return np.float64(FADE) ** np.min(np.array(halves).reshape(2, -1), axis=0)


@dataclass(frozen=True)
class Watcher:
    """A robot that stands, its equipment, and its camera's sector."""

    robot: RobotView
    member: Member
    sector: Sector


@dataclass(frozen=True)
class Tile:
    """A raster of one robot, the halves of squares that it should tell of, and how long it takes to draw."""

    name: str
    scan: Scan
    squares: frozenset[Square]
    draw_s: float

    def time_s(self, last: Tile | None) -> float:
        """How long it takes, after another one."""
        if last is None or last.name != self.name:
            return self.draw_s
        a, b = self.scan, last.scan
        way = max(abs(a.azimuth_rad - b.azimuth_rad), abs(a.elevation_rad - b.elevation_rad))
        return self.draw_s + way / MIRROR_RAD_S


def tiles_of(watcher: Watcher, watchers: list[Watcher], grid: BeliefGrid, tries: Tries) -> list[Tile]:
    """All rasters of a robot from which something is to be hoped; none without a laser."""
    laser = watcher.member.laser
    if laser is None:
        return []
    width = SHARE * laser.raster_half_rad[0]
    steps = int((laser.max_deflection_rad - width) / (2.0 * width))
    scans = [Scan(SHARE, 2.0 * width * k, elevation) for k in range(-steps, steps + 1) for elevation in ELEVATIONS_RAD]
    rays = [fan(laser, scan) for scan in scans]
    landed, lands = landing(watcher, np.concatenate(rays), grid)
    used = in_common_view(landed, watchers, grid) & lands
    tiles, first = [], 0
    for scan, directions in zip(scans, rays, strict=True):
        part = slice(first, first + len(directions))
        first += len(directions)
        squares = frozenset(_told(landed[part], used[:, part], watchers, tries))
        if squares:
            tiles.append(Tile(watcher.robot.name, scan, squares, START_S + len(directions) / POINTS_S))
    return tiles


def in_common_view(points: Points, watchers: list[Watcher], grid: BeliefGrid) -> Mask:
    """Whether (n, k) each of n cameras sees points (k, 2) that another one sees from another direction, too."""
    stands = np.array([watcher.robot.xy for watcher in watchers])
    seen = np.array([_sees(watcher, points, grid) for watcher in watchers])
    used = np.zeros_like(seen)
    for i in range(len(watchers)):
        for j in range(i):
            both = seen[i] & seen[j] & (parallax(stands[i : i + 1], stands[j], points)[0] > LEAST_PARALLAX)
            used[i] |= both
            used[j] |= both
    return used


def best_tile(tiles: list[Tile], tries: Tries, last: Tile | None) -> tuple[Tile | None, float]:
    """The tile that promises most ground for its time, and how much (m^2/s)."""
    rates = [tries.area_m2(tile.squares) / tile.time_s(last) for tile in tiles]
    if not rates:
        return None, 0.0
    best = int(np.argmax(rates))
    return tiles[best], rates[best]


def _told(points: Points, used: Mask, watchers: list[Watcher], tries: Tries) -> Iterator[Square]:
    """The halves of squares that lines of sight from cameras to points (k, 2) tell of, where used (n, k)."""
    for watcher, mask in zip(watchers, used, strict=True):
        eye = np.array(watcher.robot.xy)
        for half, parts in enumerate(TOLD):
            places = eye + np.array(parts)[:, None, None] * (points[mask] - eye)
            yield from tries.squares(places.reshape(-1, 2), half)


def fan(laser: Laser, scan: Scan) -> NDArray[np.float64]:
    """Directions (k, 2) of a raster's points, left and up of the robot's heading."""
    left, up = np.meshgrid(*(laser.count_rad * axis for axis in raster_axes(laser, scan.share)))
    return np.column_stack([scan.azimuth_rad + left.ravel(), scan.elevation_rad + up.ravel()]).astype(np.float64)


def landing(watcher: Watcher, rays: NDArray[np.float64], grid: BeliefGrid) -> tuple[Points, Mask]:
    """Where (k, 2) rays (k, 2) land on level ground, or at known obstacles before it; and which (k,) land at all."""
    robot, laser = watcher.robot, watcher.member.laser
    assert laser is not None
    left, up = rays.T
    height_m = watcher.member.robot.body_height_m + laser.position_m[2]
    reach_m = np.minimum(height_m / np.tan(np.maximum(-up, SKY_RAD)), 1.1 * SPOT_RANGE_M)
    ahead = np.stack([np.cos(robot.yaw + left), np.sin(robot.yaw + left)], axis=-1)
    fractions = np.linspace(0.0, 1.0, math.ceil(float(reach_m.max()) / SIGHT_STEP_M) + 1)
    samples = np.array(robot.xy) + (fractions[:, None] * reach_m)[..., None] * ahead
    stopped = Walls(grid).at(samples)
    known_wall = stopped.any(axis=0)
    last = np.where(known_wall, np.argmax(stopped, axis=0), len(fractions) - 1)
    return samples[last, np.arange(len(rays))], known_wall | (-up > SKY_RAD)


def _sees(watcher: Watcher, points: Points, grid: BeliefGrid) -> Mask:
    stand = np.array([watcher.robot.xy])
    return views(watcher.sector, stand, np.array([watcher.robot.yaw]), points)[0, 0] & ~hidden(grid, stand, points)[0]

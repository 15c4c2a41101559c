"""The authors' trip of figs. 6.2 and 6.7: scan, move robot 0, scan, move robot 1, scan; poses, raster, timing, energy.

Where the spots lie comes from outside (`SpotSource`); `plane_spots` puts them on a floor and a wall, for the authors'
scene is not known.

Source: thesis sections 6.2.1, 6.2.2, 6.5; raster, timing and speeds from the authors' code.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.inchworm_poses import Scan, ScanPose, scan_sequence
from coop_envs.agents.power import segment_energy_j
from coop_envs.agents.specification import PowerModel
from coop_envs.errors import require

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Trip:
    """The trip's settings, the authors' by default; tangents are those of a ray's angles to its camera's axis."""

    scans: int = 3
    camera_height_m: float = 0.15
    left_to_right: tuple[float, float] = (-0.4, 0.05)
    down_to_up: tuple[float, float] = (-0.4, 0.4)
    step: float = 0.05
    dwell_s: float = 0.1
    travel_per_s: float = 1.0
    speed_m_s: float = 0.1
    yaw_rate_rad_s: float = 0.5
    marker_w: float = 0.224
    half_image: tuple[float, float] | None = None
    wall_x_m: float = 9.0

    def __post_init__(self) -> None:
        for name in ("camera_height_m", "step", "travel_per_s", "speed_m_s", "yaw_rate_rad_s"):
            require(getattr(self, name) > 0, f"trip.{name}", getattr(self, name), "more than 0")
        require(self.scans >= 1, "trip.scans", self.scans, "1 or more")


@dataclass(frozen=True)
class Spots:
    """What a scan saw: both cameras' centres (2, 3) and the points (n, 3), NaN where one of them saw no spot."""

    cameras: FloatArray
    points: FloatArray

    def rays(self, first: int = 0, last: int | None = None) -> tuple[FloatArray, FloatArray]:
        """Starts and ends (m, 3) of the rays to points ``first`` up to ``last``, two a point that was seen."""
        points = self.points[first:last]
        points = points[np.isfinite(points).all(axis=1)]
        return np.tile(self.cameras, (len(points), 1)), np.repeat(points, 2, axis=0)


SpotSource = Callable[[Scan, Trip], Spots]
"""The spots of one scan, in the raster's order."""


def scanner(scan: Scan) -> int:
    """Which robot's laser scans: the one that looks ahead along the way."""
    return int(np.argmin([abs(pose.heading_rad) for pose in scan.robots]))


def raster(trip: Trip, mirrored: bool = False) -> FloatArray:
    """Tangents (n, 2) of the rays to the right and up, column by column from left to right, up and down in turns.

    The second robot's raster is the first one's mirror image, so that both lean towards their mates.
    """
    right, up = (
        np.arange(low, high + 0.5 * trip.step, trip.step) for low, high in (trip.left_to_right, trip.down_to_up)
    )
    snake = np.array([up if k % 2 == 0 else up[::-1] for k in range(len(right))])
    return np.column_stack([np.repeat(right * (-1 if mirrored else 1), len(up)), snake.ravel()])


def camera(pose: ScanPose, trip: Trip) -> FloatArray:
    """Centre (3,) of a robot's camera."""
    return np.array([pose.x_m, pose.y_m, trip.camera_height_m])


def directions(pose: ScanPose, tangents: FloatArray) -> FloatArray:
    """Directions (n, 3), not of unit length, of rays with these tangents from a level camera."""
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    right, up = tangents.T
    return np.column_stack([c + s * right, s - c * right, up])


def in_image(pose: ScanPose, points: FloatArray, trip: Trip) -> NDArray[np.bool_]:
    """Which points lie within a camera's field of view; all of them if ``trip.half_image`` is not given."""
    if trip.half_image is None:
        return np.ones(len(points), dtype=bool)
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    seen = points - camera(pose, trip)
    ahead, left = seen @ [c, s, 0.0], seen @ [-s, c, 0.0]
    wide, high = trip.half_image
    return (ahead > 0) & (np.abs(left) <= wide * ahead) & (np.abs(seen[:, 2]) <= high * ahead)


def plane_spots(scan: Scan, trip: Trip) -> Spots:
    """Spots on the floor z = 0 and on the wall x = ``wall_x_m``, nothing between them and the cameras."""
    which = scanner(scan)
    pose = scan.robots[which]
    start, along = camera(pose, trip), directions(pose, raster(trip, mirrored=which == 1))
    with np.errstate(divide="ignore"):
        to_floor = np.where(along[:, 2] < 0, -start[2] / along[:, 2], np.inf)
        to_wall = np.where(along[:, 0] > 0, (trip.wall_x_m - start[0]) / along[:, 0], np.inf)
    points = start + along * np.minimum(to_floor, to_wall)[:, None]
    seen = np.logical_and(*(in_image(robot, points, trip) for robot in scan.robots))
    return Spots(np.array([camera(robot, trip) for robot in scan.robots]), np.where(seen[:, None], points, np.nan))


@dataclass(frozen=True)
class Segment:
    """A stretch of constant power: both robots' speeds (m/s, rad/s), each one's marker sum, scanner commands."""

    phase: str
    duration_s: float
    speeds: tuple[float, float] = (0.0, 0.0)
    yaw_rates: tuple[float, float] = (0.0, 0.0)
    markers: float = 0.0
    galvo: float = 0.0
    laser: float = 0.0


def scan_segments(label: str, trip: Trip, points: int) -> list[Segment]:
    """A scan: the mirror comes to rest, then for each point a dwell with the laser off, one with it on, and a move."""
    rest = Segment(label, trip.dwell_s)
    lit = Segment(label, trip.dwell_s, laser=1.0)
    move = Segment(label, trip.step / trip.travel_per_s, galvo=1.0)
    return [rest, *([rest, lit, move] * points)[:-1]]


def move_segments(label: str, before: Scan, after: Scan, trip: Trip, marker_sum: float) -> list[Segment]:
    """The move between two scans, markers lit: one robot drives straight, then both turn, one after the other."""
    moved = []
    for k, (a, b) in enumerate(zip(before.robots, after.robots, strict=True)):
        way = math.hypot(b.x_m - a.x_m, b.y_m - a.y_m)
        turn = abs(b.heading_rad - a.heading_rad)
        if way > 0:
            driving = _alone(k, trip.speed_m_s)
            moved.append(Segment(label, way / trip.speed_m_s, speeds=driving, markers=marker_sum))
        if turn > 0:
            turning = _alone(k, trip.yaw_rate_rad_s)
            moved.append(Segment(label, turn / trip.yaw_rate_rad_s, yaw_rates=turning, markers=marker_sum))
    return sorted(moved, key=lambda segment: segment.yaw_rates != (0.0, 0.0))


def _alone(robot: int, rate: float) -> tuple[float, float]:
    """One robot of two at a rate, the other at rest."""
    return (rate, 0.0) if robot == 0 else (0.0, rate)


def timeline(trip: Trip, power: PowerModel) -> tuple[tuple[Scan, ...], list[Segment]]:
    """The scans, and everything that draws power from the first scan's start to the last one's end."""
    scans = scan_sequence(trip.scans)
    marker_sum = trip.marker_w / (2 * power.marker[0][1])
    segments: list[Segment] = []
    for k, scan in enumerate(scans):
        if k:
            label = f"move t{3 * k - 2}-{3 * k - 1}"
            segments += move_segments(label, scans[k - 1], scan, trip, marker_sum)
        segments += scan_segments(f"scan {scan.label}", trip, len(raster(trip)))
    return scans, segments


def energies_j(segment: Segment, power: PowerModel) -> tuple[float, float, float, float]:
    """Energy of both robots together in a segment, eq (6.5): idling, motion, markers, scanner."""
    motion = markers = 0.0
    idle = 2 * power.robot[3][3] * segment.duration_s
    for v, omega in zip(segment.speeds, segment.yaw_rates, strict=True):
        x = (v, omega, 0.0, 1.0)
        motion += segment_energy_j(power.robot, x, x, segment.duration_s)
        lit = (segment.markers, 1.0)
        markers += segment_energy_j(power.marker, lit, lit, segment.duration_s)
    x = (segment.galvo, segment.laser, 1.0)
    return idle, motion - idle, markers, segment_energy_j(power.scanner, x, x, segment.duration_s)


def phases(segments: Sequence[Segment]) -> list[str]:
    """The trip's phases in order."""
    return list(dict.fromkeys(segment.phase for segment in segments))

"""What a log tells, one type for each kind of row; times in seconds, SI units, frames as in docs/localizing.md.

``time_s`` is when something was measured, on the clock of whoever measured it; ``arrival_s`` when the host heard of it,
on the host's clock, or None where nobody noted it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.team import Team

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """Turn rate (3,) in rad/s and specific force (3,) in m/s^2, body axes: +g along z at rest."""

    time_s: float
    robot: str
    gyro: Array
    accel: Array
    arrival_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Forward speed and yaw rate by a robot's wheels, from this time on until the next row of the robot."""

    time_s: float
    robot: str
    forward_m_s: float
    yaw_rate_rad_s: float
    arrival_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PoseSighting:
    """The pose of ``robot`` in the camera of robot ``camera``: p_camera = rotation @ p_body + position.

    ``covariance`` (6, 6) of its error: rotation (rad, applied from the left, camera axes), then position (m).
    """

    time_s: float
    camera: str
    robot: str
    rotation: Array
    position: Array
    covariance: Array
    arrival_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RangeBearing:
    """Where ``robot`` saw ``subject``, a robot or a landmark, in the plane; bearing from body x, left positive."""

    time_s: float
    robot: str
    subject: str
    range_m: float
    bearing_rad: float
    range_sigma_m: float
    bearing_sigma_rad: float
    arrival_s: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """A robot's absolute position (3,), or with ``rotation`` its pose, in the world.

    ``covariance`` (3, 3) of the position, or (6, 6) of rotation (rad, applied from the left, world axes) and position.
    """

    time_s: float
    robot: str
    position: Array
    rotation: Array | None
    covariance: Array
    arrival_s: float | None = None


Event = ImuSample | Odometry | PoseSighting | RangeBearing | Fix


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of one robot over time: (T,), (T, 3), (T, 3, 3)."""

    time_s: Array
    position: Array
    rotation: Array


@dataclass(frozen=True, eq=False)
class Log:
    """A recording: its events as they arrived, who is in it, the true trajectories if known.

    ``team`` is None where the log tells of nobody's cameras and bodies, as planar logs do. ``starts`` are (x, y, yaw)
    of robots as people set them down, in the team frame. ``landmarks`` are known places (x, y) in the world. ``notes``
    say what the reader had to leave out, a line each.
    """

    robots: tuple[str, ...]
    events: Sequence[Event]
    team: Team | None = None
    starts: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    landmarks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    truth: Mapping[str, Trajectory] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

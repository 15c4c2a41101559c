"""What localizing a log gives: each robot's path with its covariances, and what happened on the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Kind(StrEnum):
    """What can happen to a robot while it is localized."""

    JOINED = "joined"
    LEFT = "left"
    BACK = "back"
    REST_BEGINS = "rest begins"
    REST_ENDS = "rest ends"
    DEMOTED = "landmark demoted"
    OUTLIER = "outlier"
    BRIDGED = "gap bridged"
    GAP = "gap"
    CLOCK_JUMP = "clock jump"
    PLACED = "placed in the world"


@dataclass(frozen=True, slots=True)
class Happening:
    """Something that happened to a robot at a time (s); ``detail`` says how much, or who else took part."""

    time_s: float
    kind: Kind
    robot: str
    detail: str = ""


@dataclass(frozen=True, eq=False)
class Path:
    """The estimated poses of one robot while it was in the filter.

    time_s
        (T,) increasing.
    position, rotation
        (T, 3) metres, (T, 3, 3) R_frame_body; planar robots have z = 0 and turn about z alone.
    covariance
        (T, 6, 6) of the errors (theta, p): R = Exp(theta) R_hat, axes of the frame; planar robots have zeros where they
        cannot err (roll, pitch, z).
    """

    time_s: Array
    position: Array
    rotation: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Poses of N robots at a time, as in `Path`; ``present`` (N,) says of whom, ``placed`` whether in the world."""

    time_s: float
    present: NDArray[np.bool_]
    position: Array
    rotation: Array
    covariance: Array
    placed: bool


def path_of(estimates: Sequence[Estimate], robot: int) -> Path:
    """The path of a robot while it was in the filter; of a team that was placed in the world, since then."""
    placed = bool(estimates) and estimates[-1].placed
    held = [one for one in estimates if one.present[robot] and one.placed == placed]
    return Path(
        np.array([one.time_s for one in held]),
        np.array([one.position[robot] for one in held]).reshape(-1, 3),
        np.array([one.rotation[robot] for one in held]).reshape(-1, 3, 3),
        np.array([one.covariance[robot] for one in held]).reshape(-1, 6, 6),
    )


@dataclass(frozen=True, eq=False)
class CalibrationError:
    """How far something is off from its calibration, what is true being more by ``value``; standard deviations."""

    value: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class Result:
    """Paths by robot, and happenings in order of time.

    ``frame`` is "team" (the first robot's start, z against gravity) or "world" (where fixes or landmarks gave it).
    ``counts`` of events: "taken", "late" (older than the horizon), "duplicate", and others by name. ``clock_offset_s``:
    what was added to each stream's stamps ("imu picket_0", "camera observer_0"), where clocks had to be aligned.
    ``notes`` are lines for the reader. ``landmarks`` are the places (x, y) of landmarks that were not known before.
    ``calibration`` is, by robot, how far the filter found its camera and its hat to be off: "focal" (relative),
    "centre_px" (2,), "place_m" and "turn_rad" (3,) in the body, "leds_m" (L, 3).
    """

    paths: Mapping[str, Path]
    happenings: tuple[Happening, ...] = ()
    frame: Literal["team", "world"] = "team"
    planar: bool = False
    counts: Mapping[str, int] = field(default_factory=dict)
    clock_offset_s: Mapping[str, float] = field(default_factory=dict)
    landmarks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    calibration: Mapping[str, Mapping[str, CalibrationError]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

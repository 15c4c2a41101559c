"""The columns of a log, one table for each kind of row: CSV files and MCAP channels carry them by these names.

A kind is a file (``imu.csv``) or a channel (``/imu``). docs/localizing.md says what each column means.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from coop_envs.errors import ConfigError
from coop_envs.validation import known, suggestion

AXES = ("rx", "ry", "rz", "x", "y", "z")
"""Rows of a pose's covariance: rotation about the axes (rad), then position (m)."""
POSITION: tuple[str, ...] = ("x_m", "y_m", "z_m")
QUATERNION: tuple[str, ...] = ("qw", "qx", "qy", "qz")
SIGMA_ROTATION, SIGMA_POSITION = "sigma_rotation_rad", "sigma_position_m"
ARRIVAL = "arrival_s"


def covariance_column(i: int, j: int) -> str:
    """The name of entry (i, j) of a pose's covariance, i <= j: its axes and its unit."""
    unit = ("rad2", "rad_m", "m2")[(i >= 3) + (j >= 3)]
    return f"cov_{AXES[i]}_{AXES[j]}_{unit}"


COVARIANCE = tuple(covariance_column(i, j) for i in range(6) for j in range(i, 6))
POSITION_COVARIANCE = COVARIANCE[15:]


@dataclass(frozen=True)
class Kind:
    """One kind of row: its columns of text and of numbers, and those that it may leave out.

    ``clock`` is the column that tells whose clock gave ``time_s``; rows without a time have none. Of the sets in
    ``either`` one stands in full.
    """

    name: str
    texts: tuple[str, ...]
    numbers: tuple[str, ...]
    optional: tuple[str, ...] = ()
    either: tuple[tuple[str, ...], ...] = ()
    clock: str | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns, in the order in which they are written."""
        time = ("time_s",) if "time_s" in self.numbers else ()
        rest = tuple(name for name in self.numbers if name not in time)
        extra = tuple(name for group in self.either for name in group)
        arrival, other = ((ARRIVAL,) if ARRIVAL in self.optional else ()), set(self.optional) - {ARRIVAL}
        quaternion = tuple(name for name in QUATERNION if name in other)
        return (*time, *arrival, *self.texts, *rest, *quaternion, *dict.fromkeys(extra))


_IMU = (*(f"gyro_{axis}_rad_s" for axis in "xyz"), *(f"accel_{axis}_m_s2" for axis in "xyz"))
_RANGE_BEARING = ("range_m", "bearing_rad", "range_sigma_m", "bearing_sigma_rad")

IMU = Kind("imu", ("robot",), ("time_s", *_IMU), (ARRIVAL,), clock="robot")
ODOMETRY = Kind("odometry", ("robot",), ("time_s", "forward_m_s", "yaw_rate_rad_s"), (ARRIVAL,), clock="robot")
POSES = Kind(
    "poses",
    ("camera", "robot"),
    ("time_s", *POSITION, *QUATERNION),
    (ARRIVAL,),
    (COVARIANCE, (SIGMA_ROTATION, SIGMA_POSITION)),
    clock="camera",
)
RANGE_BEARING = Kind("range_bearing", ("robot", "subject"), ("time_s", *_RANGE_BEARING), (ARRIVAL,), clock="robot")
FIXES = Kind(
    "fixes",
    ("robot",),
    ("time_s", *POSITION),
    (ARRIVAL, *QUATERNION),
    (COVARIANCE, POSITION_COVARIANCE, (SIGMA_ROTATION, SIGMA_POSITION), (SIGMA_POSITION,)),
    clock="robot",
)
LANDMARKS = Kind("landmarks", ("name",), ("x_m", "y_m"))
TRUTH = Kind("truth", ("robot",), ("time_s", *POSITION, *QUATERNION), clock="robot")

KINDS = {kind.name: kind for kind in (IMU, ODOMETRY, POSES, RANGE_BEARING, FIXES, LANDMARKS, TRUTH)}


@dataclass(frozen=True, eq=False)
class RawRows:
    """Rows as a source gives them, a sequence of cells a column: texts or numbers, "" or None where there is nothing.

    ``place(i)`` says where row i stands, for people: ``imu.csv line 3``.
    """

    kind: Kind
    columns: Mapping[str, Sequence[object]]
    place: Callable[[int], str]


def check_columns(kind: Kind, given: Collection[str], place: str) -> None:
    """That these are columns of the kind, and all that it needs.

    Raises:
        ConfigError: a column that is unknown or missing, or more than one way to say the covariance.
    """
    for name in given:
        if name not in kind.columns:
            known(name, kind.columns, f"{place}, column", "a column")
    for name in (*kind.texts, *kind.numbers):
        if name not in given:
            raise ConfigError(f"{place}, column {name}", None, f"this column{suggestion(name, given)}")
    whole = [group for group in kind.either if set(group) <= set(given)]
    largest = max(whole, key=len, default=())
    stray = [name for group in kind.either for name in group if name in given and name not in largest]
    if kind.either and (not whole or stray):
        ways = " or ".join(
            f"{group[0]} to {group[-1]}" if len(group) > 2 else " and ".join(group) for group in kind.either
        )
        got = stray or [name for name in given if name.startswith(("cov_", "sigma_"))]
        raise ConfigError(f"{place}, covariance", got or None, f"in full and alone: {ways}")
    if 0 < sum(name in given for name in QUATERNION) < 4:
        raise ConfigError(
            f"{place}, columns {', '.join(QUATERNION)}", [n for n in QUATERNION if n in given], "all four"
        )

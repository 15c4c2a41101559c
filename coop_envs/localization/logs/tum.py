"""Trajectories as text that others' tools read: ``timestamp tx ty tz qx qy qz qw``, a pose a line.

Source: the TUM RGB-D benchmark's file format; seconds, metres, Hamilton quaternions with w last.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.checks import UNIT_TOLERANCE
from coop_envs.localization.logs.events import Trajectory
from coop_envs.localization.trajectories import Poses
from coop_envs.recording.whole_file import written_whole

HEADER = "# timestamp tx ty tz qx qy qz qw (s, m, R_frame_body)\n"
COLUMNS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")


def write_tum(path: str | Path, trajectory: Poses) -> None:
    """Write a trajectory; the file appears whole or not at all."""
    quaternions = Rotation.from_matrix(trajectory.rotation).as_quat(canonical=True)
    rows = zip(trajectory.time_s.tolist(), trajectory.position.tolist(), quaternions.tolist(), strict=True)
    with written_whole(path) as part, part.open("w", encoding="utf-8") as stream:
        stream.write(HEADER)
        for time_s, position, quaternion in rows:
            numbers = " ".join(f"{number:.9f}" for number in (*position, *quaternion))
            stream.write(f"{time_s:.9f} {numbers}\n")


def read_tum(path: str | Path) -> Trajectory:
    """The trajectory in a TUM file; empty lines and those that begin with # are comments.

    Raises:
        ConfigError: not eight finite numbers a line, a quaternion far from unit, time that stands or goes back.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ConfigError("trajectory", str(path), f"a TUM file ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ConfigError(path.name, "bytes that are not UTF-8", "a TUM file") from None
    kept = [(k, line) for k, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if not kept:
        raise ConfigError(path.name, "no poses", "a line for each pose")
    rows = np.array([_numbers(line, f"{path.name} line {k}") for k, line in kept])
    length = np.linalg.norm(rows[:, 4:], axis=1)
    for bad, column, expected in (
        (np.abs(length - 1.0) > UNIT_TOLERANCE, "qx, qy, qz, qw", f"a norm within {UNIT_TOLERANCE} of 1"),
        (np.diff(rows[:, 0], prepend=-np.inf) <= 0.0, "timestamp", "a time after the line before's"),
    ):
        if bad.any():
            row = int(bad.argmax())
            value = rows[row, 4:].tolist() if "," in column else float(rows[row, 0])
            raise ConfigError(f"{path.name} line {kept[row][0]}, {column}", value, expected)
    return Trajectory(rows[:, 0], rows[:, 1:4], Rotation.from_quat(rows[:, 4:]).as_matrix())


def _numbers(line: str, place: str) -> list[float]:
    words = line.split()
    if len(words) != len(COLUMNS):
        raise ConfigError(place, f"{len(words)} values", f"{len(COLUMNS)}: {' '.join(COLUMNS)}")
    numbers: list[float] = []
    for word, name in zip(words, COLUMNS, strict=True):
        try:
            numbers.append(float(word))
        except ValueError:
            raise ConfigError(f"{place}, {name}", word, "a number") from None
        if not np.isfinite(numbers[-1]):
            raise ConfigError(f"{place}, {name}", word, "a finite number")
    return numbers

"""Logs laid out as the UTIAS multi-robot cooperative localization and mapping data sets are.

A folder of text files, columns parted by blanks, ``#`` before comments; times in s, SI units:

    Barcodes.dat              subject, barcode                            who carries which barcode
    Landmark_Groundtruth.dat  subject, x, y, x_sigma, y_sigma             landmarks (optional)
    Robot1_Odometry.dat       time, forward velocity, yaw rate            of subject 1, and so on
    Robot1_Measurement.dat    time, barcode, range, bearing               what it saw (optional)
    Robot1_Groundtruth.dat    time, x, y, yaw                             where it truly was (optional)

Subjects with a file of odometry are robots ("robot_1"), the others landmarks ("landmark_6").

Source: Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping dataset", 2011.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from io import StringIO
from pathlib import Path

import numpy as np

from coop_envs.errors import ConfigError, require
from coop_envs.localization.logs.events import Event, Log, Odometry, RangeBearing, Trajectory
from coop_envs.localization.planar.se2 import Array

COLUMNS = {
    "Barcodes": ("subject", "barcode"),
    "Landmark_Groundtruth": ("subject", "x_m", "y_m", "x_sigma_m", "y_sigma_m"),
    "Odometry": ("time_s", "forward_m_s", "yaw_rate_rad_s"),
    "Measurement": ("time_s", "barcode", "range_m", "bearing_rad"),
    "Groundtruth": ("time_s", "x_m", "y_m", "yaw_rad"),
}
WHOLE = ("subject", "barcode")
ROBOT_FILE = re.compile(r"Robot(\d+)_Odometry\.dat")


class Landmarks(StrEnum):
    """What a team may know of landmarks: their places, only what it sees of them, nothing."""

    KNOWN = "known"
    UNKNOWN = "unknown"
    NONE = "none"


@dataclass(frozen=True)
class UtiasReading:
    """How a folder is read: sigmas that its measurements lack, how landmarks count, the time from its start (s).

    ``range_sigma_share`` of a range is added to ``range_sigma_m``. With ``starts_by_truth`` robots are told where they
    start, in the frame of the ground truth.
    """

    range_sigma_m: float = 0.1
    range_sigma_share: float = 0.02
    bearing_sigma_rad: float = 0.05
    landmarks: Landmarks = Landmarks.KNOWN
    starts_by_truth: bool = False
    first_s: float = 0.0
    length_s: float = math.inf


def is_utias(folder: Path) -> bool:
    """Whether a folder is laid out so."""
    return folder.is_dir() and (folder / "Barcodes.dat").is_file()


def read_utias(folder: Path, reading: UtiasReading | None = None) -> Log:
    """Read a folder; events in order of time.

    Raises:
        ConfigError: a file is missing or a line cannot be read: file, line and column, what stands there.
    """
    reading = reading or UtiasReading()
    require(is_utias(folder), "log", str(folder), "a folder with Barcodes.dat and Robot1_Odometry.dat")
    numbers = sorted(int(found[1]) for path in folder.iterdir() if (found := ROBOT_FILE.fullmatch(path.name)))
    require(len(numbers) > 0, "log", str(folder), "at least one Robot1_Odometry.dat")
    robots = {number: f"robot_{number}" for number in numbers}
    names = {**_landmark_names(folder, robots), **robots}
    barcodes = _barcodes(folder, names)
    odometry = {number: read_columns(folder / f"Robot{number}_Odometry.dat", "Odometry") for number in numbers}
    begin_s = min((float(rows[0, 0]) for rows in odometry.values() if len(rows)), default=0.0) + reading.first_s
    span_s = (begin_s, begin_s + reading.length_s)
    events: list[Event] = []
    for number, name in robots.items():
        events += [Odometry(t, name, v, w) for t, v, w in within(odometry[number], span_s).tolist()]
    seen, notes = _sightings(folder, robots, barcodes, reading, span_s)
    events += seen
    events.sort(key=lambda event: event.time_s)
    truth = {name: path for n, name in robots.items() if (path := _truth(folder, n, span_s)) is not None}
    known = _landmark_places(folder, names) if reading.landmarks is Landmarks.KNOWN else {}
    starts = {name: _start(path) for name, path in truth.items()} if reading.starts_by_truth else {}
    return Log(tuple(robots.values()), events, None, starts, known, truth, notes)


def read_columns(path: Path, kind: str) -> Array:
    """The numbers of a file (rows, columns)."""
    columns = COLUMNS[kind]
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(str(path), str(error), "a readable text file") from error
    table = _plain(text)
    return table if _sound(table, columns) else _line_by_line(text, columns, path.name)


def _plain(text: str) -> Array:
    """The numbers of a text without faults, else an empty table."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return np.loadtxt(StringIO(text), comments="#", ndmin=2)
    except ValueError:
        return np.zeros((0, 0))


def _sound(table: Array, columns: Sequence[str]) -> bool:
    """Whether a table may be used as it is; a fault is then found line by line."""
    if table.size == 0 or table.shape[1] != len(columns) or not np.isfinite(table).all():
        return False
    whole = table[:, [c in WHOLE for c in columns]]
    back = columns[0] == "time_s" and bool(np.any(np.diff(table[:, 0]) < 0))
    return not back and bool(np.all(whole == whole.round()) and np.all(table[:, [_positive(c) for c in columns]] >= 0))


def _line_by_line(text: str, columns: Sequence[str], name: str) -> Array:
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.partition("#")[0].split()
        if fields:
            rows.append(_numbers(fields, columns, f"{name}:{number}"))
            back = columns[0] == "time_s" and len(rows) > 1 and rows[-1][0] < rows[-2][0]
            require(not back, f"{name}:{number}: time_s", fields[0], "a time that does not go back")
    return np.array(rows).reshape(-1, len(columns))


def _positive(column: str) -> bool:
    return column == "range_m" or column.endswith("sigma_m")


def _numbers(fields: Sequence[str], columns: Sequence[str], where: str) -> list[float]:
    expected = f"{len(columns)} columns: {' '.join(columns)}"
    require(len(fields) == len(columns), where, " ".join(fields), expected)
    numbers: list[float] = []
    for field, column in zip(fields, columns, strict=True):
        try:
            numbers.append(float(field))
        except ValueError:
            raise ConfigError(f"{where}: {column}", field, "a number") from None
        require(math.isfinite(numbers[-1]), f"{where}: {column}", field, "a finite number")
        require(not _positive(column) or numbers[-1] >= 0, f"{where}: {column}", field, "0 or more")
        require(column not in WHOLE or numbers[-1] == int(numbers[-1]), f"{where}: {column}", field, "a whole number")
    return numbers


def within(rows: Array, span_s: tuple[float, float]) -> Array:
    """The rows (T, C) whose time, the first column, lies in a span."""
    return rows[(rows[:, 0] >= span_s[0]) & (rows[:, 0] <= span_s[1])]


def _landmark_rows(folder: Path) -> Array:
    path = folder / "Landmark_Groundtruth.dat"
    return read_columns(path, "Landmark_Groundtruth") if path.is_file() else np.zeros((0, 5))


def _landmark_names(folder: Path, robots: dict[int, str]) -> dict[int, str]:
    subjects = read_columns(folder / "Barcodes.dat", "Barcodes")[:, 0].astype(int).tolist()
    listed = [*subjects, *_landmark_rows(folder)[:, 0].astype(int).tolist()]
    return {subject: f"landmark_{subject}" for subject in listed if subject not in robots}


def _landmark_places(folder: Path, names: dict[int, str]) -> dict[str, tuple[float, float]]:
    return {names[int(subject)]: (x, y) for subject, x, y, _, _ in _landmark_rows(folder).tolist()}


def _barcodes(folder: Path, names: dict[int, str]) -> dict[int, str]:
    """Subject's name by barcode."""
    rows = read_columns(folder / "Barcodes.dat", "Barcodes").astype(int).tolist()
    codes = [barcode for _, barcode in rows]
    twice = sorted({code for code in codes if codes.count(code) > 1})
    require(not twice, "Barcodes.dat: barcode", twice, "each barcode once")
    return {barcode: names[subject] for subject, barcode in rows}


def _sightings(
    folder: Path, robots: dict[int, str], barcodes: dict[int, str], reading: UtiasReading, span_s: tuple[float, float]
) -> tuple[list[Event], tuple[str, ...]]:
    """What robots saw, and how much of it was of nobody."""
    events: list[Event] = []
    strange = itself = empty = 0
    for number, name in robots.items():
        path = folder / f"Robot{number}_Measurement.dat"
        rows = read_columns(path, "Measurement") if path.is_file() else np.zeros((0, 4))
        for time_s, barcode, range_m, bearing_rad in within(rows, span_s).tolist():
            subject = barcodes.get(int(barcode))
            strange, itself, empty = strange + (subject is None), itself + (subject == name), empty + (range_m == 0)
            if subject is None or subject == name or range_m == 0:
                continue
            if reading.landmarks is Landmarks.NONE and subject not in robots.values():
                continue
            sigma_m = reading.range_sigma_m + reading.range_sigma_share * range_m
            events.append(RangeBearing(time_s, name, subject, range_m, bearing_rad, sigma_m, reading.bearing_sigma_rad))
    counts = ((strange, "of barcodes that nobody carries"), (itself, "of the seer itself"), (empty, "at no range"))
    return events, tuple(f"{count} measurements {what} left out" for count, what in counts if count)


def _truth(folder: Path, number: int, span_s: tuple[float, float]) -> Trajectory | None:
    path = folder / f"Robot{number}_Groundtruth.dat"
    rows = within(read_columns(path, "Groundtruth"), span_s) if path.is_file() else np.zeros((0, 4))
    if len(rows) == 0:
        return None
    rotation = np.tile(np.eye(3), (len(rows), 1, 1))
    c, s = np.cos(rows[:, 3]), np.sin(rows[:, 3])
    rotation[:, 0, 0], rotation[:, 0, 1], rotation[:, 1, 0], rotation[:, 1, 1] = c, -s, s, c
    return Trajectory(rows[:, 0], np.column_stack([rows[:, 1:3], np.zeros(len(rows))]), rotation)


def _start(path: Trajectory) -> tuple[float, float, float]:
    x, y, _ = path.position[0].tolist()
    return x, y, float(np.arctan2(path.rotation[0, 1, 0], path.rotation[0, 0, 0]))

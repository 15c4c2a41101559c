"""From checked rows of every kind to a `Log`: events in the order of their arrival, robots that are known."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.checks import Table, checked, counted
from coop_envs.localization.logs.columns import FIXES, IMU, LANDMARKS, ODOMETRY, POSES, RANGE_BEARING, TRUTH, RawRows
from coop_envs.localization.logs.events import (
    Event,
    Fix,
    ImuSample,
    Log,
    Odometry,
    PoseSighting,
    RangeBearing,
    Trajectory,
)
from coop_envs.localization.logs.team_file import LogTeam
from coop_envs.validation import suggestion

Array = NDArray[np.float64]


def assemble(source: str, raws: Iterable[RawRows], who: LogTeam | None, notes: Sequence[str]) -> Log:
    """The log that these rows make; without a team file its robots are those with IMU or odometry.

    Raises:
        ConfigError: rows that cannot be used, a robot that is unknown, neither IMU nor odometry.
    """
    tables = {raw.kind.name: checked(raw) for raw in raws}
    if not {IMU.name, ODOMETRY.name} & set(tables):
        got = f"rows of {', '.join(sorted(tables))}" if tables else "no rows"
        raise ConfigError(source, "; ".join([got, *notes]), "rows of imu or odometry")
    who = who or LogTeam()
    robots = who.robots or _robots(tables)
    _check_names(tables, robots, _cameras(who) or robots)
    truth, more = _truth(tables.get(TRUTH.name))
    return Log(
        robots=robots,
        events=_in_order(tables),
        team=who.team,
        starts=dict(who.starts),
        landmarks=_landmarks(tables.get(LANDMARKS.name), robots),
        truth=truth,
        notes=(*notes, *more),
    )


def _robots(tables: Mapping[str, Table]) -> tuple[str, ...]:
    """Who reports motion, in the order of the first row."""
    reporting = [tables[kind.name].texts["robot"] for kind in (IMU, ODOMETRY) if kind.name in tables]
    return tuple(dict.fromkeys(itertools.chain(*reporting)))


def _cameras(who: LogTeam) -> tuple[str, ...]:
    """Whoever carries a camera, as far as that is known."""
    members = () if who.team is None else who.team.members
    return tuple(name for name, member in zip(who.robots, members, strict=False) if member.camera is not None)


def _check_names(tables: Mapping[str, Table], robots: tuple[str, ...], cameras: tuple[str, ...]) -> None:
    """That robots and those with a camera are known and see others than themselves."""
    for table in tables.values():
        for column, known, what in (("robot", robots, "a robot"), ("camera", cameras, "a robot with a camera")):
            names = table.texts.get(column, ())
            for name in set(names) - set(known):
                expected = f"{what}: {', '.join(known)}{suggestion(name, known)}"
                raise table.refuse(list(names).index(name), column, name, expected)
        seeing, seen = (table.texts[column] for column in (table.kind.texts * 2)[:2])
        if len(table.kind.texts) == 2:
            for row, (a, b) in enumerate(zip(seeing, seen, strict=True)):
                if a == b:
                    raise table.refuse(row, table.kind.texts[1], b, "another than the one that sees it")


def _in_order(tables: Mapping[str, Table]) -> list[Event]:
    """All events, by arrival; where it is the same, or where nobody noted it and the time is, kind by kind."""
    events: list[Event] = []
    order: list[Array] = []
    for name, build in _BUILDERS.items():
        if name in tables:
            events += build(tables[name])
            order.append(tables[name].order_s)
    return [events[k] for k in np.argsort(np.concatenate(order), kind="stable")]


def _arrivals(table: Table) -> list[float | None]:
    return [None if np.isnan(at) else at for at in table.arrival_s.tolist()]


def _fixed(array: Array) -> list[Array]:
    """The rows of an array, read-only."""
    array.setflags(write=False)
    return list(array)


def _imu(table: Table) -> list[Event]:
    gyro, accel = (
        _fixed(np.column_stack([table.numbers[f"{what}_{axis}_{unit}"] for axis in "xyz"]))
        for what, unit in (("gyro", "rad_s"), ("accel", "m_s2"))
    )
    return list(map(ImuSample, table.time_s.tolist(), table.texts["robot"], gyro, accel, _arrivals(table)))


def _odometry(table: Table) -> list[Event]:
    speeds = (table.numbers[name].tolist() for name in ("forward_m_s", "yaw_rate_rad_s"))
    return list(map(Odometry, table.time_s.tolist(), table.texts["robot"], *speeds, _arrivals(table)))


def _poses(table: Table) -> list[Event]:
    names = table.texts["camera"], table.texts["robot"]
    arrays = (_fixed(array) for array in (table.rotation(), table.position(), table.covariance()))
    return list(map(PoseSighting, table.time_s.tolist(), *names, *arrays, _arrivals(table)))


def _range_bearing(table: Table) -> list[Event]:
    names = table.texts["robot"], table.texts["subject"]
    columns = ("range_m", "bearing_rad", "range_sigma_m", "bearing_sigma_rad")
    numbers = (table.numbers[name].tolist() for name in columns)
    return list(map(RangeBearing, table.time_s.tolist(), *names, *numbers, _arrivals(table)))


def _fixes(table: Table) -> list[Event]:
    rotations, covariances = _fixed(table.rotation()), _fixed(table.covariance())
    full = table.has_rotation().tolist()
    rotation = [R if whole else None for R, whole in zip(rotations, full, strict=True)]
    covariance = [P if whole else P[3:, 3:] for P, whole in zip(covariances, full, strict=True)]
    position = _fixed(table.position())
    times, robots = table.time_s.tolist(), table.texts["robot"]
    return list(map(Fix, times, robots, position, rotation, covariance, _arrivals(table)))


_BUILDERS: dict[str, Any] = {
    IMU.name: _imu,
    ODOMETRY.name: _odometry,
    POSES.name: _poses,
    RANGE_BEARING.name: _range_bearing,
    FIXES.name: _fixes,
}


def _landmarks(table: Table | None, robots: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    places: dict[str, tuple[float, float]] = {}
    if table is not None:
        points = zip(table.numbers["x_m"].tolist(), table.numbers["y_m"].tolist(), strict=True)
        for row, (name, point) in enumerate(zip(table.texts["name"], points, strict=True)):
            if name in places or name in robots:
                raise table.refuse(row, "name", name, "a name that no other landmark and no robot has")
            places[name] = point
    return places


def _truth(table: Table | None) -> tuple[dict[str, Trajectory], list[str]]:
    """Trajectories by robot, and what is to be said of them: rows at a time that another row has are left out."""
    if table is None:
        return {}, []
    owners, names = np.asarray(counted(table.texts["robot"])), list(dict.fromkeys(table.texts["robot"]))
    position, rotation = table.position(), table.rotation()
    found: dict[str, Trajectory] = {}
    twice = 0
    for k, name in enumerate(names):
        rows = np.flatnonzero(owners == k)
        new = np.diff(table.time_s[rows], prepend=-np.inf) > 0.0
        twice += int((~new).sum())
        rows = rows[new]
        found[name] = Trajectory(table.time_s[rows], position[rows], rotation[rows])
    return found, [f"truth: {twice} rows at the time of the row before left out"] * (twice > 0)

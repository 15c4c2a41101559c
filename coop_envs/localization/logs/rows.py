"""A log's events as rows of the format's columns, for the writers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_envs.localization.logs.columns import (
    ARRIVAL,
    COVARIANCE,
    FIXES,
    IMU,
    KINDS,
    LANDMARKS,
    ODOMETRY,
    POSES,
    POSITION,
    POSITION_COVARIANCE,
    QUATERNION,
    RANGE_BEARING,
    TRUTH,
)
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

Row = dict[str, Any]
Array = NDArray[np.float64]
UPPER_3, UPPER_6 = np.triu_indices(3), np.triu_indices(6)


def log_rows(log: Log) -> dict[str, list[Row]]:
    """Rows by kind, of the kinds that the log has, columns without a value left out; events stay in their order."""
    rows: dict[str, list[Row]] = {name: [] for name in KINDS}
    for event in log.events:
        rows[event_kind(event)].append(event_row(event))
    rows[LANDMARKS.name] = [{"name": name, "x_m": x, "y_m": y} for name, (x, y) in log.landmarks.items()]
    for robot, trajectory in log.truth.items():
        rows[TRUTH.name] += truth_rows(robot, trajectory)
    return {name: found for name, found in rows.items() if found}


def event_kind(event: Event) -> str:
    """The name of an event's kind."""
    return _KINDS[type(event)][0]


def event_row(event: Event) -> Row:
    """One event as a row."""
    row = {"time_s": float(event.time_s), **_KINDS[type(event)][1](event)}
    return row if event.arrival_s is None else {**row, ARRIVAL: float(event.arrival_s)}


def truth_rows(robot: str, trajectory: Trajectory) -> Iterable[Row]:
    """A true trajectory as rows."""
    quaternions = Rotation.from_matrix(trajectory.rotation).as_quat()[:, [3, 0, 1, 2]].tolist()
    for time_s, p, q in zip(trajectory.time_s.tolist(), trajectory.position.tolist(), quaternions, strict=True):
        yield {"time_s": time_s, "robot": robot} | dict(zip((*POSITION, *QUATERNION), (*p, *q), strict=True))


def _imu(event: ImuSample) -> Row:
    columns = IMU.numbers[1:]
    return {"robot": event.robot} | dict(zip(columns, [*event.gyro.tolist(), *event.accel.tolist()], strict=True))


def _odometry(event: Odometry) -> Row:
    return {"robot": event.robot, "forward_m_s": event.forward_m_s, "yaw_rate_rad_s": event.yaw_rate_rad_s}


def _pose(event: PoseSighting) -> Row:
    pose = _pose_row(event.position, event.rotation)
    return {"camera": event.camera, "robot": event.robot} | pose | _covariance_row(event.covariance)


def _range_bearing(event: RangeBearing) -> Row:
    columns = ("robot", "subject", *RANGE_BEARING.numbers[1:])
    return {name: getattr(event, name) for name in columns}


def _fix(event: Fix) -> Row:
    return {"robot": event.robot} | _pose_row(event.position, event.rotation) | _covariance_row(event.covariance)


def _pose_row(position: Array, rotation: Array | None) -> Row:
    row = dict(zip(POSITION, position.tolist(), strict=True))
    if rotation is None:
        return row
    quaternion = Rotation.from_matrix(rotation).as_quat()[[3, 0, 1, 2]]
    return row | dict(zip(QUATERNION, quaternion.tolist(), strict=True))


def _covariance_row(P: Array) -> Row:
    names, upper = (COVARIANCE, UPPER_6) if len(P) == 6 else (POSITION_COVARIANCE, UPPER_3)
    return dict(zip(names, P[upper].tolist(), strict=True))


_KINDS: dict[type[Any], tuple[str, Callable[[Any], Row]]] = {
    ImuSample: (IMU.name, _imu),
    Odometry: (ODOMETRY.name, _odometry),
    PoseSighting: (POSES.name, _pose),
    RangeBearing: (RANGE_BEARING.name, _range_bearing),
    Fix: (FIXES.name, _fix),
}

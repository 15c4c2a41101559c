"""From standard ROS 1 messages to the columns of a log.

Frames as ROS has them (REP-103): bodies x forward, cameras in their optical frame. A pose's covariance is about the
axes of the frame that the pose is given in, position first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.bag_topics import Source
from coop_envs.localization.logs.columns import (
    COVARIANCE,
    FIXES,
    IMU,
    KINDS,
    ODOMETRY,
    POSES,
    POSITION,
    QUATERNION,
    SIGMA_POSITION,
    SIGMA_ROTATION,
    TRUTH,
)

Row = dict[str, Any]
OURS_IN_ROS = np.ix_((3, 4, 5, 0, 1, 2), (3, 4, 5, 0, 1, 2))
"""Where our rows of a covariance are in ROS's."""
UPPER = np.triu_indices(6)
SYMMETRY = 1e-6
"""Two entries that should be the same may differ by this share: rounded to float32 and back."""


def row_of(message: Any, kind: str, source: Source, place: str) -> Row:
    """A message's columns, but for its time and whose it is.

    Raises:
        ConfigError: a covariance that is none, or missing where nothing stands for it.
    """
    row = READERS[kind][message_kind(message)](message)
    flat = row.pop("covariance", None)
    return row | (_covariance(flat, "qw" in row, source, place) if KINDS[kind].either else {})


def message_kind(message: Any) -> str:
    """A message's type as ROS 1 writes it."""
    return message.__msgtype__.replace("/msg/", "/")


def _imu(m: Any) -> Row:
    gyro, accel = m.angular_velocity, m.linear_acceleration
    return dict(zip(IMU.numbers[1:], (gyro.x, gyro.y, gyro.z, accel.x, accel.y, accel.z), strict=True))


def _twist(twist: Any) -> Row:
    return {"forward_m_s": twist.linear.x, "yaw_rate_rad_s": twist.angular.z}


def _point(p: Any) -> Row:
    return dict(zip(POSITION, (p.x, p.y, p.z), strict=True))


def _rotation(q: Any) -> Row:
    return dict(zip(QUATERNION, (q.w, q.x, q.y, q.z), strict=True))


def _pose(pose: Any) -> Row:
    return _point(pose.position) | _rotation(pose.orientation)


def _covariance(flat: Any, with_rotation: bool, source: Source, place: str) -> Row:
    """Of our order; one of zeros says nothing, as in ROS."""
    P = np.zeros((6, 6)) if flat is None else np.asarray(flat, dtype=np.float64).reshape(6, 6)[OURS_IN_ROS]
    if not np.isfinite(P).all():
        raise ConfigError(f"{place}, covariance", P.tolist(), "finite numbers")
    if not P.any():
        P = np.diag(np.repeat(_stated(with_rotation, source, place), 3))
    if np.abs(P - P.T).max() > SYMMETRY * np.abs(P).max():
        raise ConfigError(f"{place}, covariance", P.tolist(), "a symmetric matrix")
    return dict(zip(COVARIANCE, (0.5 * (P + P.T))[UPPER].tolist(), strict=True))


def _stated(with_rotation: bool, source: Source, place: str) -> list[float]:
    """Variances of rotation and position that the topic's entry states."""
    sigmas = {SIGMA_ROTATION: source.sigma_rotation_rad, SIGMA_POSITION: source.sigma_position_m}
    for name, sigma in sigmas.items():
        if sigma is None and (with_rotation or name == SIGMA_POSITION):
            stand_in = f"one, or an entry topics.{source.kind}.{name} that stands for it"
            raise ConfigError(f"{place}, covariance", None, stand_in)
    return [(sigma or 0.0) ** 2 for sigma in sigmas.values()]


Reader = Callable[[Any], Row]
POSE_READERS: Mapping[str, Reader] = {
    "geometry_msgs/PoseWithCovarianceStamped": lambda m: _pose(m.pose.pose) | {"covariance": m.pose.covariance},
    "geometry_msgs/PoseStamped": lambda m: _pose(m.pose),
    "geometry_msgs/TransformStamped": lambda m: _point(m.transform.translation) | _rotation(m.transform.rotation),
}
READERS: Mapping[str, Mapping[str, Reader]] = {
    IMU.name: {"sensor_msgs/Imu": _imu},
    ODOMETRY.name: {
        "nav_msgs/Odometry": lambda m: _twist(m.twist.twist),
        "geometry_msgs/TwistStamped": lambda m: _twist(m.twist),
        "geometry_msgs/TwistWithCovarianceStamped": lambda m: _twist(m.twist.twist),
        "geometry_msgs/Twist": _twist,
    },
    POSES.name: POSE_READERS,
    FIXES.name: {**POSE_READERS, "geometry_msgs/PointStamped": lambda m: _point(m.point)},
    TRUTH.name: {**POSE_READERS, "nav_msgs/Odometry": lambda m: _pose(m.pose.pose)},
}
"""How each kind of row is read from each type of message."""

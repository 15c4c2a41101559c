"""ROS 1 bags as rosbags writes them."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
Message = tuple[str, float, Any]  # topic, time of recording (s), message


def make(kind: str, *arguments: Any) -> Any:
    return STORE.types[kind](*arguments)


def header(stamp_s: float, frame: str = "") -> Any:
    ns = round(stamp_s * 1e9)
    return make("std_msgs/msg/Header", 0, make("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9), frame)


def vector(*xyz: float) -> Any:
    return make("geometry_msgs/msg/Vector3", *xyz)


def pose(position: Any, quaternion_wxyz: Any) -> Any:
    w, x, y, z = (float(number) for number in quaternion_wxyz)
    point = make("geometry_msgs/msg/Point", *(float(number) for number in position))
    return make("geometry_msgs/msg/Pose", point, make("geometry_msgs/msg/Quaternion", x, y, z, w))


def imu(stamp_s: float, gyro: Any = (0.0, 0.0, 0.1), accel: Any = (0.0, 0.0, 9.81)) -> Any:
    none = np.zeros(9)
    still = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    rates = (vector(*map(float, gyro)), none, vector(*map(float, accel)), none)
    return make("sensor_msgs/msg/Imu", header(stamp_s), still, none, *rates)


def twist(forward: float, yaw_rate: float) -> Any:
    return make("geometry_msgs/msg/Twist", vector(forward, 0.0, 0.0), vector(0.0, 0.0, yaw_rate))


def twist_stamped(stamp_s: float, forward: float, yaw_rate: float) -> Any:
    return make("geometry_msgs/msg/TwistStamped", header(stamp_s), twist(forward, yaw_rate))


def odometry(stamp_s: float, forward: float, yaw_rate: float, at: Any = None) -> Any:
    none = np.zeros(36)
    here = make("geometry_msgs/msg/PoseWithCovariance", at or pose((0, 0, 0), (1, 0, 0, 0)), none)
    speed = make("geometry_msgs/msg/TwistWithCovariance", twist(forward, yaw_rate), none)
    return make("nav_msgs/msg/Odometry", header(stamp_s), "base", here, speed)


def pose_stamped(stamp_s: float, at: Any) -> Any:
    return make("geometry_msgs/msg/PoseStamped", header(stamp_s), at)


def pose_with_covariance(stamp_s: float, at: Any, covariance: np.ndarray) -> Any:
    """``covariance`` (6, 6) in ROS's order: position, then rotation."""
    held = make("geometry_msgs/msg/PoseWithCovariance", at, np.asarray(covariance, dtype=float).ravel())
    return make("geometry_msgs/msg/PoseWithCovarianceStamped", header(stamp_s), held)


def write_bag(path: Path, messages: Iterable[Message], compression: str | None = None, chunk_bytes: int = 4096) -> Path:
    path.unlink(missing_ok=True)
    writer = Writer(path)
    writer.chunk_threshold = chunk_bytes
    if compression is not None:
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    with writer:
        connections: dict[str, Any] = {}
        for topic, at, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            raw = STORE.serialize_ros1(message, message.__msgtype__)
            writer.write(connections[topic], round(at * 1e9), raw)
    return path

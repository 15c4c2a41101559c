"""What robots and cameras report, stamped: the raw inputs of a mission, from which a replay starts."""

from __future__ import annotations

from dataclasses import dataclass

Triple = tuple[float, float, float]
Pair = tuple[float, float]


@dataclass(frozen=True)
class Sample:
    """One report of a robot.

    ``host_s`` is when it arrived, on the host's clock; ``device_s`` when it was taken, on the robot's own clock,
    unwrapped, None where the robot gives no stamp. ``gyro`` (rad/s) and ``accel`` (m/s^2, specific force) in the body
    frame are None from robots whose radio carries no IMU. ``angles`` (rad) are those of the left and right wheel since
    switch-on, ``wheels`` (rad/s) their speeds; forward is positive.
    """

    host_s: float
    device_s: float | None
    angles_rad: Pair
    wheels_rad_s: Pair
    gyro_rad_s: Triple | None = None
    accel_m_s2: Triple | None = None
    voltage_v: float | None = None


@dataclass(frozen=True)
class CameraFrame:
    """What a camera saw at ``host_s``: blobs of light, each (u px, v px, hue deg, signal).

    ``spot`` (u px, v px, sigma px) is the laser's, or the brightest blob where the detector cannot tell; it is used in
    ticks in which a laser is lit. Signal is relative to an LED at full brightness at the reference range.
    """

    host_s: float
    blobs: tuple[tuple[float, float, float, float], ...]
    spot: Triple | None = None

"""`Track`: one robot's samples as continuous signals, so that any window of time can be averaged without losing turns.

IMU and encoders are integrated over the time between samples, taken on the robot's own clock and aligned with the
host's; a window's mean is the difference of the integrals at its ends. What was not yet heard at a window's end is
continued with the last value, and made good in the next window.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.specification import RobotSpecification
from coop_envs.localization.clocks.alignment import ClockAlignment
from hardware_bridge.reading import Sample

GRAVITY = 9.81
CONTINUED_S = 0.1
"""How long a signal is continued after its last sample; then the robot counts as still."""
KEPT = 512

Vector = NDArray[np.float64]
AT_REST: Vector = np.array([0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY, 0.0, 0.0])
"""Gyro (rad/s), specific force (m/s^2) and wheels (rad/s) of a robot that stands on level ground."""


class Track:
    """The samples of one robot; robots without an IMU turn as their wheels do and feel gravity alone."""

    def __init__(self, robot: RobotSpecification) -> None:
        self._robot = robot
        self._clock = ClockAlignment()
        self._times: deque[float] = deque(maxlen=KEPT)
        self._integrals: deque[Vector] = deque(maxlen=KEPT)
        self._rate = AT_REST
        self._edge: Vector | None = None
        self._angles: tuple[float, float] | None = None
        self.voltage_v: float | None = None
        self.heard_s = -math.inf
        """When the newest sample arrived, on the host's clock; an old one sent again is no sign of life."""

    @property
    def taken_s(self) -> float:
        """When the newest sample was taken, on the host's clock; where the robot gives no stamp, when it arrived."""
        return self._times[-1] if self._times else -math.inf

    def add(self, sample: Sample) -> None:
        """Take in a sample; one that is older than the newest is dropped, for its time has been counted."""
        jumps = self._clock.jumps
        at = sample.host_s if sample.device_s is None else self._clock.align(sample.host_s, sample.device_s)
        if self._clock.jumps != jumps:
            self._angles = None
        if self._times and at <= self._times[-1]:
            return
        self.heard_s = max(self.heard_s, sample.host_s)
        self.voltage_v = sample.voltage_v if sample.voltage_v is not None else self.voltage_v
        dt = at - self._times[-1] if self._times else 0.0
        self._rate = self._rates(sample, dt)
        before = self._integrals[-1] if self._integrals else AT_REST * at
        self._times.append(at)
        self._integrals.append(before + self._rate * dt)
        self._angles = sample.angles_rad

    def _rates(self, sample: Sample, dt: float) -> Vector:
        """Gyro, specific force, wheel speeds over the time since the last sample."""
        wheels = np.asarray(sample.wheels_rad_s)
        if self._angles is not None and dt > 0.0:
            wheels = (np.asarray(sample.angles_rad) - self._angles) / dt
        yaw_rate = (wheels[1] - wheels[0]) * self._robot.wheel_radius_m / self._robot.track_m
        gyro = (0.0, 0.0, yaw_rate) if sample.gyro_rad_s is None else sample.gyro_rad_s
        accel = (0.0, 0.0, GRAVITY) if sample.accel_m_s2 is None else sample.accel_m_s2
        return np.array([*gyro, *accel, *wheels])

    def means(self, start_s: float, edges_s: NDArray[np.float64]) -> tuple[Vector, Vector, Vector]:
        """Means over the windows between ``start_s`` and the edges (T,): gyro (T, 3), force (T, 3), wheels (2,).

        The windows are to follow those of the last call.
        """
        ends = np.array([self._integral(edge) for edge in edges_s])
        first = self._integral(start_s) if self._edge is None else self._edge
        self._edge = ends[-1]
        lengths = np.diff(edges_s, prepend=start_s)
        rates = np.diff(ends, axis=0, prepend=first[None]) / lengths[:, None]
        return rates[:, :3], rates[:, 3:6], lengths @ rates[:, 6:] / lengths.sum()

    def _integral(self, at: float) -> Vector:
        """Of the signal from time 0 on; before the first sample, and long after the last, the robot is at rest."""
        times = self._times
        if not times:
            return AT_REST * at
        if at >= times[-1]:
            past_s = at - times[-1]
            continued_s = min(past_s, CONTINUED_S)
            return self._integrals[-1] + self._rate * continued_s + AT_REST * (past_s - continued_s)
        if at <= times[0]:
            return self._integrals[0] + AT_REST * (at - times[0])
        k = int(np.searchsorted(np.asarray(times), at))
        share = (at - times[k - 1]) / (times[k] - times[k - 1])
        return self._integrals[k - 1] + share * (self._integrals[k] - self._integrals[k - 1])

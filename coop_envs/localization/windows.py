"""From samples at their own times to what the filter takes for a window: means over ticks, wheel speeds, gaps.

An IMU's sample stands for the time since the one before it. A window's means are sums over the samples that reach into
it, each as long as it does, so that no turn is lost or counted twice however samples and windows lie.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.specification import RobotSpecification
from coop_envs.errors import require
from coop_envs.localization.logs.events import ImuSample, Odometry

Array = NDArray[np.float64]

REGULAR = 1.6
"""Samples further apart than this many usual intervals have one or more missing between them."""
COVERED = 0.99
TURN_WALK = 3.0
"""(rad/s)^2/s by which a driven robot's turn rate wanders while it is not heard."""
FORCE_WALK = 30.0
"""(m/s^2)^2/s, its specific force likewise."""


@dataclass(frozen=True)
class Reach:
    """How long samples count.

    An IMU's samples come every ``interval_s``; where they are up to ``bridge_s`` apart the time between is bridged by
    the mean of both. A row of odometry holds until the next, at most ``odometry_s``.
    """

    interval_s: float = 1.0 / 30.0
    bridge_s: float = 0.2
    odometry_s: float = 0.5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(value > 0, f"reach.{name}", value, "more than 0 s")

    @property
    def regular_s(self) -> float:
        return REGULAR * self.interval_s


@dataclass(frozen=True, slots=True)
class Bridge:
    """Missing samples bridged: how long they were, until when, and what share of that time lies in the window."""

    length_s: float
    end_s: float
    share: float

    @property
    def turn_variance(self) -> float:
        """Of the angle turned, about each axis (rad^2): what a random walk tied down at both ends leaves open."""
        return TURN_WALK * self.length_s**3 / 12.0 * self.share

    @property
    def speed_variance(self) -> float:
        """Of the change of velocity along each axis (m^2/s^2)."""
        return FORCE_WALK * self.length_s**3 / 12.0 * self.share


@dataclass(frozen=True, eq=False)
class ImuMeans:
    """Gyro and specific force (T, 3) over a window's ticks; ``heard`` where samples told of all of it."""

    gyro: Array
    accel: Array
    heard: bool
    bridge: Bridge | None = None


def imu_means(
    before: ImuSample | None,
    samples: Sequence[ImuSample],
    after: ImuSample | None,
    edges_s: Array,
    reach: Reach,
) -> ImuMeans:
    """Means over the ticks between the edges (T + 1,).

    ``before`` and ``after`` are the robot's last sample before the window and the first after it; ``samples`` lie in
    it, by time. Without samples for more than ``reach.bridge_s`` the robot counts as not heard, and as at rest.
    """
    told = [sample for sample in (before, *samples, after) if sample is not None]
    spans = np.array([_span(told[k - 1] if k > 0 else None, one, reach) for k, one in enumerate(told)]).reshape(-1, 2)
    rates = np.array([_rates(told[k - 1] if k > 0 else None, one, reach) for k, one in enumerate(told)]).reshape(-1, 6)
    upper, lower = np.minimum(spans[:, 1], edges_s[1:, None]), np.maximum(spans[:, 0], edges_s[:-1, None])
    overlap = np.maximum(upper - lower, 0.0)
    if overlap.sum() < COVERED * (edges_s[-1] - edges_s[0]):
        ticks = len(edges_s) - 1
        return ImuMeans(np.zeros((ticks, 3)), np.tile([0.0, 0.0, 9.81], (ticks, 1)), heard=False)
    covered = overlap.sum(axis=1, keepdims=True)
    means = np.where(covered > 0.0, overlap @ rates / np.maximum(covered, 1e-300), overlap.sum(axis=0) @ rates)
    return ImuMeans(means[:, :3], means[:, 3:], True, _bridge(spans, overlap.sum(axis=0), reach))


def _span(before: ImuSample | None, sample: ImuSample, reach: Reach) -> tuple[float, float]:
    """The time that a sample stands for."""
    since_s = math.inf if before is None else sample.time_s - before.time_s
    length_s = since_s if since_s <= reach.bridge_s else reach.interval_s
    return sample.time_s - length_s, sample.time_s


def _rates(before: ImuSample | None, sample: ImuSample, reach: Reach) -> Array:
    rates = np.concatenate([sample.gyro, sample.accel])
    if before is None or not reach.regular_s < sample.time_s - before.time_s <= reach.bridge_s:
        return rates
    return 0.5 * (rates + np.concatenate([before.gyro, before.accel]))


def _bridge(spans: Array, overlap_s: Array, reach: Reach) -> Bridge | None:
    """The longest bridge in the window."""
    lengths = (spans[:, 1] - spans[:, 0]) * (overlap_s > 0.0)
    k = int(np.argmax(lengths))
    if lengths[k] <= reach.regular_s:
        return None
    return Bridge(float(lengths[k]), float(spans[k, 1]), float(overlap_s[k] / lengths[k]))


@dataclass(frozen=True, slots=True)
class Wheels:
    """Mean wheel speeds of a window, left and right (rad/s), and the motion that they stand for."""

    left_rad_s: float
    right_rad_s: float
    yaw_rate_rad_s: float

    @property
    def stand(self) -> bool:
        """Whether they do not turn."""
        return self.left_rad_s == 0.0 and self.right_rad_s == 0.0


def wheel_means(
    before: Odometry | None,
    rows: Sequence[Odometry],
    start_s: float,
    end_s: float,
    robot: RobotSpecification,
    reach: Reach,
) -> Wheels | None:
    """Wheel speeds over a window from the rows of odometry in it and the last one before; None where rows are missing.

    Source: thesis eq (6.10): the right wheel is the faster one in a turn to the left.
    """
    told = [row for row in (before, *rows) if row is not None]
    if not told:
        return None
    ends = [row.time_s for row in told[1:]] + [end_s]
    length_s = end_s - start_s
    covered = forward = turn = 0.0
    for row, until_s in zip(told, ends, strict=True):
        held_s = min(until_s, row.time_s + reach.odometry_s, end_s) - max(row.time_s, start_s)
        if held_s > 0.0:
            covered += held_s
            forward += held_s * row.forward_m_s / length_s
            turn += held_s * row.yaw_rate_rad_s / length_s
    if covered < COVERED * length_s:
        return None
    half = 0.5 * robot.track_m * turn
    return Wheels((forward - half) / robot.wheel_radius_m, (forward + half) / robot.wheel_radius_m, turn)

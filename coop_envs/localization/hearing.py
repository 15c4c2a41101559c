"""What is heard of one robot in a window: its IMU's means, its wheels, whether it stands still."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.specification import RobotSpecification
from coop_envs.localization.logs.events import ImuSample, Odometry
from coop_envs.localization.rest_detector import ImuNoise, quiet, window_length
from coop_envs.localization.windows import ImuMeans, Reach, Wheels, imu_means, wheel_means

Array = NDArray[np.float64]

FEWEST = 3


@dataclass(frozen=True)
class Listening:
    """What is known of a robot's streams: how often its IMU speaks, how it scatters; whether it has one at all."""

    reach: Reach
    noise: ImuNoise
    has_imu: bool = True

    @property
    def count(self) -> int:
        """Samples that tell whether it rests."""
        return window_length(1.0 / self.reach.interval_s)


@dataclass(frozen=True, slots=True)
class Ear:
    """What was last heard of a robot; ``recent`` are the samples since a gap, as far as they tell whether it rests."""

    imu: ImuSample | None = None
    recent: tuple[ImuSample, ...] = ()
    odometry: Odometry | None = None
    still: bool = True


@dataclass(frozen=True, eq=False)
class Heard:
    """A window's news of a robot; ``wheels`` None where they tell nothing."""

    ear: Ear
    means: ImuMeans
    wheels: Wheels | None

    @property
    def still(self) -> bool:
        """Whether the robot stands still, as far as its own sensors tell."""
        return self.ear.still


def hear(
    ear: Ear,
    events: Sequence[ImuSample | Odometry],
    after: ImuSample | None,
    edges_s: Array,
    model: RobotSpecification,
    listening: Listening,
    bias: Array,
) -> Heard:
    """Take in a robot's events in the window whose ticks lie between ``edges_s`` (T + 1,), and its next IMU sample.

    ``bias`` (3,) of its gyro, as believed.
    """
    imu = [event for event in events if isinstance(event, ImuSample)]
    rows = [event for event in events if isinstance(event, Odometry)]
    wheels = wheel_means(ear.odometry, rows, float(edges_s[0]), float(edges_s[-1]), model, listening.reach)
    if listening.has_imu:
        means = imu_means(ear.imu, imu, after, edges_s, listening.reach)
    else:
        means = _as_wheels_turn(wheels, len(edges_s) - 1)
    recent = (*ear.recent, *imu)[-listening.count :] if means.heard else ()
    still = means.heard and _stands(ear.still, recent, wheels, listening, bias)
    last_imu, last_row = (imu[-1] if imu else ear.imu), (rows[-1] if rows else ear.odometry)
    return Heard(dataclasses.replace(ear, imu=last_imu, recent=recent, odometry=last_row, still=still), means, wheels)


def _stands(
    stood: bool, recent: tuple[ImuSample, ...], wheels: Wheels | None, listening: Listening, bias: Array
) -> bool:
    """Whether a robot stands still by its IMU, or without one by its wheels."""
    if not listening.has_imu:
        return wheels is not None and wheels.stand
    if len(recent) < FEWEST:
        return stood
    if len(recent) < listening.count and not stood:
        return False
    gyro, accel = np.array([one.gyro for one in recent]), np.array([one.accel for one in recent])
    return quiet(gyro, accel, listening.noise, bias)


def _as_wheels_turn(wheels: Wheels | None, ticks: int) -> ImuMeans:
    """What stands in for the IMU of a robot that has none: it turns as its wheels do and feels gravity alone."""
    gyro = np.zeros((ticks, 3))
    gyro[:, 2] = 0.0 if wheels is None else wheels.yaw_rate_rad_s
    return ImuMeans(gyro, np.tile([0.0, 0.0, 9.81], (ticks, 1)), wheels is not None)

"""Whether a robot stands still, by its IMU alone.

Over a short window of samples the gyro's and the accelerometer's scatter about their means are compared with the
sensor's own noise, so that biases and the direction of gravity need not be known; the gyro's mean, and the length of
the mean force, tell of steady turns and of steady pushes.

Source: Skog, Handel, Nilsson, Rantakokko, Zero-velocity detection, IEEE Trans. Biomedical Engineering 57(11), 2010: the
acceleration-moving-variance and angular-rate-energy detectors, which together are a form of its likelihood ratio.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import chdtri

from coop_envs.agents.specification import Imu
from coop_envs.errors import require

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

GRAVITY = 9.81
WINDOW_S, FEWEST = 0.3, 5
CHANCE = 1.0e-4
"""How often the noise of a sensor that is as good as it says would look like motion."""
GYRO_EXCESS, ACCEL_EXCESS = 3.0, 1.7
"""How many times the sensor's own noise the ground may shake a robot that counts as still."""
STEADY_RAD_S, STEADY_M_S2 = 0.02, 0.25
QUIET_SHARE = 0.1
NOISIER = 3.0


@dataclass(frozen=True)
class ImuNoise:
    """Standard deviation of one sample along one axis."""

    gyro_rad_s: float
    accel_m_s2: float

    def __post_init__(self) -> None:
        require(self.gyro_rad_s > 0, "noise.gyro_rad_s", self.gyro_rad_s, "more than 0")
        require(self.accel_m_s2 > 0, "noise.accel_m_s2", self.accel_m_s2, "more than 0")


def specified_noise(imu: Imu, rate_hz: float) -> ImuNoise:
    """What samples of a sensor scatter by, if it gives the mean of the time since the last."""
    root = math.sqrt(rate_hz)
    return ImuNoise(max(imu.gyro_noise_rad_s_rthz * root, 1e-6), max(imu.accel_noise_m_s2_rthz * root, 1e-5))


def noise_of(gyro: Array, accel: Array, rate_hz: float, specified: ImuNoise) -> ImuNoise:
    """What samples (T, 3) scatter by in the calmest tenth of a recording; as specified, up to three times as much."""
    count = window_length(rate_hz)
    if len(gyro) < 2 * count:
        return specified
    calm = [math.sqrt(float(np.quantile(_scatter(x, count), QUIET_SHARE))) for x in (gyro, accel)]
    return ImuNoise(
        min(max(calm[0], specified.gyro_rad_s), NOISIER * specified.gyro_rad_s),
        min(max(calm[1], specified.accel_m_s2), NOISIER * specified.accel_m_s2),
    )


def window_length(rate_hz: float) -> int:
    """Samples of a window."""
    return max(FEWEST, round(WINDOW_S * rate_hz))


def quiet_windows(gyro: Array, accel: Array, noise: ImuNoise, bias: Array, count: int) -> Flags:
    """For every window of ``count`` successive samples (T, 3), whether the robot stood still in it: (T - count + 1,).

    ``bias`` (3,) of the gyro, as far as it is known: a turn slower than 0.02 rad/s beside it is not told from it.
    """
    return _quiet(sliding_window_view(gyro, count, axis=0), sliding_window_view(accel, count, axis=0), noise, bias)


def quiet(gyro: Array, accel: Array, noise: ImuNoise, bias: Array) -> bool:
    """Whether a robot stood still all the while, by samples (T, 3); as `quiet_windows`."""
    return bool(_quiet(gyro.T, accel.T, noise, bias))


def _quiet(gyro: Array, accel: Array, noise: ImuNoise, bias: Array) -> Flags:
    """Of windows (..., 3, count)."""
    degrees = 3 * (gyro.shape[-1] - 1)
    limit = float(chdtri(degrees, CHANCE)) / degrees
    turn, force = gyro.mean(axis=-1) - bias, accel.mean(axis=-1)
    still = gyro.var(axis=-1, ddof=1).mean(axis=-1) < limit * (GYRO_EXCESS * noise.gyro_rad_s) ** 2
    still &= accel.var(axis=-1, ddof=1).mean(axis=-1) < limit * (ACCEL_EXCESS * noise.accel_m_s2) ** 2
    still &= np.linalg.norm(turn, axis=-1) < STEADY_RAD_S
    return still & (np.abs(np.linalg.norm(force, axis=-1) - GRAVITY) < STEADY_M_S2)


def resting(gyro: Array, accel: Array, rate_hz: float, noise: ImuNoise, bias: Array | None = None) -> Flags:
    """For every sample (T, 3) of a recording, whether it lies in a window in which the robot stood still: (T,).

    Where ``bias`` (3,) is not given it is the median turn of the windows without scatter.
    """
    count = window_length(rate_hz)
    flags = np.zeros(len(gyro), dtype=bool)
    if len(gyro) < count:
        return flags
    if bias is None:
        bias = median_turn(gyro, noise, count)
    quiet = quiet_windows(gyro, accel, noise, bias, count)
    covered = np.cumsum(np.concatenate([quiet, np.zeros(count)]) - np.concatenate([np.zeros(count), quiet]))
    flags[:] = covered[: len(flags)] > 0
    return flags


def median_turn(gyro: Array, noise: ImuNoise, count: int) -> Array:
    """Median gyro (3,) of the windows that scatter no more than a sensor at rest may; zero without any."""
    calm = _scatter(gyro, count) < (GYRO_EXCESS * noise.gyro_rad_s) ** 2
    means = sliding_window_view(gyro, count, axis=0).mean(axis=-1)[calm]
    return np.median(means, axis=0) if len(means) else np.zeros(3)


def _scatter(signal: Array, count: int) -> Array:
    """Mean variance of the three axes over every window of samples, unbiased."""
    return sliding_window_view(signal, count, axis=0).var(axis=-1, ddof=1).mean(axis=-1)

"""However samples and windows lie, no turn is lost; gaps are bridged, or said."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_robot
from coop_envs.errors import ConfigError
from coop_envs.localization.logs.events import ImuSample, Odometry
from coop_envs.localization.windows import Reach, imu_means, wheel_means

REACH = Reach(interval_s=0.01, bridge_s=0.2)
ZUMY = load_robot("zumy")


def turn_rad(t):
    return 0.4 * t + 0.5 * (1.0 - np.cos(2.0 * t))


def samples(times) -> list[ImuSample]:
    """Each the mean since the one before of a robot that swings to and fro."""
    times = np.asarray(times, dtype=float)
    before = np.concatenate([[times[0] - REACH.interval_s], times[:-1]])
    rate = (turn_rad(times) - turn_rad(before)) / (times - before)
    accel = np.array([0.0, 0.0, 9.81])
    return [ImuSample(float(t), "r", np.array([0.0, 0.0, w]), accel) for t, w in zip(times, rate, strict=True)]


def turned(told: list[ImuSample], edges, reach=REACH, ticks=3) -> float:
    """The sum of all windows' turns."""
    total = 0.0
    for start, end in itertools.pairwise(edges):
        inside = [one for one in told if start < one.time_s <= end]
        before = max((one for one in told if one.time_s <= start), key=lambda one: one.time_s, default=None)
        after = min((one for one in told if one.time_s > end), key=lambda one: one.time_s, default=None)
        means = imu_means(before, inside, after, np.linspace(start, end, ticks + 1), reach)
        assert means.heard
        total += float(means.gyro[:, 2].mean()) * (end - start)
        np.testing.assert_allclose(means.accel, np.tile([0.0, 0.0, 9.81], (ticks, 1)), atol=1e-12)
    return total


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 5))
def test_windows_of_any_length_add_up_to_the_turn(seed, ticks):
    """Windows that end where samples do hold the whole turn to the last digit, however they are cut in between."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.004, 0.0155, 150))
    told = samples(times)
    edges = np.concatenate([[times[5]], np.sort(rng.uniform(times[5], times[-1], 12)), [times[-1]]])
    assert turned(told, edges, ticks=ticks) == pytest.approx(turn_rad(times[-1]) - turn_rad(times[5]), abs=1e-12)


def test_a_window_between_two_samples_takes_the_next_ones_rate():
    first, second = samples([0.10, 0.11])
    means = imu_means(first, [], second, np.array([0.102, 0.105]), REACH)
    assert means.heard and means.gyro[0, 2] == second.gyro[2] and means.bridge is None


def test_missing_samples_are_bridged_by_the_mean_and_said():
    first, second = samples([0.10, 0.20])
    means = imu_means(first, [], second, np.array([0.10, 0.15]), REACH)
    assert means.heard and means.bridge is not None
    assert means.gyro[0, 2] == pytest.approx(0.5 * (first.gyro[2] + second.gyro[2]))
    assert means.bridge.length_s == pytest.approx(0.1) and means.bridge.share == pytest.approx(0.5)
    assert means.bridge.end_s == 0.20


def test_the_variance_of_a_bridge_is_that_of_a_random_walk_tied_at_both_ends():
    """Against walks drawn by the thousand: what the mean of the ends misses of their integral, and its spread."""
    rng = np.random.default_rng(0)
    first, second = samples([0.0, 0.2])
    bridge = imu_means(first, [], second, np.array([0.0, 0.2]), REACH).bridge
    assert bridge is not None
    steps = 400
    walk = np.cumsum(rng.normal(0.0, np.sqrt(3.0 * 0.2 / steps), (20_000, steps)), axis=1)
    missed = walk.mean(axis=1) * 0.2 - 0.5 * walk[:, -1] * 0.2
    assert missed.var() == pytest.approx(bridge.turn_variance, rel=0.05)


@pytest.mark.parametrize("edges", [(0.10, 0.20), (0.30, 0.39), (0.395, 0.41)])
def test_a_gap_is_never_integrated_over(edges):
    """0.35 s without samples: windows in it are not heard; the last is, once the next sample covers it."""
    first, second = samples([0.10, 0.45])
    means = imu_means(first, [], second, np.array(edges), REACH)
    assert not means.heard and not means.gyro.any()
    assert imu_means(first, [], second, np.array([0.441, 0.45]), REACH).heard
    assert not imu_means(None, [], None, np.array([0.0, 0.1]), REACH).heard


def test_wheels_roll_as_odometry_says_until_the_next_row():
    rows = [Odometry(0.1, "r", 0.2, 0.0), Odometry(0.3, "r", 0.0, 1.0)]
    wheels = wheel_means(rows[0], rows[1:], 0.2, 0.4, ZUMY, REACH)
    assert wheels is not None
    assert wheels.yaw_rate_rad_s == pytest.approx(0.5)
    assert 0.5 * (wheels.left_rad_s + wheels.right_rad_s) * ZUMY.wheel_radius_m == pytest.approx(0.1)
    assert (wheels.right_rad_s - wheels.left_rad_s) * ZUMY.wheel_radius_m / ZUMY.track_m == pytest.approx(0.5)


def test_old_odometry_tells_nothing():
    row = Odometry(0.0, "r", 0.2, 0.0)
    assert wheel_means(row, [], 0.45, 0.5, ZUMY, REACH) is not None
    assert wheel_means(row, [], 0.45, 0.55, ZUMY, REACH) is None
    assert wheel_means(None, [], 0.0, 0.1, ZUMY, REACH) is None


def test_lengths_of_time_are_positive():
    with pytest.raises(ConfigError, match=r"reach\.bridge_s: got 0\.0, expected more than 0 s"):
        Reach(bridge_s=0.0)

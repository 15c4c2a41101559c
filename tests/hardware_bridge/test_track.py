"""A robot's samples as signals: whatever is lost, late or stamped by a drifting clock, no turn is lost."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_team
from hardware_bridge.reading import Sample
from hardware_bridge.track import CONTINUED_S, GRAVITY, Track

ZUMY = load_team("surveyors").members[0].robot
TICK_S = 1 / 30


def turn_rad(t):
    """Integral of the yaw rate below: a robot that swings to and fro, and turns left on the whole."""
    return 0.4 * t + (1.0 - np.cos(2.0 * t)) * 0.5


def yaw_rate_rad_s(t):
    return 0.4 + np.sin(2.0 * t)


def wheel_rad(t):
    return np.array([3.0 * t - np.cos(t) + 1.0, 3.0 * t + np.cos(t) - 1.0])


def sample(taken_s, host_s, device_s=None, since_s=None, **changes):
    """What an IMU that averages since ``since_s`` (at once, if None) says at ``taken_s``."""
    mean = yaw_rate_rad_s(taken_s)
    if since_s is not None and taken_s > since_s:
        mean = (turn_rad(taken_s) - turn_rad(since_s)) / (taken_s - since_s)
    left, right = wheel_rad(taken_s)
    speeds = (3.0 + math.sin(taken_s), 3.0 - math.sin(taken_s))
    made = Sample(host_s, device_s, (left, right), speeds, (0.0, 0.0, float(mean)), (0.1, -0.2, 9.8))
    return replace(made, **changes)


def six_ticks(start):
    return np.array([start + TICK_S * k for k in range(1, 7)])


def in_order(arrivals_s):
    """No link lets one report overtake another."""
    return np.maximum.accumulate(arrivals_s)


def total(track, edges, arrivals):
    """Feed samples as they arrive, average decision by decision; turn, and way of the wheels."""
    waiting = sorted(arrivals, key=lambda one: one.host_s)
    turned, rolled, start = 0.0, np.zeros(2), 0.0
    for end in edges:
        while waiting and waiting[0].host_s <= end:
            track.add(waiting.pop(0))
        ticks = np.linspace(start, end, 7)[1:]
        gyro, force, wheels = track.means(start, ticks)
        assert np.isfinite(force).all()
        turned += float(gyro[:, 2].sum()) * (end - start) / 6
        rolled = rolled + wheels * (end - start)
        start = end
    return turned, rolled


def test_a_constant_signal_is_its_own_mean():
    track = Track(ZUMY)
    for k in range(40):
        track.add(Sample(k * TICK_S, None, (k * 0.1, -k * 0.1), (3.0, -3.0), (0.1, 0.2, 0.3), (1.0, 2.0, 9.0)))
    gyro, force, wheels = track.means(0.5, six_ticks(0.5))
    np.testing.assert_allclose(gyro, np.tile([0.1, 0.2, 0.3], (6, 1)), atol=1e-12)
    np.testing.assert_allclose(force, np.tile([1.0, 2.0, 9.0], (6, 1)), atol=1e-12)
    np.testing.assert_allclose(wheels, [3.0, -3.0], atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.6), st.floats(0.0, 0.15))
def test_no_turn_is_lost_to_lost_and_late_samples(seed, lost, late_s):
    """The sum of the windows is the true turn, but for what is not yet heard; wheels count each revolution."""
    rng = np.random.default_rng(seed)
    taken = np.cumsum(rng.uniform(0.004, 0.03, size=250))
    taken = taken[(rng.random(len(taken)) >= lost) | (taken < 0.05)]
    heard = in_order(taken + late_s * rng.random(len(taken)))
    since = [0.0, *taken[:-1]]
    arrivals = [sample(t, at, t, before) for t, at, before in zip(taken, heard, since, strict=True)]
    edges = np.cumsum(rng.uniform(0.15, 0.25, size=9))
    silent_s = 0.2  # the last window may end in a gap of lost samples
    turned, rolled = total(Track(ZUMY), edges, arrivals)
    np.testing.assert_allclose(rolled, wheel_rad(edges[-1]), atol=4.0 * (silent_s + late_s))
    assert abs(turned - turn_rad(edges[-1])) < 1.4 * (silent_s + late_s)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.6))
def test_whatever_was_lost_the_last_sample_makes_it_good(seed, lost):
    rng = np.random.default_rng(seed)
    taken = np.cumsum(rng.uniform(0.004, 0.03, size=250))
    taken = taken[rng.random(len(taken)) >= lost]
    arrivals = [sample(t, t, t, before) for t, before in zip(taken, [0.0, *taken[:-1]], strict=True)]
    inner = np.cumsum(rng.uniform(0.15, 0.25, size=9))
    edges = [*inner[inner < taken[-1]], taken[-1]]
    turned, rolled = total(Track(ZUMY), edges, arrivals)
    first = taken[0]
    assert turned == pytest.approx(turn_rad(edges[-1]) - turn_rad(first), abs=1e-6)
    np.testing.assert_allclose(rolled, wheel_rad(edges[-1]) - wheel_rad(first), atol=1e-5)


def test_what_comes_after_a_window_is_made_good_in_the_next():
    """Two windows with nothing heard in the second: the third holds the turn of both, to the last digit."""
    track = Track(ZUMY)
    arrivals = [sample(t, t, since_s=t - 0.01) for t in np.arange(0.0, 0.2, 0.01)]
    arrivals += [sample(0.55, 0.55, since_s=arrivals[-1].host_s)]
    turned, rolled = total(track, [0.2, 0.4, 0.55], arrivals)
    assert turned == pytest.approx(turn_rad(0.55), abs=1e-12)
    np.testing.assert_allclose(rolled, wheel_rad(0.55), atol=1e-12)


@pytest.mark.parametrize("ppm", [-150.0, 0.0, 150.0])
def test_a_drifting_clock_makes_no_drift(ppm):
    """Two minutes at 50 Hz: at the end the turn is right to a few milliseconds of the fastest turn."""
    rng = np.random.default_rng(1)
    taken = np.arange(0.02, 120.0, 0.02)
    heard = in_order(taken + rng.exponential(0.004, size=len(taken)))
    arrivals = [
        sample(t, at, 777.0 + t * (1.0 + ppm * 1e-6), t - 0.02 if t > 0.03 else None)
        for t, at in zip(taken, heard, strict=True)
    ]
    turned, rolled = total(Track(ZUMY), np.arange(0.2, 119.9, 0.2), arrivals)
    assert abs(turned - turn_rad(119.8)) < 0.015
    np.testing.assert_allclose(rolled, wheel_rad(119.8) - wheel_rad(taken[0]), atol=0.02)


def test_a_clock_that_jumps_costs_no_more_than_a_sample():
    """The robot's computer starts anew: its clock and its wheels' angles begin at 0."""
    track = Track(ZUMY)
    speeds, gyro = (3.0, 3.0), (0.0, 0.0, 0.4)
    first = [Sample(t, 100.0 + t, (3 * t, 3 * t), speeds, gyro) for t in np.arange(0.0, 1.0, 0.02)]
    second = [Sample(t, t - 1.0, (3 * (t - 1.0), 3 * (t - 1.0)), speeds, gyro) for t in np.arange(1.0, 2.01, 0.02)]
    turned, rolled = total(track, np.arange(0.2, 2.01, 0.2), [*first, *second])
    assert turned == pytest.approx(0.8, abs=0.4 * 0.021)
    np.testing.assert_allclose(rolled, [6.0, 6.0], atol=3.0 * 0.021)


def test_robots_without_an_imu_turn_as_their_wheels_do():
    track = Track(ZUMY)
    for k in range(20):
        track.add(Sample(k * TICK_S, None, (-k * 0.1, k * 0.1), (-3.0, 3.0)))
    gyro, force, wheels = track.means(0.2, six_ticks(0.2))
    np.testing.assert_allclose(gyro[:, 2], 6.0 * ZUMY.wheel_radius_m / ZUMY.track_m)
    np.testing.assert_allclose(force, np.tile([0.0, 0.0, GRAVITY], (6, 1)), atol=1e-9)
    np.testing.assert_allclose(wheels, [-3.0, 3.0])


def test_a_robot_that_falls_silent_counts_as_still():
    track = Track(ZUMY)
    for t in (0.0, 0.1, 0.2):
        track.add(Sample(t, None, (3 * t, 3 * t), (3.0, 3.0), (0.0, 0.0, 0.5)))
    track.means(0.0, np.array([0.2]))
    gyro, force, wheels = track.means(0.2, np.array([0.2 + CONTINUED_S, 1.0, 2.0]))
    np.testing.assert_allclose(gyro[:, 2], [0.5, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(force[1:, 2], GRAVITY)
    np.testing.assert_allclose(wheels * 1.8, [3.0 * CONTINUED_S] * 2)


def test_a_robot_that_was_never_heard_stands_on_level_ground_and_so_it_does_when_it_speaks_up():
    """A reserve that is switched on after a minute: no window may hold the minute's gravity in one."""
    track = Track(ZUMY)
    for start in np.arange(0.0, 60.0, 0.2):
        _, force, _ = track.means(start, six_ticks(start))
        np.testing.assert_allclose(force, np.tile([0.0, 0.0, GRAVITY], (6, 1)), atol=1e-6)
    assert track.heard_s == -math.inf
    for k in range(7):
        track.add(Sample(60.0 + k * TICK_S, None, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)))
    gyro, force, _ = track.means(60.0, six_ticks(60.0))
    assert np.abs(gyro).max() < 1e-9
    assert np.abs(force - (0.0, 0.0, 9.8)).max() < 0.02


def test_an_old_report_sent_again_is_no_sign_of_life():
    track = Track(ZUMY)
    track.add(sample(0.1, 0.11, 0.1, voltage_v=7.0))
    assert track.heard_s == 0.11 and track.voltage_v == 7.0
    track.add(sample(0.1, 0.5, 0.1, voltage_v=6.0))
    assert track.heard_s == 0.11 and track.voltage_v == 7.0
    track.add(sample(0.6, 0.61, 0.6))
    assert track.heard_s == 0.61 and track.voltage_v == 7.0


def test_a_sample_that_comes_twice_counts_once():
    track = Track(ZUMY)
    for host, t in ((0.0, 0.0), (0.1, 0.1), (0.2, 0.2), (0.25, 0.2), (0.3, 0.3), (0.4, 0.4)):
        track.add(Sample(host, t, (3 * t, 3 * t), (3.0, 3.0), (0.0, 0.0, 0.5)))
    gyro, _, wheels = track.means(0.0, np.array([0.4]))
    assert gyro[0, 2] == pytest.approx(0.5)
    np.testing.assert_allclose(wheels, [3.0, 3.0])

"""Speeds and accelerations: within limits, on the same curve, and never in the way of a stop."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware_bridge.safety import SafetyLimits, Situation
from tests.hardware_bridge.safety.builders import TICK_S, Rig, apart, wheels

WELL = Situation(robots=apart(1))
ZUMY_WHEEL_M, ZUMY_TRACK_M = 0.02, 0.1
speeds = st.floats(-200.0, 200.0)


@given(speeds, speeds)
def test_speeds_are_limited_on_the_same_curve(left, right):
    commands, _ = Rig(SafetyLimits(max_accel_m_s2=None), robots=1)(wheels((left, right)), WELL)
    out_left, out_right = commands[0].wheels_rad_s
    assert max(abs(out_left), abs(out_right)) * ZUMY_WHEEL_M <= 0.5 * (1 + 1e-6)
    assert abs(out_right - out_left) * ZUMY_WHEEL_M / ZUMY_TRACK_M <= 3.0 * (1 + 1e-6)
    assert out_left * right == pytest.approx(out_right * left, rel=1e-9, abs=1e-9), "the same ratio of wheels"
    assert out_left * left >= 0 and out_right * right >= 0, "the same sense"


def test_the_robots_own_limits_hold_too():
    """A Zumy can 1 m/s and 6 rad/s; that is 50 rad/s at the wheel."""
    fast = SafetyLimits(max_speed_m_s=9.0, max_yaw_rate_rad_s=99.0, max_accel_m_s2=None)
    assert Rig(fast, robots=1)(wheels((100.0, 100.0)), WELL)[0][0].wheels_rad_s == pytest.approx((50.0, 50.0))
    assert Rig(fast, robots=1)(wheels((-40.0, 40.0)), WELL)[0][0].wheels_rad_s == pytest.approx((-15.0, 15.0))


@given(st.lists(st.tuples(speeds, speeds), min_size=2, max_size=12))
def test_wheels_gain_speed_slowly_on_the_same_curve(wishes):
    rig, step = Rig(robots=1), 4.0 * TICK_S / ZUMY_WHEEL_M
    before = (0.0, 0.0)
    for wish in wishes:
        (command,), _ = rig(wheels(wish), WELL)
        for was, now in zip(before, command.wheels_rad_s, strict=True):
            gained = abs(now) - (abs(was) if was * now > 0 else 0.0)
            assert gained <= step * (1 + 1e-6)
        left, right = command.wheels_rad_s
        assert left * wish[1] == pytest.approx(right * wish[0], rel=1e-9, abs=1e-9)
        before = command.wheels_rad_s


def test_full_speed_is_reached_in_the_time_that_the_acceleration_takes():
    """0.5 m/s at 4 m/s^2: 0.125 s, the fourth tick."""
    rig = Rig(robots=1)
    rim = [rig(wheels((25.0, 25.0)), WELL)[0][0].wheels_rad_s[0] * ZUMY_WHEEL_M for _ in range(5)]
    assert rim == pytest.approx([4 / 30, 8 / 30, 12 / 30, 0.5, 0.5])


def test_a_wanted_stop_is_immediate_and_exact():
    rig = Rig(SafetyLimits(max_accel_m_s2=0.5), robots=1)
    assert rig.steady(wheels((20.0, 19.0)), WELL, 30)[0].wheels_rad_s[0] > 10.0
    (command,), told = rig(wheels((0.0, 0.0)), WELL)
    assert command.wheels_rad_s == (0.0, 0.0) and told == ()


@pytest.mark.parametrize("time_s", [math.nan, math.inf, -1e9, 1e9])
def test_a_clock_that_jumps_gives_no_speed(time_s):
    rig = Rig(SafetyLimits(max_accel_m_s2=1.0), robots=1)
    for k in range(3):
        rig.supervisor.release(k * TICK_S, wheels((25.0, 25.0)), WELL)
    (safe,), _ = rig.supervisor.release(time_s, wheels((25.0, 25.0)), WELL)
    most_m_s = 3 * TICK_S + 0.1  # three ticks, and the longest that a tick may count for
    assert 0.0 <= safe.command.wheels_rad_s[0] * ZUMY_WHEEL_M <= most_m_s + 1e-9
    (after,), _ = rig.supervisor.release(4 * TICK_S, wheels((25.0, 25.0)), WELL)
    assert after.command.wheels_rad_s[0] * ZUMY_WHEEL_M <= most_m_s + 0.1

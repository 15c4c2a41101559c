"""Whatever is wanted, in whatever situation: what is released is finite and within limits, and nothing is raised."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware_bridge.command import RobotCommand, SafeCommand, checked_safe
from hardware_bridge.safety import RobotSituation, SafetyLimits, Situation, Supervisor, stopped_commands
from tests.hardware_bridge.safety.builders import TICK_S, Rig, apart, team_of, wheels

LIMITS = SafetyLimits(geofence=(-3.0, -3.0, 3.0, 3.0), laser_max_on_s=1.0)
number = st.floats() | st.floats(-30.0, 30.0)
pair = st.tuples(number, number)
command = st.builds(RobotCommand, pair, number, number, st.tuples(st.integers(-300, 300), st.integers(-300, 300)))
nonsense = (
    st.none() | st.text(max_size=3) | st.builds(RobotCommand, st.none() | st.tuples(number) | st.text(max_size=2))
)
entry = command | nonsense
age = st.floats() | st.floats(0.0, 0.5)
robot = st.builds(
    RobotSituation,
    position_m=st.tuples(st.floats(-1, 1), st.floats(-1, 1)) | pair,
    yaw_rad=number,
    sigma_m=age,
    sample_age_s=age,
    pose_age_s=age,
    battery=st.none() | age,
    stationary=st.booleans(),
    at_work=st.booleans() | st.just(True),
    docked=st.booleans() | st.just(False),
    permitted=st.booleans() | st.just(True),
)
situation = st.builds(
    Situation,
    robots=st.tuples(robot, robot, robot),
    policy_age_s=age,
    estop=st.booleans() | st.just(False),
    release_estop=st.booleans(),
    human=st.none() | st.tuples(st.none() | command, st.none() | entry, st.none()),
    human_age_s=age,
    laser_allowed=st.booleans() | st.just(True),
)
wanted = st.tuples(command, command, entry) | st.lists(entry, max_size=4).map(tuple) | st.none()
ticks = st.lists(st.tuples(st.floats() | st.just(TICK_S), wanted, situation), min_size=1, max_size=6)


@settings(max_examples=150, deadline=None)
@given(ticks)
def test_properties(calls):
    supervisor = Supervisor(LIMITS, team_of(3))
    latched = False
    for time_s, commands, now in calls:
        released, told = supervisor.release(time_s, commands, now)
        latched = now.estop or (latched and not now.release_estop)
        assert supervisor.estop_latched == latched, "the e-stop stays until it is released"
        assert "broken" not in {one.rule for one in told}
        assert len(released) == 3
        for safe, well in zip(released, now.robots, strict=True):
            _check(checked_safe(safe), well, now, latched)


def _check(released: RobotCommand, well: RobotSituation, now: Situation, latched: bool) -> None:
    left, right = released.wheels_rad_s
    numbers = (left, right, released.brightness, released.laser, *released.galvo)
    assert all(math.isfinite(value) for value in numbers)
    assert max(abs(left), abs(right)) * 0.02 <= 0.5 * (1 + 1e-6) and abs(right - left) * 0.2 <= 3.0 * (1 + 1e-6)
    assert 0.0 <= released.brightness <= 1.0 and 0.0 <= released.laser <= 1.0
    assert all(abs(count) <= 200 for count in released.galvo)
    ages = well.sample_age_s <= 0.25 and well.pose_age_s <= 0.4 and well.sigma_m <= 0.5
    sound = ages and well.at_work and well.placed and not latched
    sound = sound and (well.battery is None or well.battery >= 0.1)
    if not sound:
        assert released.wheels_rad_s == (0.0, 0.0) and released.laser == 0.0 and released.galvo == (0, 0)
    if not (released.stands and well.stationary and now.laser_allowed):
        assert released.laser == 0.0
    if not well.permitted:
        assert released.stands


@settings(max_examples=50, deadline=None)
@given(ticks)
def test_the_same_calls_give_the_same_answers_bit_for_bit(calls):
    one, other = (Supervisor(LIMITS, team_of(3)) for _ in range(2))
    for call in calls:
        assert repr(one.release(*call)) == repr(other.release(*call))


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (wheels((math.nan, 1.0)), "wheels_rad_s: got nan, expected a finite number"),
        (wheels((1.0, -math.inf)), "wheels_rad_s: got -inf, expected a finite number"),
        (wheels((1e7, 0.0)), "wheels_rad_s: got 1e+07, expected a finite number"),
        (wheels((1.0, 1.0), laser=math.nan), "laser: got nan, expected a finite number"),
        ((None,), "got NoneType, expected a RobotCommand"),
        ((), "got 0 commands, expected 1 commands"),
        (wheels((1.0, 1.0), (1.0, 1.0)), "got 2 commands, expected 1 commands"),
        (None, "got NoneType, expected 1 commands"),
    ],
)
def test_what_is_no_command_is_told_and_stands(bad, says):
    commands, told = Rig(robots=1)(bad, Situation(robots=apart(1)))
    assert commands == [RobotCommand()]
    assert [(one.rule, one.reason) for one in told] == [("not a command", says)]


def test_numpys_numbers_are_numbers():
    array = np.array([2.0, 3.0], dtype=np.float32)
    (command,), told = Rig(robots=1)((RobotCommand((array[0], array[1])),), Situation(robots=apart(1)))
    assert command.wheels_rad_s == (2.0, 3.0) and type(command.wheels_rad_s[0]) is float and told == ()


@pytest.mark.parametrize("broken", [Situation(robots=()), Situation(robots=apart(3)), None])
def test_a_broken_situation_stands_everybody(broken):
    rig = Rig()
    rig.steady(wheels((5.0, 5.0), (5.0, 5.0)), Situation(robots=apart()))
    commands, told = rig(wheels((5.0, 5.0), (5.0, 5.0)), broken)
    assert all(one.stands for one in commands) and {one.rule for one in told} == {"broken"}


def test_an_estop_in_a_broken_situation_latches():
    rig = Rig()
    rig(wheels((5.0, 5.0), (5.0, 5.0)), Situation(robots=(), estop=True))
    assert all(one.stands for one in rig(wheels((5.0, 5.0), (5.0, 5.0)), Situation(robots=apart()))[0])


def test_faults_win_over_whatever_comes_later():
    """A stopped robot next to another, at the fence, told to speed by a person: it stands."""
    close = tuple(replace(one, position_m=(2.9, 0.2 * k), pose_age_s=9.0) for k, one in enumerate(apart()))
    both = wheels((50.0, 50.0), (50.0, 50.0))
    commands, _ = Rig(LIMITS)(both, Situation(robots=close, human=both, human_age_s=0.0))
    assert [one.wheels_rad_s for one in commands] == [(0.0, 0.0)] * 2


def test_start_up_commands_stand_dark():
    assert [checked_safe(safe) for safe in stopped_commands(3)] == [RobotCommand()] * 3
    assert all(isinstance(safe, SafeCommand) for safe in stopped_commands(3))

"""E-stop, silence, people, poses, battery, loss: who stands, when, and until when."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from hardware_bridge.command import RobotCommand
from hardware_bridge.safety import SafetyLimits, Situation
from tests.hardware_bridge.safety.builders import Rig, apart, wheels

GO = wheels((5.0, 5.0), (4.0, 5.0), brightness=0.5)
WELL = Situation(robots=apart())


def rules(told):
    return {(one.robot, one.rule) for one in told}


def with_robot(place, **changes):
    robots = list(WELL.robots)
    robots[place] = replace(robots[place], **changes)
    return replace(WELL, robots=tuple(robots))


def test_well_robots_get_what_is_wanted():
    rig = Rig()
    assert rig(GO, WELL) == (list(GO), ())


def test_estop_stops_at_once_and_stays_until_released():
    rig = Rig(SafetyLimits(max_accel_m_s2=0.1))
    assert rig.steady(GO, WELL, 60)[0].wheels_rad_s[0] > 1.0
    commands, told = rig(GO, replace(WELL, estop=True))
    assert [c.wheels_rad_s for c in commands] == [(0.0, 0.0)] * 2, "acceleration limits do not delay it"
    assert rules(told) == {("observer_0", "e-stop"), ("picket_0", "e-stop")}
    assert all(c.stands for c in rig(GO, WELL)[0]) and rig.supervisor.estop_latched
    assert all(c.stands for c in rig(GO, replace(WELL, estop=True, release_estop=True))[0]), "still pressed"
    assert all(c.stands for c in rig(GO, WELL)[0])
    assert not any(c.stands for c in rig(GO, replace(WELL, release_estop=True))[0])
    assert not rig.supervisor.estop_latched


def test_estop_wins_over_a_person():
    driven = replace(WELL, human=GO, human_age_s=0.0, estop=True)
    assert all(c.stands for c in Rig()(GO, driven)[0])


def test_hats_stay_lit_on_robots_that_are_stopped():
    commands, _ = Rig()(GO, replace(WELL, estop=True))
    assert [c.brightness for c in commands] == [0.5, 0.5]


@pytest.mark.parametrize("age", [0.41, math.inf, math.nan])
def test_a_silent_policy_stands_everybody_but_those_a_person_drives(age):
    rig = Rig()
    commands, told = rig(GO, replace(WELL, policy_age_s=age, human=(GO[1], None), human_age_s=0.1))
    assert commands == [GO[1], RobotCommand(brightness=0.5)]
    assert ("picket_0", "deadman") in rules(told)
    assert not any(c.stands for c in rig(GO, replace(WELL, policy_age_s=0.39, human=(None, None), human_age_s=0.1))[0])


def test_a_person_keeps_a_robot_until_giving_it_back():
    rig = Rig()
    drive = RobotCommand((3.0, 3.0))
    assert rig(GO, replace(WELL, human=(drive, None), human_age_s=0.0))[0] == [drive, GO[1]]
    silent = replace(WELL, human=(drive, None), human_age_s=0.5)
    commands, told = rig(GO, silent)
    assert commands[0].stands and commands[1] == GO[1]
    assert rules(told) == {("observer_0", "human silent")}
    assert rig(GO, WELL)[0][0].stands, "nobody at the controls"
    assert rig(GO, replace(WELL, human=(None, None), human_age_s=9.0))[0][0].stands, "nobody is there to give it back"
    assert rig(GO, replace(WELL, human=(None, None), human_age_s=0.1))[0] == list(GO)


def test_a_persons_command_is_checked_too():
    bad = RobotCommand((math.nan, 0.0))
    commands, told = Rig()(GO, replace(WELL, human=(bad, None), human_age_s=0.0))
    assert commands[0].stands and commands[1] == GO[1]
    assert ("observer_0", "not a command") in rules(told)


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"sample_age_s": 0.26}, "silent robot"),
        ({"sample_age_s": math.nan}, "silent robot"),
        ({"pose_age_s": 0.41}, "old pose"),
        ({"pose_age_s": math.inf}, "old pose"),
        ({"sigma_m": 0.51}, "vague pose"),
        ({"sigma_m": math.nan}, "vague pose"),
        ({"position_m": (math.nan, 0.0)}, "no pose"),
        ({"yaw_rad": math.inf}, "no pose"),
        ({"battery": 0.09}, "battery"),
        ({"battery": math.nan}, "battery"),
        ({"at_work": False}, "not at work"),
        ({"at_work": False, "docked": True}, "not at work"),
        ({"permitted": False}, "inchworm"),
    ],
)
def test_one_robots_fault_stands_that_robot(changes, rule):
    rig = Rig()
    rig.steady(GO, WELL)
    commands, told = rig(GO, with_robot(0, **changes))
    assert commands == [RobotCommand(brightness=0.5), GO[1]]
    assert rules(told) == {("observer_0", rule)}
    assert told[0].before == GO[0] and told[0].after == commands[0] and told[0].reason


@pytest.mark.parametrize(
    "changes",
    [{"sample_age_s": 0.24}, {"pose_age_s": 0.39}, {"sigma_m": 0.49}, {"battery": 0.11}, {"battery": None}],
)
def test_within_the_limit_nothing_happens(changes):
    assert Rig()(GO, with_robot(0, **changes)) == (list(GO), ())


def test_faults_are_told_even_of_robots_that_stand():
    told = Rig()(wheels((0.0, 0.0), (0.0, 0.0)), with_robot(1, sample_age_s=1.25))[1]
    assert rules(told) == {("picket_0", "silent robot")}
    assert "1.25 s" in told[0].reason and "0.25 s" in told[0].reason


def test_a_repeated_intervention_says_so():
    rig = Rig()
    stale = with_robot(0, pose_age_s=1.0)
    assert [[one.again for one in rig(GO, s)[1]] for s in (stale, stale, WELL, stale)] == [[False], [True], [], [False]]


def test_battery_has_hysteresis():
    rig = Rig()
    stands = [rig(GO, with_robot(0, battery=share))[0][0].stands for share in (0.12, 0.09, 0.12, 0.149, 0.15, 0.11)]
    assert stands == [False, True, True, True, False, False]


def test_rules_that_are_switched_off():
    off = SafetyLimits(max_pose_age_s=None, max_sigma_m=None, battery_floor=None, inchworm=False)
    blind = with_robot(0, pose_age_s=99.0, sigma_m=9.0, battery=0.0, permitted=False)
    assert Rig(off)(GO, blind) == (list(GO), ())

"""A laser is lit on robots at rest without a fault, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from coop_envs.agents.catalog import load_team
from hardware_bridge.command import RobotCommand
from hardware_bridge.safety import SafetyLimits, Situation, Supervisor
from tests.hardware_bridge.safety.builders import TICK_S, Rig, apart

LIT = RobotCommand(laser=1.0, galvo=(3, -2), brightness=0.2)
REST = Situation(robots=apart(1, stationary=True))


def told(situation, wanted=LIT, limits=None):
    return Rig(limits or SafetyLimits(), robots=1)((wanted,), situation)[0][0]


def test_lit_at_rest():
    assert told(REST) == LIT
    assert told(replace(REST, robots=apart(1, stationary=True, permitted=False))) == LIT, "who may not move may scan"


@pytest.mark.parametrize(
    "fault",
    [
        {"sample_age_s": 1.0}, {"pose_age_s": 1.0}, {"sigma_m": 1.0}, {"sigma_m": float("nan")}, {"battery": 0.01},
        {"at_work": False},
    ],
)  # fmt: skip
def test_a_fault_darkens_it_and_stills_its_mirror(fault):
    assert told(Situation(robots=apart(1, stationary=True, **fault))) == RobotCommand(brightness=0.2)


@pytest.mark.parametrize("change", [{"estop": True}, {"policy_age_s": 9.0}])
def test_so_does_a_fault_of_all(change):
    assert told(replace(REST, **change)) == RobotCommand(brightness=0.2)


def test_dark_while_it_moves_and_the_mirror_goes_home():
    rolling = Situation(robots=apart(1, stationary=False))
    assert told(rolling) == replace(LIT, laser=0.0)
    driving = replace(LIT, wheels_rad_s=(2.0, 2.0))
    assert told(REST, driving) == replace(driving, laser=0.0)


def test_dark_until_people_release_it():
    assert told(replace(REST, laser_allowed=False)) == replace(LIT, laser=0.0)


def test_dark_on_robots_without_a_laser():
    team = load_team("inchworm")
    robots = Situation(robots=apart(3, stationary=True))
    released, interventions = Supervisor(SafetyLimits(), team).release(0.0, (LIT,) * 3, robots)
    assert [safe.command.laser for safe in released] == [0.0] * 3
    assert {one.reason for one in interventions} == {"it carries no laser"}


def test_out_of_range_is_clipped():
    command = told(REST, RobotCommand(laser=7.0, brightness=-1.0, galvo=(-999, 999)))
    assert command == RobotCommand(laser=1.0, brightness=0.0, galvo=(-200, 200))


def test_it_rests_when_its_allowance_is_used_up():
    """2 s of every 10 s: at a stretch 2 s at most, in 100 s 20 s and the first stretch."""
    rig = Rig(SafetyLimits(laser_max_on_s=2.0, laser_period_s=10.0), robots=1)
    lit = [rig((LIT,), REST)[0][0].laser > 0 for _ in range(3000)]
    assert sum(lit[:60]) >= 59
    stretch = longest = 0
    for on in lit:
        stretch = stretch + 1 if on else 0
        longest = max(longest, stretch)
    assert longest * TICK_S <= 2.0 + 1e-6
    assert 20.0 - 0.1 <= sum(lit) * TICK_S <= 22.0

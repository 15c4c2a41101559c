"""No robot leaves the fence, from wherever and however it drives; one outside finds back."""

from __future__ import annotations

import math
import random

import pytest

from hardware_bridge.safety import RobotSituation, SafetyLimits, Situation
from hardware_bridge.safety.geofence import path_ahead
from tests.hardware_bridge.safety.builders import Rig, Unicycle, drive, wheels

SQUARE = SafetyLimits(geofence=(-1.0, -1.0, 1.0, 1.0))
NEEDED_M = 0.07 + 0.05  # body and margin


def at(x, y, yaw):
    return Situation(robots=(RobotSituation((x, y), yaw),))


@pytest.mark.parametrize("seed", range(6))
def test_reckless_robots_stay_inside(seed):
    rng = random.Random(seed)
    wishes = [(rng.choice((-0.5, 0.5)), rng.uniform(-3, 3)) for _ in range(60)]
    rig = Rig(SQUARE, robots=1)
    plant = Unicycle(rng.uniform(-0.8, 0.8), rng.uniform(-0.8, 0.8), rng.uniform(-3, 3))
    worst = 9.0
    for wish in wishes:
        drive(rig, [plant], lambda who, all_, wish=wish: wish, seconds=0.5, lag_s=0.1, delay=1)
        worst = min(worst, 1.0 - abs(plant.x), 1.0 - abs(plant.y))
    assert worst >= NEEDED_M


def test_blocked_robots_may_turn_on_the_spot():
    commands, told = Rig(SQUARE, robots=1)(wheels((9.0, 11.0)), at(0.8, 0.0, 0.0))
    assert commands[0].wheels_rad_s == (-1.0, 1.0)
    assert told[0].rule == "geofence" and "0.6 s" in told[0].reason
    straight, _ = Rig(SQUARE, robots=1)(wheels((10.0, 10.0)), at(0.8, 0.0, 0.0))
    assert straight[0].wheels_rad_s == (0.0, 0.0)


def test_far_from_the_fence_nothing_changes():
    wanted = wheels((5.0, 5.3))
    assert Rig(SQUARE, robots=1)(wanted, at(0.0, 0.0, 0.0)) == (list(wanted), ())


@pytest.mark.parametrize("x", [1.3, 0.95])
def test_a_robot_outside_may_drive_back_and_not_away(x):
    rig = Rig(SQUARE, robots=1)
    assert not rig(wheels((5.0, 5.0)), at(x, 0.0, math.pi))[0][0].stands
    assert not rig(wheels((-5.0, -5.0)), at(x, 0.0, 0.0))[0][0].stands
    assert rig(wheels((5.0, 5.0)), at(x, 0.0, 0.0))[0][0].stands
    assert rig(wheels((-5.0, 5.0)), at(x, 0.0, 0.0))[0][0].wheels_rad_s == (-5.0, 5.0)


def test_a_robot_outside_comes_home():
    plant = Unicycle(1.6, 0.3, math.pi)
    drive(Rig(SQUARE, robots=1), [plant], lambda who, all_: (0.3, 0.0), seconds=4.0, lag_s=0.1)
    assert abs(plant.x) < 1.0 - NEEDED_M


def test_an_unsure_pose_keeps_farther_away():
    sure, unsure = (Situation(robots=(RobotSituation((0.75, 0.0), 0.0, sigma_m=s),)) for s in (0.0, 0.08))
    slow = wheels((5.0, 5.0))
    assert not Rig(SQUARE, robots=1)(slow, sure)[0][0].stands
    assert Rig(SQUARE, robots=1)(slow, unsure)[0][0].stands


def test_the_path_ahead_is_the_arc_of_a_unicycle():
    plant = Unicycle(0.2, -0.1, 0.7)
    for _ in range(18):
        plant.drive(0.4, 1.5, lag_s=1e-9, steps=200)
    end = path_ahead((0.2, -0.1), 0.7, (0.4, 1.5), 0.6)[-1]
    assert end == pytest.approx((plant.x, plant.y), abs=1e-3)

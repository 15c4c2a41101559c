"""Forward invariance, held against unicycles with lag: robots that want to crash do not."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from hardware_bridge.command import RobotCommand
from hardware_bridge.safety import RobotSituation, SafetyLimits, Situation
from hardware_bridge.safety.barrier import nearest as nearest_velocity
from tests.hardware_bridge.safety.builders import Rig, Unicycle, drive, nearest, wheels

LIMITS = SafetyLimits()
SAFETY_M = 2 * 0.07 + LIMITS.barrier_margin_m  # two Zumys, or two VelociRoACHs


def scattered(robots, seed, size):
    rng = random.Random(seed)
    plants = []
    while len(plants) < robots:
        candidate = Unicycle(rng.uniform(-size, size), rng.uniform(-size, size), rng.uniform(-3, 3))
        if nearest([*plants, candidate]) > SAFETY_M + 2 * LIMITS.projection_m + 0.01:
            plants.append(candidate)
    return plants


def bearing_to_nearest(who, plants):
    me = plants[who]
    other = min((p for p in plants if p is not me), key=lambda p: math.hypot(p.x - me.x, p.y - me.y))
    return math.remainder(math.atan2(other.y - me.y, other.x - me.x) - me.yaw, math.tau)


def chase(who, plants):
    """Straight at the nearest, forwards or backwards."""
    bearing = bearing_to_nearest(who, plants)
    return 0.5 * math.copysign(1.0, math.cos(bearing)), 4.0 * bearing


def back_into(who, plants):
    """Tail first into the nearest: the projection point is on the far side."""
    bearing = math.remainder(bearing_to_nearest(who, plants) + math.pi, math.tau)
    return (-0.5 if abs(bearing) < 1.0 else 0.2), 4.0 * bearing


def meet_in_the_middle(who, plants):
    me = plants[who]
    bearing = math.remainder(math.atan2(-me.y, -me.x) - me.yaw, math.tau)
    return 0.5 * math.cos(bearing), 3.0 * bearing


def swarm(who, plants):
    """Half chase, half back in."""
    return (chase if who % 2 else back_into)(who, plants)


@pytest.mark.parametrize("wish", [chase, back_into, meet_in_the_middle, swarm])
@pytest.mark.parametrize("robots", [2, 5])
def test_adversaries_never_come_closer_than_the_safety_radius(wish, robots):
    for seed in range(2):
        distances = drive(Rig(LIMITS, robots), scattered(robots, seed, 0.5), wish, seconds=8.0, lag_s=0.1)
        assert min(distances) >= SAFETY_M - 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("wish", [chase, back_into, meet_in_the_middle, swarm])
@pytest.mark.parametrize("robot", ["zumy", "velociroach"])
def test_many_adversaries(wish, robot):
    for seed in range(12):
        rig = Rig(LIMITS, 5, robot)
        distances = drive(rig, scattered(5, seed, 0.5), wish, seconds=20.0, lag_s=0.1, delay=1)
        assert min(distances) >= SAFETY_M - 0.005


@pytest.mark.parametrize("wish", [back_into, swarm])
def test_late_sight_and_a_slower_drive_eat_at_most_half_the_margin(wish):
    for seed in range(2):
        plants = scattered(5, seed, 0.5)
        distances = drive(Rig(LIMITS, 5), plants, wish, seconds=8.0, lag_s=0.15, delay=2)
        assert min(distances) >= SAFETY_M - 0.5 * LIMITS.barrier_margin_m


def test_without_the_barrier_they_crash():
    plants = scattered(2, 0, 0.5)
    assert min(drive(Rig(SafetyLimits(barrier=False), 2), plants, chase, 8.0, 0.1)) < 0.07


@pytest.mark.parametrize("obstacle", [{"at_work": False}, {"sample_age_s": 9.0}, {"stationary": True}])
def test_robots_that_stand_are_obstacles(obstacle):
    rig = Rig(LIMITS, 2)
    mover = Unicycle(0.0, 0.0, 0.0)
    other = RobotSituation((0.8, 0.01), 1.0, **obstacle)
    for _ in range(300):
        wanted = wheels((10.0, 10.0), (0.0, 0.0))
        commands, _ = rig(wanted, Situation(robots=(mover.situation, other)))
        assert commands[1].stands
        left, right = commands[0].wheels_rad_s
        mover.drive(0.01 * (left + right), 0.2 * (right - left), lag_s=0.1)
        assert math.hypot(mover.x - 0.8, mover.y - 0.01) >= SAFETY_M - 1e-4


def test_a_row_set_down_closer_than_the_safety_distance_drives_out():
    """As `coop_envs.worlds.placement` sets robots down: 0.16 m from each other, here with doubtful poses."""
    rig = Rig(LIMITS, 3)
    row = [Unicycle(0.0, 0.16 * k, 0.0) for k in (-1, 0, 1)]
    for _ in range(90):
        situation = Situation(tuple(replace(plant.situation, sigma_m=0.05) for plant in row))
        commands, _ = rig(wheels((0.0, 0.0), (10.0, 10.0), (0.0, 0.0)), situation)
        left, right = commands[1].wheels_rad_s
        row[1].drive(0.01 * (left + right), 0.2 * (right - left), lag_s=0.1)
        assert nearest(row) > 0.16 - 1e-3
    assert row[1].x > 0.5 and abs(row[1].y) < 0.02


@pytest.mark.parametrize("wish", [back_into, swarm])
def test_a_row_set_down_close_does_not_touch(wish):
    row = [Unicycle(0.0, 0.16 * k, 0.0) for k in range(4)]
    assert min(drive(Rig(LIMITS, 4), row, wish, seconds=8.0, lag_s=0.1, delay=1)) > 2 * 0.07


def test_docked_robots_are_no_obstacles():
    docked = RobotSituation((0.2, 0.0), 0.0, at_work=False, docked=True)
    wanted = wheels((5.0, 5.0), (0.0, 0.0))
    assert Rig()(wanted, Situation(robots=(RobotSituation((0.0, 0.0), 0.0), docked))) == (list(wanted), ())


finite = st.floats(-20.0, 20.0)


@given(st.tuples(finite, finite), st.tuples(finite, finite), st.floats(0.9, 5.0), st.floats(-4.0, 4.0))
def test_far_robots_get_what_is_wanted_bit_for_bit(one, other, gap, yaw):
    """Far: even at full speed, straight at each other, the gap leaves more than they use."""
    limits = SafetyLimits(max_accel_m_s2=None, max_speed_m_s=1.0, max_yaw_rate_rad_s=6.0)
    wanted = wheels(one, other)
    robots = (RobotSituation((0.0, 0.0), yaw), RobotSituation((gap + 2.0, 0.0), -yaw))
    with_it, without = (Rig(replace(limits, barrier=on))(wanted, Situation(robots=robots)) for on in (True, False))
    assert with_it == without


places = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-4.0, 4.0))


@given(st.lists(st.tuples(places, finite, finite), min_size=3, max_size=3), st.booleans())
def test_it_only_slows_and_turns(robots, stationary):
    """The point ahead of the axle never gets faster, and who stands goes on standing, however they overlap."""
    free = SafetyLimits(max_accel_m_s2=None, max_speed_m_s=1.0, max_yaw_rate_rad_s=6.0)
    wanted = (*wheels(*((left, right) for _, left, right in robots[:2])), RobotCommand())
    situation = Situation(tuple(RobotSituation((x, y), yaw, stationary=stationary) for (x, y, yaw), _, _ in robots))
    without, _ = Rig(replace(free, barrier=False), 3)(wanted, situation)
    commands, told = Rig(free, 3)(wanted, situation)
    assert "broken" not in {one.rule for one in told}
    for before, after in zip(without, commands, strict=True):
        assert _point_speed(after) <= _point_speed(before) + 1e-9
    assert commands[2].wheels_rad_s == (0.0, 0.0)


def _point_speed(command):
    left, right = (0.02 * wheel for wheel in command.wheels_rad_s)
    return math.hypot((left + right) / 2, LIMITS.projection_m * (right - left) / 0.1)


angles = st.tuples(st.floats(0.0, math.tau), st.floats(0.0, 0.5))


@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), st.lists(angles, min_size=1, max_size=4))
def test_the_closed_form_solves_the_quadratic_program(wanted, lines):
    """Against SciPy's SLSQP on the same half-planes."""
    planes = [(math.cos(angle), math.sin(angle), bound) for angle, bound in lines]
    mine = nearest_velocity(wanted, planes)
    normals, bounds = np.array([p[:2] for p in planes]), np.array([p[2] for p in planes])
    assert np.all(normals @ mine <= bounds + 1e-9)
    theirs = minimize(
        lambda u: np.sum((u - wanted) ** 2), np.zeros(2), jac=lambda u: 2 * (u - wanted), method="SLSQP",
        constraints={"type": "ineq", "fun": lambda u: bounds - normals @ u, "jac": lambda u: -normals},
    )  # fmt: skip
    if theirs.success and np.all(normals @ theirs.x <= bounds + 1e-9):
        assert math.dist(mine, wanted) <= math.dist(theirs.x, wanted) + 1e-6

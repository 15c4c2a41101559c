"""Courses against the rules of thesis chapter 5, and the driver on an ideal robot."""

from __future__ import annotations

import numpy as np
import pytest

from coop_envs.errors import ConfigError
from experiments.inchworm_driver import INCREMENTS, OBSERVER, Driver, Pace, bend, fan, legs_of, ramp, u_turn

TICK_S = 1.0 / 30.0


@pytest.mark.parametrize("style", ["inchworm", "leapfrog", "cps"])
@pytest.mark.parametrize("pickets", [1, 2, 4, 8])
def test_in_every_increment_each_robot_moves_once_and_one_always_rests(style, pickets):
    moves = [leg.movers for leg in legs_of(u_turn(pickets, style))]
    robots = range(pickets + 1)
    assert all(len(movers) < len(robots) for movers in moves)
    assert [sum(r in movers for movers in moves) for r in robots] == [INCREMENTS] * len(robots)


def test_who_may_move_together():
    together = {style: [leg.movers for leg in legs_of(u_turn(2, style))] for style in ("inchworm", "leapfrog", "cps")}
    assert any(OBSERVER in movers and len(movers) == 2 for movers in together["inchworm"])
    assert max(len(movers) for movers in together["leapfrog"]) == 1
    assert not any(OBSERVER in movers and len(movers) > 1 for movers in together["cps"])


def test_the_ramp_leaves_a_picket_behind_after_three_increments():
    moves = [leg.movers for leg in legs_of(ramp())]
    assert [sum(r in movers for movers in moves) for r in range(3)] == [INCREMENTS, INCREMENTS, 3]
    assert max(k for k, movers in enumerate(moves) if 2 in movers) < len(moves) / 2


def test_courses_are_about_five_metres_long():
    for plan in (u_turn(), ramp()):
        spots = np.array([plan.path(s)[:2] for s in np.linspace(0.0, plan.stops_m[-1], 2000)])
        length = np.linalg.norm(np.diff(spots, axis=0), axis=1).sum()
        assert length == pytest.approx(plan.stops_m[-1], rel=1e-3)
        assert 4.6 < length < 5.1
    assert np.allclose(u_turn().path(4.9)[:2], (-1.39, 0.6), atol=0.02)


@pytest.mark.parametrize("turn_rad", [np.pi, -np.pi / 2])
def test_a_bend_heads_where_it_goes(turn_rad):
    path = bend(1.0, 0.5, turn_rad, (0.3, -0.2))
    for s in np.linspace(0.05, 3.5, 40):
        ahead, behind = np.array(path(s + 1e-5)), np.array(path(s - 1e-5))
        slope = (ahead - behind)[:2] / 2e-5
        assert np.linalg.norm(slope) == pytest.approx(1.0, abs=1e-4)
        assert np.allclose(slope, (np.cos(path(s)[2]), np.sin(path(s)[2])), atol=1e-3)


def test_pickets_keep_apart():
    spots = np.array(fan(8))
    gaps = np.linalg.norm(spots[:, None] - spots[None], axis=-1) + np.eye(8)
    assert gaps.min() > 0.15


def test_a_driver_takes_ideal_robots_to_their_goals_and_stops_them_there():
    plan = u_turn()
    legs = legs_of(plan)
    driver = Driver(legs, plan.pace, 2, TICK_S)
    position, yaw = np.zeros((2, 3, 3)), np.zeros((2, 3))
    position[:, 0, :2] = -1.5, -0.6
    position[:, 1:, :2], position[1] = (-1.05, -0.6), position[0] + 0.02
    moving = []
    for _ in range(12000):
        if driver.done.all():
            break
        speed, turn = driver.command(position, yaw)
        moving.append((np.abs(speed) + np.abs(turn) > 0).sum(axis=1).max())
        yaw = yaw + turn * TICK_S
        position[..., 0] += speed * np.cos(yaw) * TICK_S
        position[..., 1] += speed * np.sin(yaw) * TICK_S
    assert driver.done.all()
    assert max(moving) == 2
    last = {r: next(leg.goals[r] for leg in reversed(legs) if r in leg.movers) for r in range(3)}
    for r, goal in last.items():
        assert np.all(np.linalg.norm(position[:, r, :2] - goal[:2], axis=-1) < plan.pace.reach_m + 0.002)
        assert np.all(np.abs(np.angle(np.exp(1j * (yaw[:, r] - goal[2])))) < 2 * plan.pace.aim_rad)


def test_a_blocked_robot_is_given_up_in_time():
    plan = u_turn(1, pace=Pace(patience_s=2.0, settle_s=0.1))
    driver = Driver(legs_of(plan), plan.pace, 1, TICK_S)
    for _ in range(len(driver.goals) * 65):
        driver.command(np.zeros((1, 2, 3)), np.zeros((1, 2)))
    assert driver.done.all()


def test_a_pace_without_speed_is_refused():
    with pytest.raises(ConfigError, match=r"pace\.speed_m_s: got 0"):
        Pace(speed_m_s=0)

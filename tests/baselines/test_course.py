"""The course of an exploration, in a kinematic stand-in for the environment."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.goal_grid import GoalGrid
from baselines.random_walk import RandomWalk
from baselines.team_view import read_team
from coop_envs.policy import Actions, Policy
from tests.baselines.fake_world import FakeArena, describe

POLICIES = (RandomWalk, GoalGrid)


def run(policy: Policy, world: FakeArena, seed: int, limit_s: float) -> list[Actions]:
    policy.reset(world.team, seed)
    observations, history = world.observe(), []
    while world.time_s < limit_s and not world.reached and not world.observer_harmed:
        history.append(policy.act(observations))
        observations = world.step(history[-1])
    return history


def test_goal_grid_brings_the_observer_round_the_trap() -> None:
    world = FakeArena(describe())
    run(GoalGrid(), world, 0, 600.0)
    assert world.reached
    assert not world.observer_harmed


def test_a_random_walk_finds_the_goal_where_nothing_is_hidden() -> None:
    world = FakeArena(describe(), goal=(0.5, 0.0), trap=False)
    run(RandomWalk(), world, 2, 600.0)
    assert world.reached


@pytest.mark.parametrize("policy", POLICIES)
def test_a_known_way_is_driven_at_once(policy: type[Policy]) -> None:
    world = FakeArena(describe(), trap=False)
    world.ground[16:40, 14:26] = 248
    run(policy(), world, 0, 90.0)
    assert world.reached


@pytest.mark.parametrize("policy", POLICIES)
def test_equal_seeds_act_alike(policy: type[Policy]) -> None:
    first, second, other = (run(policy(), FakeArena(describe()), seed, 30.0) for seed in (4, 4, 5))
    assert all(np.array_equal(a[n], b[n]) for a, b in zip(first, second, strict=True) for n in a)
    assert any(not np.array_equal(a[n], b[n]) for a, b in zip(first, other, strict=False) for n in a if n in b)


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("team", ["scouts", "inchworm", "surveyors"])
def test_inchworm_rule_and_bounds_hold(policy: type[Policy], team: str) -> None:
    """Whenever the observer drives, everybody else holds; docked robots always do; actions are in bounds."""
    world = FakeArena(describe(team))
    policy_ = policy()
    policy_.reset(world.team, 3)
    observations = world.observe()
    while world.time_s < 60.0 and not world.reached:
        docked = [n for i, n in enumerate(world.team.names) if world.docked[i]]
        actions = policy_.act(observations)
        assert set(actions) == set(observations)
        for action in actions.values():
            assert action.shape == (8,) and action.dtype == np.float32
            assert np.all(np.abs(action) <= 1.0)
        moving = [n for n, action in actions.items() if action[0] <= 0.0]
        assert not set(moving) & set(docked)
        assert moving == ["observer_0"] or "observer_0" not in moving
        observations = world.step(actions)


def test_without_a_goal_the_observer_looks_round() -> None:
    world = FakeArena(describe(goal_known=False), goal=None, trap=False)
    history = run(GoalGrid(), world, 0, 300.0)
    assert any(actions["observer_0"][0] <= 0.0 for actions in history)


def test_the_view_is_what_the_observations_say() -> None:
    world = FakeArena(describe("inchworm"))
    world.pose[0] = (0.1, -0.05, 0.4)
    view = read_team(world.observe(), world.team)
    assert view is not None and view.goal is not None
    np.testing.assert_allclose(view.goal, (0.87, 0.0), atol=1e-5)
    np.testing.assert_allclose([scout.xy for scout in view.scouts], world.pose[1:, :2], atol=1e-5)
    seen = {mark.xy: mark.in_view for mark in view.landmarks}
    assert sum(seen.values()) == sum(world.sees(j) for j in (1, 2))
    assert view.time_left_s == pytest.approx(600.0)

"""Every wrapper, alone and in any stack, keeps PettingZoo's contracts, its seeds and its state."""

from __future__ import annotations

import itertools
import warnings

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from coop_envs import exploration_v0
from coop_envs.errors import ConfigError
from coop_envs.wrappers import ActionDelay, MacroActions, VectorActionDelay
from tests.wrappers.stacks import DISTURBANCES, WRAPPERS, team, wrapped

ORDERS = list(itertools.permutations(DISTURBANCES))
STACKS = [(name,) for name in WRAPPERS]
STACKS += [(*ORDERS[0], "randomised", "macro"), ("shield", "delay", "macro", "loss", "randomised", "noise")]


def follow(env, actions_seed: int, steps: int) -> list:
    """Play random actions; what was seen, earned and told."""
    rng, course = np.random.default_rng(actions_seed), []
    for _ in range(steps):
        if not env.agents:
            break
        acts = {}
        for name in env.agents:
            space = env.action_space(name)
            acts[name] = rng.integers(space.nvec) if hasattr(space, "nvec") else rng.uniform(-1, 1, 8)
        course.append(env.step(acts))
    return course


def assert_same(a, b) -> None:
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, list | tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("stack", STACKS, ids="-".join)
def test_pettingzoo_contracts(stack) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(wrapped(stack), num_cycles=80)
        parallel_seed_test(lambda: wrapped(stack), num_cycles=10)


@pytest.mark.parametrize("order", ORDERS, ids="-".join)
def test_disturbances_go_together_in_any_order(order) -> None:
    env = wrapped([*order, "randomised"])
    env.reset(seed=1)
    first = follow(env, 1, 20)
    env.reset(seed=1)
    assert_same(first, follow(env, 1, 20))
    for observations, *_ in first:
        assert all(env.observation_space(name).contains(seen) for name, seen in observations.items())


@pytest.mark.parametrize("stack", STACKS, ids="-".join)
def test_what_the_environment_offers_stays_in_reach(stack) -> None:
    env = wrapped(stack)
    env.reset(seed=0)
    follow(env, 0, 3)
    assert env.scenario.name == "arena"
    assert env.team_description.names == tuple(env.possible_agents)
    assert env.metrics()["simulated_s"] > 0.0
    assert len(env.frame().true_xy_yaw) == 3
    assert env.scan() is not None


@pytest.mark.parametrize("stack", STACKS, ids="-".join)
def test_equal_seeds_equal_episodes_and_other_seeds_others(stack) -> None:
    env = wrapped(stack)
    courses = []
    for seed in (3, 3, 4):
        started = env.reset(seed=seed)
        second = (started, follow(env, 9, 15), env.reset(), follow(env, 9, 15))
        courses.append(second)
    assert_same(courses[0], courses[1])
    with pytest.raises(AssertionError):
        assert_same(courses[0], courses[2])
    with pytest.raises(AssertionError):
        assert_same(courses[0][:2], courses[0][2:])


@pytest.mark.parametrize("stack", STACKS, ids="-".join)
def test_a_saved_state_goes_on_as_if_nothing_had_happened(stack) -> None:
    env = wrapped(stack, env=team(**{"task.time_limit_s": 200.0}))
    env.reset(seed=5)
    follow(env, 0, 7)
    state = env.get_state()
    first = follow(env, 1, 12)
    assert len(first) == 12
    env.set_state(state)
    assert_same(first, follow(env, 1, 12))
    env.reset(seed=8)
    follow(env, 2, 3)
    env.set_state(state)
    assert_same(first, follow(env, 1, 12))


def test_a_state_of_other_settings_is_refused() -> None:
    env, other = ActionDelay(team(), 1), ActionDelay(team(), 3)
    env.reset(seed=0)
    other.reset(seed=0)
    with pytest.raises(ConfigError, match=r"^state\.waiting: got"):
        env.set_state(other.get_state())


@pytest.mark.parametrize("name", ["delay", "shield", "macro"])
def test_wrappers_of_plain_actions_refuse_macro_actions(name) -> None:
    with pytest.raises(ConfigError, match="put it inside MacroActions"):
        WRAPPERS[name](MacroActions(team()))


def test_the_environment_still_refuses_what_it_refuses() -> None:
    env = wrapped(list(DISTURBANCES))
    env.reset(seed=0)
    with pytest.raises(ConfigError, match="alive"):
        env.step({"observer_0": np.zeros(8)})
    with pytest.raises(ConfigError, match="nobody"):
        env.step({"nobody": np.zeros(8)})
    with pytest.raises(ConfigError, match="shape"):
        env.step(dict.fromkeys(env.agents, np.zeros(3)))


def test_the_wrong_kind_of_environment_is_told():
    one, many = exploration_v0.parallel_env("arena", team="inchworm"), exploration_v0.vector_env(2, "arena")
    with pytest.raises(ConfigError, match="env: got 'ExplorationParallelEnv'"):
        VectorActionDelay(one, 1)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="env: got 'ExplorationVectorEnv'"):
        ActionDelay(many, 1)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="env: got 'ExplorationVectorEnv'"):
        MacroActions(many)  # type: ignore[arg-type]

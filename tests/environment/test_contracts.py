"""The environment keeps the contracts of PettingZoo, Gymnasium and Stable-Baselines3, in every scenario and team."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from stable_baselines3.common.env_checker import check_env as sb3_check

import coop_envs
from coop_envs import exploration_v0
from coop_envs.agents import catalog
from coop_envs.scenario import scenario_names
from tests.environment.policies import random_actions

SCENARIOS, TEAMS = scenario_names(), sorted(catalog.names("teams"))
EVERY = [(scenario, team) for scenario in SCENARIOS for team in TEAMS]


@pytest.mark.parametrize(("scenario", "team"), EVERY)
def test_pettingzoo_parallel_contract(scenario: str, team: str) -> None:
    parallel_api_test(exploration_v0.parallel_env(scenario, team=team), num_cycles=60)


@pytest.mark.parametrize(("scenario", "team"), EVERY)
def test_equal_seeds_give_equal_episodes(scenario: str, team: str) -> None:
    parallel_seed_test(lambda: exploration_v0.parallel_env(scenario, team=team), num_cycles=30)


@pytest.mark.parametrize(("scenario", "team"), EVERY)
def test_pettingzoo_aec_contract(scenario: str, team: str) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Observation", UserWarning)
        api_test(exploration_v0.env(scenario, team=team), num_cycles=20)


@pytest.mark.parametrize(("scenario", "team"), EVERY)
def test_gymnasium_and_sb3_accept_the_team_under_one_controller(scenario: str, team: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gymnasium_check(exploration_v0.team_env(scenario, team=team), skip_render_check=True)
        sb3_check(exploration_v0.team_env(scenario, team=team))


@pytest.mark.parametrize(("scenario", "team"), EVERY)
def test_observations_stay_in_their_spaces_until_nobody_is_left(scenario: str, team: str) -> None:
    env = exploration_v0.parallel_env(scenario, team=team, task={"time_limit_s": 40.0})
    rng = np.random.default_rng(1)
    observations, _ = env.reset(seed=1)
    while env.agents:
        for name, observation in observations.items():
            assert env.observation_space(name).contains(observation)
            assert all(np.isfinite(part).all() for part in observation.values())
        actions = random_actions(rng, len(env.agents))
        assert all(env.action_space(name).contains(row) for name, row in zip(env.agents, actions, strict=True))
        observations, rewards, _, _, _ = env.step(dict(zip(env.agents, actions, strict=True)))
        assert all(np.isfinite(reward) for reward in rewards.values())


def test_the_registries_know_the_environment() -> None:
    assert coop_envs.__doc__
    parallel = pettingzoo.make("parallel", "coop_envs/Exploration-v0", scenario="arena", team="inchworm")
    assert parallel.possible_agents == ["observer_0", "picket_0", "picket_1"]
    single = gymnasium.make("coop_envs/Exploration-v0", scenario="arena", team="inchworm")
    observation, _ = single.reset(seed=0)
    assert single.observation_space.contains(observation)
    many = gymnasium.make_vec("coop_envs/Exploration-v0", num_envs=3, scenario="arena", team="inchworm")
    observation, _ = many.reset(seed=0)
    assert many.observation_space.contains(observation)


def test_spaces_are_the_same_objects_at_every_call() -> None:
    env = exploration_v0.parallel_env("arena")
    assert env.observation_space("observer_0") is env.observation_space("observer_0")
    assert env.action_space("picket_0") is env.action_space("picket_0")

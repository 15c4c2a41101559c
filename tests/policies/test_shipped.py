"""The trained policies that come with the package: they load by name, say where they come from, and play."""

from __future__ import annotations

from importlib.resources import files

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.errors import ConfigError
from coop_envs.policy import check_needs, load_policy
from coop_envs.validation import read_yaml
from policies.onnx_policy import OnnxPolicy
from policies.shipped import shipped, shipped_names

SCENARIOS = {"learned_scouts": "random_arena", "learned_surveyors": "rubble"}


def test_all_are_here():
    assert shipped_names() == sorted(SCENARIOS)
    with pytest.raises(ConfigError, match="learned_scout'"):
        shipped("learned_scout")


@pytest.mark.parametrize("name", SCENARIOS)
def test_it_plays_in_the_scenario_that_it_was_trained_in(name):
    policy = load_policy(name)
    assert isinstance(policy, OnnxPolicy)
    assert policy.description.scenario == SCENARIOS[name]
    env = exploration_v0.parallel_env(SCENARIOS[name], split="heldout", task={"time_limit_s": 8.0})
    observations, _ = env.reset(seed=0)
    check_needs(policy, env.team_description)
    policy.reset(env.team_description, seed=0)
    acts = []
    while env.agents:
        actions = policy.act({agent: observations[agent] for agent in env.agents})
        acts.append(actions["observer_0"])
        observations, *_ = env.step(actions)
    assert len(acts) >= 20
    assert np.abs(acts).max() <= 1.0
    assert len(np.unique(np.array(acts), axis=0)) > 4


@pytest.mark.parametrize("name", SCENARIOS)
def test_its_command_is_told_beside_it(name):
    text = (files("policies") / "trained" / name / "training.yaml").read_text(encoding="utf-8")
    command = text.splitlines()[0].removeprefix("# ")
    assert command == shipped(name).description.command
    assert f"--out out/{name}" in command
    assert read_yaml(text, name)["scenario"] == SCENARIOS[name]

"""Evaluation within a training: the same episodes as one team alone would have, and no trace left in the training."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from coop_envs.exploration_v0 import parallel_env
from coop_envs.scenario import load_scenario
from policies.description import describe_policy
from policies.export import export
from policies.loading import load
from policies.networks import NetworkSettings, TeamActorCritic
from tests.train.test_training import UPDATE, small
from train.train import main
from train.training_evaluation import SEED, HeldOut, actions_of, averages

REPEAT = 3
SETTINGS = NetworkSettings(kind="mlp", width=8, depth=1, forward_mean=0.5)


@pytest.fixture(scope="module")
def policy_file(tmp_path_factory) -> Path:
    scenario = load_scenario("arena", team="inchworm", **{"task.time_limit_s": 6.0})
    description = describe_policy(
        "still", scenario, SETTINGS, command="", seed=0, steps=0, repeat=REPEAT, stochastic=False
    )
    path = tmp_path_factory.mktemp("policy") / "policy.onnx"
    export(TeamActorCritic(SETTINGS), description, path)
    return path


def test_its_episodes_are_those_of_a_team_alone(policy_file):
    scenario = load_scenario("arena", team="inchworm", **{"task.time_limit_s": 6.0})
    policy = load(policy_file)
    held_out = HeldOut(scenario, 1, REPEAT, device="cpu", threads=1)
    found = held_out.evaluate(actions_of(policy, 3))
    held_out.close()
    env = parallel_env(scenario, fidelity="poses", split="heldout", num_worlds=1)
    observations, _ = env.reset(seed=SEED)
    policy.reset(env.team_description, 0)
    gained = 0.0
    while env.agents:
        observations, rewards, *_ = env.step(policy.act(observations))
        gained += float(next(iter(rewards.values())))
    alone = env.metrics()
    assert found["simulated_s"] > 5.0
    assert found["return"] == pytest.approx(gained, abs=1e-4)
    for name in ("information_bits", "action_energy_j", "coverage", "simulated_s"):
        assert found[name] == pytest.approx(float(alone[name]), abs=1e-6)


@pytest.mark.slow
def test_evaluating_changes_nothing_that_is_learnt(tmp_path):
    runs = {"plain": [], "watched": ["--evaluate-episodes", "2", "--evaluate-every", str(UPDATE)]}
    found = {}
    for name, more in runs.items():
        assert main(small(tmp_path / name, *more, steps=3 * UPDATE)) == 0
        found[name] = json.loads((tmp_path / name / "progress.json").read_text())
    assert found["plain"]["weights_sha256"] == found["watched"]["weights_sha256"]
    assert [row["steps"] for row in found["watched"]["held_out"]] == [UPDATE, 2 * UPDATE, 3 * UPDATE]
    assert found["plain"]["held_out"] == []


def test_bits_per_joule_are_of_sums():
    base = dict.fromkeys(("return", "coverage", "pickets_lost", "simulated_s"), 1.0)
    one = {**base, "information_bits": 10.0, "action_energy_j": 1.0, "success": True}
    other = {**base, "information_bits": 0.0, "action_energy_j": 4.0, "success": False}
    found = averages([one, other])
    assert found["bits_per_action_joule"] == pytest.approx(2.0)
    assert found["success"] == pytest.approx(0.5)
    assert found["information_bits"] == pytest.approx(5.0)
    assert np.isfinite(list(found.values())).all()

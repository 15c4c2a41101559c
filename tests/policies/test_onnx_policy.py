"""A learned policy at work: repeatable, in limits, without torch."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from coop_envs.actions import hold_action
from coop_envs.errors import CoopError
from coop_envs.policy import Actions
from policies.onnx_policy import DOCKED, OnnxPolicy
from tests.policies.builders import model, model_with, observed, rows, team

ROOT = Path(__file__).parents[2]
WITHOUT_TORCH = """
import sys
for absent in ("torch", "onnx", "onnxscript", "stable_baselines3"):
    sys.modules[absent] = None
import numpy as np
from coop_envs import exploration_v0
from policies.loading import load

env = exploration_v0.parallel_env(scenario="arena", num_worlds=1)
policy = load(sys.argv[1])
observations, _ = env.reset(seed=3)
policy.reset(env.team_description, seed=3)
for decision in range(50):
    actions = policy.act(observations)
    assert actions.keys() == observations.keys()
    assert all(env.action_space(name).contains(action) for name, action in actions.items())
    observations, *_ = env.step(actions)
    observations = {name: observations[name] for name in env.agents}
assert sys.modules["torch"] is None
print(f"{decision + 1} decisions, {len(env.agents)} robots")
"""


def played(policy: OnnxPolicy, seed: int, decisions: int = 6) -> list[Actions]:
    """A policy's actions for a fixed sequence of random observations."""
    policy.reset(team(), seed)
    return [policy.act(observed(team().names, k)) for k in range(decisions)]


def same(a: list[Actions], b: list[Actions]) -> bool:
    return all(np.array_equal(x[name], y[name]) for x, y in zip(a, b, strict=True) for name in x)


def test_runs_where_torch_cannot_be_imported(tmp_path):
    path = tmp_path / "policy.onnx"
    path.write_bytes(model("attention"))
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", WITHOUT_TORCH, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("50 decisions")


def test_equal_seeds_give_equal_actions():
    policy = OnnxPolicy(model(), "file")
    first = played(policy, seed=1)
    assert same(first, played(policy, seed=1))
    assert same(first, played(OnnxPolicy(model(), "file"), seed=1))
    assert not same(first, played(policy, seed=2))


def test_without_chance_the_seed_does_not_matter():
    policy = OnnxPolicy(model_with(stochastic=False), "file")
    assert same(played(policy, seed=1), played(policy, seed=2))


def test_without_chance_the_action_is_the_likeliest():
    names = team().names
    policy = OnnxPolicy(model_with(stochastic=False), "file")
    policy.reset(team(), seed=0)
    actions = policy.act(observed(names, 5))
    likeliest = policy.answers(rows(len(names), 5))[0]
    np.testing.assert_allclose(np.stack(list(actions.values())), likeliest, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("stochastic", [True, False])
def test_robots_in_the_dock_hold(stochastic):
    """Else one that is let out while an action is held would drive by an answer that nobody trained."""
    names = team().names
    policy = OnnxPolicy(model_with(stochastic=stochastic), "file")
    policy.reset(team(), seed=0)
    seen = observed(names, 5)
    seen[names[-1]]["self"][DOCKED] = 1.0
    assert np.array_equal(policy.act(seen)[names[-1]], hold_action())


def test_draws_follow_the_answers():
    names = team().names
    policy = OnnxPolicy(model(), "file")
    policy.reset(team(), seed=0)
    drawn = np.array([policy.act(observed(names, 5))[names[1]] for _ in range(4000)])
    _, hold, mean, std = policy.answers(rows(len(names), 5))
    assert np.abs(drawn).max() <= 1.0
    assert set(np.unique(drawn[:, 0])) <= {-1.0, 1.0}
    assert np.mean(drawn[:, 0] > 0) == pytest.approx(hold[1], abs=4 * np.sqrt(0.25 / 4000))
    noise = np.random.default_rng(9).normal(size=(100_000, 7))
    expected = np.clip(mean[1] + std * noise, -1, 1).mean(0)
    np.testing.assert_allclose(drawn[:, 1:].mean(0), expected, atol=4 / np.sqrt(4000))


def test_a_robot_draws_the_same_whoever_else_is_alive():
    names = team().names
    policy = OnnxPolicy(model(), "file")
    policy.reset(team(), seed=4)
    together = [policy.act(observed(names, k))[names[2]] for k in range(5)]
    policy.reset(team(), seed=4)
    alone = [policy.act({names[2]: observed(names, k)[names[2]]})[names[2]] for k in range(5)]
    np.testing.assert_allclose(together, alone, rtol=1e-5, atol=1e-6)


def test_actions_are_held_for_as_many_decisions_as_in_training():
    names = team().names
    policy = OnnxPolicy(model_with(repeat=3), "file")
    policy.reset(team(), seed=0)
    actions = [policy.act(observed(names, k))[names[1]] for k in range(9)]
    changed = [not np.array_equal(a, b) for a, b in pairwise(actions)]
    assert changed == [False, False, True, False, False, True, False, False]


def test_a_robot_that_goes_leaves_the_others_their_actions():
    names = team().names
    policy = OnnxPolicy(model_with(repeat=3), "file")
    policy.reset(team(), seed=0)
    first = policy.act(observed(names, 0))
    fewer = {name: o for name, o in observed(names, 1).items() if name != names[1]}
    second = policy.act(fewer)
    assert second.keys() == fewer.keys()
    assert all(np.array_equal(second[name], first[name]) for name in second)
    assert policy.act({}) == {}


def test_what_a_caller_does_to_an_action_stays_with_the_caller():
    names = team().names
    policy = OnnxPolicy(model_with(repeat=2), "file")
    policy.reset(team(), seed=0)
    first = policy.act(observed(names))
    kept = first[names[0]].copy()
    first[names[0]][:] = 9.0
    assert np.array_equal(policy.act(observed(names))[names[0]], kept)


def test_acting_before_a_reset_is_told():
    with pytest.raises(CoopError, match="expected reset"):
        OnnxPolicy(model(), "file").act(observed(team().names))


def test_missing_onnxruntime_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(CoopError, match=r"pip install 'coop_envs\[policy\]'$"):
        OnnxPolicy(model(), "file")

"""PPO over teams: sacrifice is learnt where it pays, returns are those computed by hand, idle rows leave no trace."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from policies.networks import NetworkSettings
from tests.train.sacrifice_game import BEST, SacrificeGame
from tests.train.scripted_teams import ScriptedTeams
from train.ppo import TeamPPO
from train.ppo_buffer import TeamRolloutBuffer
from train.team_vec_env import TeamVecEnv
from train.training_settings import PPOSettings

SMALL = PPOSettings(
    learning_rate=5e-3, learning_rate_decay="none", rollout_steps=8, minibatch_rows=256, target_kl=None, gamma=1.0
)
NETWORK = NetworkSettings(kind="mlp", width=32, depth=1, hold_probability=0.5)


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Forgetful(TeamVecEnv):
    """The usual mistake: whoever is lost ends there, and nothing that the team earns later counts for it."""

    def step_wait(self) -> Any:
        rows, rewards, dones, infos = super().step_wait()
        for info in infos:
            if "TimeLimit.truncated" in info:
                info["TimeLimit.truncated"] = False
        return rows, rewards, dones, infos


def learnt_return(kind: type[TeamVecEnv]) -> float:
    model = TeamPPO(kind(SacrificeGame(32), np.ones((2, 8))), NETWORK, SMALL, seed=1)
    model.learn(40 * 8 * 64)
    assert model.ep_info_buffer is not None
    return float(np.mean([episode["r"] for episode in model.ep_info_buffer]))


def test_a_picket_learns_to_give_itself_up():
    assert learnt_return(TeamVecEnv) > 0.9 * BEST


def test_with_naive_endings_it_learns_to_hold():
    assert learnt_return(Forgetful) < 0.1 * BEST


def scripted(*scripts: Any, robots: int, docked: Any = (), **settings: Any) -> TeamPPO:
    env = TeamVecEnv(ScriptedTeams(scripts, robots, docked), np.ones((robots, 8)))
    chosen = PPOSettings(**{"minibatch_rows": 5, "epochs": 1, "target_kl": None, **settings})
    return TeamPPO(env, NETWORK, chosen, seed=0)


def constant_value(model: TeamPPO, value: float) -> None:
    head = model.policy.network.value_head
    torch.nn.init.zeros_(head.weight)
    torch.nn.init.constant_(head.bias, value)


def collected(model: TeamPPO) -> TeamRolloutBuffer:
    _, callback = model._setup_learn(10_000)
    buffer = model.rollout_buffer
    assert isinstance(buffer, TeamRolloutBuffer)
    assert model.env is not None
    model.collect_rollouts(model.env, callback, buffer, model.n_steps)
    return buffer


def test_returns_are_those_computed_by_hand():
    script = [{"reward": 1.0}, {"reward": -1.0, "lost": [1]}, {"reward": 2.0, "late": [0]}]
    model = scripted(script, robots=2, rollout_steps=3, gamma=0.5, gae_lambda=1.0)
    constant_value(model, 8.0)
    returns = collected(model).returns
    # the one left: 2 + 8/2, -1 + 6/2, 1 + 2/2; the lost one has the team's 8 after its loss: -1 + 8/2, 1 + 3/2
    np.testing.assert_allclose(returns[:, 0], [2.0, 2.0, 6.0])
    np.testing.assert_allclose(returns[:2, 1], [2.5, 3.0])


def test_success_has_no_future():
    model = scripted([{"reward": 1.0, "lost": [0, 1]}], robots=2, rollout_steps=2, gamma=0.5)
    constant_value(model, 8.0)
    np.testing.assert_allclose(collected(model).returns, 1.0)


def test_values_behind_endings_are_the_same_asked_at_once_and_one_by_one():
    script = [{"lost": [1]}, {"late": [0, 2]}]
    model = scripted(script, [{"late": [0, 1, 2]}], robots=3, rollout_steps=2)
    assert model.env is not None
    model.env.reset()
    _, _, dones, infos = model.env.step(np.zeros((6, 8), dtype=np.float32))
    at_once = model._bootstrap(dones, infos)
    assert dones.tolist() == [False, True, False, True, True, True]
    for row in np.flatnonzero(dones):
        seen = model.policy.obs_to_tensor(infos[row]["terminal_observation"])[0]
        alone = model.policy.predict_values(seen).item()  # pyright: ignore[reportArgumentType]
        assert at_once[row] == pytest.approx(model.gamma * alone, rel=1e-5)
    assert not at_once[~dones].any()
    assert len(set(at_once[dones].tolist())) > 1


def test_rows_of_nobody_or_in_the_dock_leave_no_trace():
    script = [{"reward": 1.0}, {"lost": [1]}, {"reward": 3.0}, {"late": [0, 2]}]
    model = scripted(script, script, robots=3, docked=[2], rollout_steps=4)
    buffer = collected(model)
    expected = np.sort(np.concatenate([buffer.returns[:, [0, 3]].ravel(), buffer.returns[:2, [1, 4]].ravel()]))
    batches = list(buffer.get(5))
    assert [len(batch.returns) for batch in batches] == [6, 6]
    returns = np.sort(np.concatenate([batch.returns.numpy() for batch in batches]))
    np.testing.assert_array_equal(returns, expected)
    for batch in batches:
        assert bool((batch.observations["alive"] == 1).all())
        assert bool((batch.observations["self"][:, 15] == 0).all())
    model._update_current_progress_remaining(24, 24)
    model.train()
    assert model.policy.network.normaliser.self_moments.count == 12


def test_rows_stay_with_their_actions():
    model = scripted([{}, {}, {"lost": [1]}, {}, {}], robots=2, rollout_steps=4)
    buffer = collected(model)
    steps = buffer.observations["self"][:, :, 2].copy()
    actions = buffer.actions.copy()
    for batch in buffer.get(3):
        for seen, action in zip(batch.observations["self"][:, 2].tolist(), batch.actions.numpy(), strict=True):
            place = np.argwhere(steps == seen)
            np.testing.assert_array_equal(actions[tuple(place[0])], action)


def test_the_learning_rate_starts_whole_and_does_not_end_at_nothing():
    model = scripted([{}] * 9, robots=2, rollout_steps=4)
    rates = []
    for done in (8, 16):
        model._update_current_progress_remaining(done, 16)
        rates.append(model.lr_schedule(model._current_progress_remaining))
    assert rates == pytest.approx([5e-4, 2.5e-4])

"""What a training's future depends on, beyond what a whole training shows: the world's file, the GPU's generators."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from coop_envs.errors import ConfigError
from coop_envs.scenario import load_scenario
from policies.networks import NetworkSettings
from tests.train.sacrifice_game import SacrificeGame
from train.checkpoint import check_same
from train.ppo import TeamPPO
from train.team_vec_env import TeamVecEnv
from train.training_settings import PPOSettings, TrainingSettings
from train.training_state import capture, identity, restore


def test_another_world_under_the_same_name_is_another_training(tmp_path):
    path = tmp_path / "hills.png"
    settings = TrainingSettings(world=path)
    path.write_bytes(b"one")
    scenario = settings.load_scenario()
    before = identity(settings, scenario)
    check_same(before, identity(settings, scenario))
    path.write_bytes(b"other")
    with pytest.raises(ConfigError, match=r"^world_sha256: got '[0-9a-f]{64}', expected '[0-9a-f]{64}'"):
        check_same(before, identity(settings, scenario))
    path.unlink()
    with pytest.raises(
        ConfigError, match=r"environment\.geometry\.path: got .*hills\.png', expected a file that exists"
    ):
        identity(settings, scenario)


def test_a_world_that_is_no_file_has_no_hash():
    assert identity(TrainingSettings(), load_scenario("arena"))["world_sha256"] is None


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_gpus_generators_are_kept_where_one_is_trained_on(device, monkeypatch):
    model = TeamPPO(
        TeamVecEnv(SacrificeGame(2), np.ones((2, 8))),
        NetworkSettings(kind="mlp", width=8, depth=1),
        PPOSettings(rollout_steps=2, minibatch_rows=4),
        seed=0,
    )
    model.learn(8)
    model.device = torch.device(device)
    kept, put_back = [torch.tensor([1, 2], dtype=torch.uint8)] * 2, []
    monkeypatch.setattr(torch.cuda, "get_rng_state_all", lambda: kept)
    monkeypatch.setattr(torch.cuda, "set_rng_state_all", put_back.append)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    teams = model.env
    assert isinstance(teams, TeamVecEnv)
    state = capture(model, teams, {}, {})
    assert ("cuda_random" in state.learner) == (device == "cuda")
    restore(model, teams, state)
    assert [[one.tolist() for one in all_of_them] for all_of_them in put_back] == [[[1, 2]]] * (device == "cuda")

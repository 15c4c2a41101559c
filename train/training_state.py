"""Everything a training's future depends on: out of a learner and its teams into a checkpoint, and back."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import random
from collections import deque
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch

from coop_envs.actions import ACTION_NAMES
from coop_envs.errors import require
from coop_envs.observations import MATE_FIELDS, SELF_FIELDS
from coop_envs.scenario import Scenario
from train.checkpoint import Checkpoint
from train.ppo import TeamPPO
from train.team_vec_env import TeamVecEnv
from train.training_settings import TrainingSettings


def identity(settings: TrainingSettings, scenario: Scenario) -> dict[str, Any]:
    """What must be the same for a training to go on, in JSON's own types.

    Raises:
        ConfigError: the world's file is missing.
    """
    tree = dataclasses.asdict(scenario)
    found = {
        "version": version("coop_envs"),
        "actions": ACTION_NAMES,
        "observations": {"self": [f.name for f in SELF_FIELDS], "mates": [f.name for f in MATE_FIELDS]},
        "scenario": {name: entry for name, entry in tree.items() if name != "team"},
        "team": tree["team"],
        "network": dataclasses.asdict(settings.network),
        **{name: getattr(settings, name) for name in ("teams", "num_worlds", "repeat", "seed", "reward_scale")},
        "world_sha256": _world_sha256(scenario),
    }
    return json.loads(json.dumps(found, default=str))


def capture(model: TeamPPO, teams: TeamVecEnv, about: Mapping[str, Any], history: Mapping[str, Any]) -> Checkpoint:
    """A copy of the present state, between two updates; ``history`` is kept with it."""
    assert model.ep_info_buffer is not None
    state = {
        "teams": teams.get_state(),
        "observations": model._last_obs,
        "starts": model._last_episode_starts,
        "rows": model.num_timesteps,
        "updates": model._n_updates,
        "episodes": list(model.ep_info_buffer),
        "python_random": random.getstate(),
        "numpy_random": np.random.get_state(),  # noqa: NPY002  the generator that SB3 draws from
        "history": copy.deepcopy(dict(history)),
    }
    learner = {
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "random": torch.get_rng_state(),
    }
    if model.device.type == "cuda":
        learner["cuda_random"] = torch.cuda.get_rng_state_all()
    return Checkpoint(dict(about), state, copy.deepcopy(learner))  # the teams' state and observations are copies


def restore(model: TeamPPO, teams: TeamVecEnv, checkpoint: Checkpoint) -> dict[str, Any]:
    """Bring learner and teams to the state of a checkpoint of the same `identity`; its history."""
    state, learner = checkpoint.state, checkpoint.learner
    teams.set_state(state["teams"])
    restore_weights(model, learner)
    model.num_timesteps, model._n_updates = state["rows"], state["updates"]
    model._last_obs, model._last_episode_starts = state["observations"], state["starts"]
    model.ep_info_buffer = deque(state["episodes"], maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)
    kind, numbers, cached = state["python_random"]
    random.setstate((kind, tuple(numbers), cached))
    np.random.set_state(tuple(state["numpy_random"]))  # noqa: NPY002
    torch.set_rng_state(learner["random"])
    if model.device.type == "cuda" and "cuda_random" in learner:
        torch.cuda.set_rng_state_all(learner["cuda_random"][: torch.cuda.device_count()])
    return state["history"]


def restore_weights(model: TeamPPO, learner: Mapping[str, Any]) -> None:
    """Weights, normaliser and optimiser alone."""
    model.policy.load_state_dict(learner["policy"])
    model.policy.optimizer.load_state_dict(learner["optimizer"])


def _world_sha256(scenario: Scenario) -> str | None:
    """Of the contents of the file that the world is made from; None if there is none."""
    path = getattr(scenario.environment.geometry, "path", None)
    if path is None:
        return None
    require(Path(path).is_file(), "environment.geometry.path", path, "a file that exists")
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()

"""PPO by RLlib, to scale out over a cluster: robots of one role share a network, teams are played by env runners.

Run it inside a cluster (``ray.init(address=...)`` first) and the env runners spread over its machines; without one a
local cluster is started and shut down again.
"""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ray
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.core.rl_module.multi_rl_module import MultiRLModuleSpec
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.tune.registry import register_env

from coop_envs.errors import require
from coop_envs.scenario import Scenario
from train.rllib_env import RllibTeam, make_team
from train.rllib_learner import TeamPPOLearner


@dataclass(frozen=True)
class RllibSettings:
    """How to train: processes that play, decisions of teams an iteration, and PPO's figures (rows are robots)."""

    env_runners: int = 2
    teams_per_runner: int = 1
    decisions: int = 2048
    minibatch_rows: int = 512
    epochs: int = 4
    learning_rate: float = 5e-4
    gamma: float = 0.99
    gae_lambda: float = 0.95
    entropy_coef: float = 0.003
    hidden: tuple[int, ...] = (128, 128)
    seed: int = 0

    def __post_init__(self) -> None:
        require(self.env_runners >= 0, "rllib.env_runners", self.env_runners, "0 (play in this process) or more")
        for name in ("teams_per_runner", "decisions", "minibatch_rows", "epochs"):
            require(getattr(self, name) >= 1, f"rllib.{name}", getattr(self, name), "1 or more")
        require(self.learning_rate > 0, "rllib.learning_rate", self.learning_rate, "more than 0")


@dataclass(frozen=True)
class Iteration:
    """One iteration: its number, decisions of teams so far, and the mean return of the teams that ended (or None)."""

    number: int
    decisions: int
    team_return: float | None


def role_of(agent: Any, *_: Any, **__: Any) -> str:
    """The role, which is also the network, of ``picket_3``."""
    return str(agent).rpartition("_")[0]


def ppo_config(
    settings: RllibSettings, make: Callable[[Any], RllibTeam], env_config: dict[str, Any], agents: tuple[str, ...]
) -> PPOConfig:
    """RLlib's configuration of PPO with one network a role."""
    network = DefaultModelConfig(fcnet_hiddens=list(settings.hidden), fcnet_activation="tanh", vf_share_layers=False)
    roles = sorted({role_of(agent) for agent in agents})
    register_env(make.__name__, make)
    # RLlib's check of one random step takes a robot that is lost in it, and is no more among the agents, for a mistake
    config = PPOConfig().environment(make.__name__, env_config=env_config, disable_env_checking=True)
    config.env_runners(num_env_runners=settings.env_runners, num_envs_per_env_runner=settings.teams_per_runner)
    config.multi_agent(policies=set(roles), policy_mapping_fn=role_of)
    config.rl_module(
        rl_module_spec=MultiRLModuleSpec(rl_module_specs={r: RLModuleSpec(model_config=network) for r in roles})
    )
    config.learners(num_learners=0, learner_class=TeamPPOLearner)
    config.training(
        train_batch_size_per_learner=settings.decisions,
        minibatch_size=settings.minibatch_rows,
        num_epochs=settings.epochs,
        lr=settings.learning_rate,
        gamma=settings.gamma,
        lambda_=settings.gae_lambda,
        entropy_coeff=settings.entropy_coef,
        use_kl_loss=False,
        vf_clip_param=float("inf"),
        grad_clip=0.5,
    )
    config.debugging(seed=settings.seed, log_level="ERROR")
    return config


def train_with_rllib(
    scenario: Scenario,
    iterations: int,
    settings: RllibSettings = RllibSettings(),
    out: Path | None = None,
    watch: Callable[[Algorithm, Iteration], None] = lambda _algorithm, _iteration: None,
) -> list[Iteration]:
    """Train on the scenario and, if ``out`` is given, leave RLlib's checkpoint there.

    ``watch`` is called after every iteration.
    """
    agents = tuple(member.name for member in scenario.team.members)
    config = ppo_config(settings, make_team, {"scenario": scenario, "seed": settings.seed}, agents)
    with cluster(settings.env_runners + 1), algorithm(config) as ppo:
        course = []
        for number in range(iterations):
            course.append(iteration(number, ppo.train(), agents[0]))
            watch(ppo, course[-1])
        if out is not None:
            ppo.save_to_path(str(out.absolute()))
    return course


def iteration(number: int, result: dict[str, Any], agent: str) -> Iteration:
    """What a training result says; every robot's return is its team's."""
    played = result["env_runners"]
    returns = played.get("agent_episode_returns_mean", {})
    team_return = float(returns[agent]) if agent in returns else None
    return Iteration(number, int(played["num_env_steps_sampled_lifetime"]), team_return)


@contextmanager
def algorithm(config: PPOConfig) -> Iterator[Algorithm]:
    """The algorithm, stopped in the end, and the folder gone that RLlib makes for it in the home directory."""
    ppo = config.build_algo()
    try:
        yield ppo
    finally:
        ppo.stop()
        shutil.rmtree(str(ppo.logdir), ignore_errors=True)


@contextmanager
def cluster(cpus: int) -> Iterator[None]:
    """The cluster that this process is part of, else a local one of so many CPUs for the time being."""
    if ray.is_initialized():
        yield
        return
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    folder = tempfile.mkdtemp(prefix="ray_")  # short: it holds sockets, whose paths may have 107 characters
    try:
        ray.init(
            num_cpus=cpus, include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR, _temp_dir=folder
        )
        yield
    finally:
        ray.shutdown()
        shutil.rmtree(folder, ignore_errors=True)

"""The teams that are trained, from the settings of a training."""

from __future__ import annotations

import numpy as np

from coop_envs.agents.control import action_mask
from coop_envs.geometry.keyed_random import mix
from coop_envs.scenario import Scenario
from coop_envs.vector_env import ExplorationVectorEnv
from train.team_vec_env import TeamVecEnv
from train.training_settings import TrainingSettings


def make_teams(settings: TrainingSettings, scenario: Scenario, threads: int) -> TeamVecEnv:
    """The teams that are trained, in training worlds.

    Team b's series of episodes has the seed of the environment plus b: seeds of trainings are spread far apart, so that
    no two trainings share a series.
    """
    env = ExplorationVectorEnv(
        scenario,
        settings.teams,
        device=settings.device,
        num_worlds=settings.num_worlds,
        seed=mix(settings.seed) % 2**62,
        threads=threads,
    )
    step_s = settings.repeat * scenario.rates.decision_s
    masks = np.stack([action_mask(member) for member in scenario.team.members])
    return TeamVecEnv(
        env,
        masks,
        repeat=settings.repeat,
        reward_scale=settings.reward_scale,
        spread=max(1, round(scenario.task.time_limit_s / step_s)),
    )

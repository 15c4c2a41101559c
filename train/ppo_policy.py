"""`TeamPolicy`: the team's network and its distribution of actions as Stable-Baselines3's actor-critic policy."""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor

from coop_envs.agents.control import HOLD
from policies.distribution import TeamActionDistribution
from policies.networks import NetworkSettings, TeamActorCritic
from train.team_vec_env import DOCKED
from train.training_error import TrainingError

Rows = dict[str, Tensor]


class TeamPolicy(ActorCriticPolicy):
    """One network for every row; `TeamActorCritic` says what it reads."""

    def __init__(self, *args: Any, network: NetworkSettings, **kwargs: Any) -> None:
        self.network_settings = network
        super().__init__(*args, **kwargs)

    def _build(self, lr_schedule: Schedule) -> None:
        self.network = TeamActorCritic(self.network_settings)
        self.optimizer = torch.optim.Adam(self.parameters(), lr=lr_schedule(1.0), eps=1e-5)

    def forward(self, obs: Rows, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Actions (rows, 8), not clipped, values (rows,) and log-densities (rows,).

        Rows that do not count are not computed: they hold, their numbers are zeros.
        """
        counting, part = _counting(obs)
        heads, values = self.network.heads_and_value(part)
        distribution = TeamActionDistribution(heads, part["action_mask"])
        actions = distribution.mode() if deterministic else distribution.sample()
        log_probs = distribution.log_prob(actions)
        everybody = _spread(actions, counting)
        everybody[~counting, HOLD] = 1.0
        return everybody, _spread(values, counting), _spread(log_probs, counting)

    def evaluate_actions(self, obs: Rows, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, log-densities of the actions, and entropies, (rows,) each.

        Raises:
            TrainingError: one of them is not finite.
        """
        heads, values = self.network.heads_and_value(obs)
        distribution = TeamActionDistribution(heads, obs["action_mask"])
        found = {"value": values, "log-density": distribution.log_prob(actions), "entropy": distribution.entropy()}
        for name, numbers in found.items():
            if not torch.isfinite(numbers).all():
                raise TrainingError(f"loss: got a {name} that is not finite, expected finite numbers")
        return found["value"], found["log-density"], found["entropy"]

    def predict_values(self, obs: Rows) -> Tensor:
        """(rows,); 0 for rows that do not count."""
        counting, part = _counting(obs)
        return _spread(self.network.value(part), counting)

    def _predict(self, observation: Rows, deterministic: bool = False) -> Tensor:
        return self(observation, deterministic)[0]


def _counting(obs: Rows) -> tuple[Tensor, Rows]:
    """Which rows (rows,) are of robots that are there and at work, and those rows."""
    counting = (obs["alive"][:, 0] > 0) & (obs["self"][:, DOCKED] == 0)
    return counting, obs if bool(counting.all()) else {name: rows[counting] for name, rows in obs.items()}


def _spread(part: Tensor, counting: Tensor) -> Tensor:
    """``part`` at the rows that count, zeros at the others."""
    if len(part) == len(counting):
        return part
    rows = part.new_zeros((len(counting), *part.shape[1:]))
    rows[counting] = part
    return rows

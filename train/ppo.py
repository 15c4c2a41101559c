"""`TeamPPO`: Stable-Baselines3's PPO over the rows of a `TeamVecEnv`.

What departs from SB3: endings of a step are bootstrapped together, rows that do not count are dropped (see
`TeamRolloutBuffer`), the network's normaliser is brought up to date between rollouts, and a gradient that is not
finite stops everything before it reaches the weights.
Source: Schulman et al., "Proximal policy optimization algorithms", 2017; Yu et al., "The surprising effectiveness of
PPO in cooperative multi-agent games", 2022, for one network and one value for the whole team.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv

from policies.networks import NetworkSettings
from train.ppo_buffer import TeamRolloutBuffer
from train.ppo_policy import TeamPolicy
from train.team_vec_env import TeamVecEnv
from train.training_error import TrainingError
from train.training_settings import PPOSettings


class TeamPPO(PPO):
    """PPO whose rows are robots that share their team's reward and one network."""

    policy: TeamPolicy

    def __init__(
        self, env: TeamVecEnv, network: NetworkSettings, settings: PPOSettings, *, seed: int, device: str = "cpu"
    ) -> None:
        with warnings.catch_warnings():
            warnings.filterwarnings(
                "ignore", "You have specified a mini-batch size"
            )  # TeamRolloutBuffer evens them out
            self._build(env, network, settings, seed, device)
        self.policy.optimizer.register_step_pre_hook(self._check_gradients)

    def _build(self, env: TeamVecEnv, network: NetworkSettings, settings: PPOSettings, seed: int, device: str) -> None:
        super().__init__(
            TeamPolicy,
            env,
            learning_rate=_schedule(settings),
            n_steps=settings.rollout_steps,
            batch_size=settings.minibatch_rows,
            n_epochs=settings.epochs,
            gamma=settings.gamma,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip,
            ent_coef=settings.entropy_coef,
            vf_coef=settings.value_coef,
            max_grad_norm=settings.max_grad_norm,
            target_kl=settings.target_kl,
            rollout_buffer_class=TeamRolloutBuffer,
            policy_kwargs={"network": network},
            seed=seed,
            device=device,
        )

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """Fill the buffer: SB3's method, but for the value of all endings of a step, which is asked for at once.

        SB3 asks for one at a time, which for thousands of rows costs more than the teams do.
        """
        assert self._last_obs is not None
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        callback.on_rollout_start()
        dones: NDArray[np.bool_] = np.zeros(env.num_envs, dtype=bool)
        for _ in range(n_rollout_steps):
            with torch.no_grad():
                rows = obs_as_tensor(self._last_obs, self.device)  # pyright: ignore[reportArgumentType]
                sampled, values, log_probs = self.policy(rows)
            actions = sampled.cpu().numpy()
            observations, rewards, dones, infos = env.step(np.clip(actions, -1.0, 1.0))
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            rewards = rewards + self._bootstrap(dones, infos)
            rollout_buffer.add(
                self._last_obs,  # pyright: ignore[reportArgumentType]
                actions,
                rewards,
                self._last_episode_starts,  # pyright: ignore[reportArgumentType]
                values,
                log_probs,
            )
            self._last_obs, self._last_episode_starts = observations, dones  # pyright: ignore[reportAttributeAccessIssue]
        rollout_buffer.compute_returns_and_advantage(last_values=self._values(self._last_obs), dones=dones)
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """One update of the weights, and then of the normaliser, so that it is the same while a rollout is used."""
        super().train()
        rows = {name: torch.as_tensor(array) for name, array in self.rollout_buffer.observations.items()}  # pyright: ignore[reportAttributeAccessIssue]
        self.policy.network.normaliser.update({name: rows[name].to(self.device) for name in ("self", "mates", "mask")})

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:
        """As SB3's, but from the rollout's start: the first update has the whole learning rate, the last not none."""
        super()._update_current_progress_remaining(num_timesteps - self.n_steps * self.n_envs, total_timesteps)

    def _bootstrap(self, dones: NDArray[np.bool_], infos: list[dict[str, Any]]) -> NDArray[np.float32]:
        """Discounted value (rows,) of what goes on behind an ending, 0 elsewhere."""
        added = np.zeros(len(dones), dtype=np.float32)
        rows = [k for k in np.flatnonzero(dones).tolist() if infos[k]["TimeLimit.truncated"]]
        if rows:
            seen = [infos[k]["terminal_observation"] for k in rows]
            stacked = {name: np.stack([each[name] for each in seen]) for name in seen[0]}
            added[rows] = self.gamma * self._values(stacked).cpu().numpy()
        return added

    @torch.no_grad()
    def _values(self, observations: Any) -> torch.Tensor:
        return self.policy.predict_values(obs_as_tensor(observations, self.device))  # pyright: ignore[reportArgumentType]

    def _check_gradients(self, optimizer: torch.optim.Optimizer, *_: Any) -> None:
        gradients = [p.grad for group in optimizer.param_groups for p in group["params"] if p.grad is not None]
        if not all(bool(torch.isfinite(gradient).all()) for gradient in gradients):
            raise TrainingError("gradient: got numbers that are not finite, expected finite numbers")


def _schedule(settings: PPOSettings) -> Any:
    """The learning rate over the share of training that is left."""
    if settings.learning_rate_decay == "none":
        return settings.learning_rate
    return lambda left: settings.learning_rate * max(left, 0.0)

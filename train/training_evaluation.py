"""How a policy does on held-out worlds while it is being trained: many episodes at the same time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.metrics import episode_metrics
from coop_envs.scenario import Scenario
from coop_envs.vector_env import ExplorationVectorEnv
from coop_envs.world_pool import default_num_worlds
from policies.onnx_policy import OnnxPolicy, drawn, rest_in_dock

SEED = 0
"""Of the first episode, in every evaluation of every training: they are all comparable."""
MEANS = ("return", "information_bits", "coverage", "pickets_lost", "action_energy_j", "simulated_s")
Act = Callable[[dict[str, NDArray[Any]]], NDArray[np.float32]]
"""From what all robots see, rows (B * N, ...), to their actions (B * N, 8)."""


class HeldOut:
    """The same episodes again and again, in worlds that nobody is trained in."""

    def __init__(self, scenario: Scenario, episodes: int, repeat: int, *, device: str, threads: int) -> None:
        worlds = min(default_num_worlds(scenario), episodes)
        self.repeat = repeat
        self.env = ExplorationVectorEnv(
            scenario, episodes, num_worlds=worlds, split="heldout", seed=SEED, device=device, threads=threads
        )

    def evaluate(self, act: Act) -> dict[str, Any]:
        """Run every episode to its end; `averages` of them. An action is held for ``repeat`` decisions."""
        observations, _ = self.env.reset(seed=SEED)
        b, n = observations["alive"].shape
        going, gained = np.ones(b, dtype=bool), np.zeros(b)
        actions, episodes, decision = np.zeros((b, n, 8), dtype=np.float32), [], 0
        while going.any():
            if decision % self.repeat == 0:
                rows = {name: array.reshape(b * n, *array.shape[2:]) for name, array in observations.items()}
                actions = np.asarray(act(rows), dtype=np.float32).reshape(b, n, -1)
            observations, reward, _, _, _ = self.env.step(actions)
            gained[going] += reward[going]
            ends = going & ~observations["alive"].any(axis=1)
            for team in np.flatnonzero(ends).tolist():
                batch, place = self.env.locate(team)
                episodes.append({"return": float(gained[team]), **episode_metrics(batch, place)})
            going &= ~ends
            decision += 1
        return averages(episodes)

    def close(self) -> None:
        """Let go of the teams."""
        self.env.close()


def actions_of(policy: OnnxPolicy, rows: int) -> Act:
    """What a policy file's network does in so many rows, drawn as in an evaluation if it is stochastic."""
    rng = np.random.default_rng(0)

    def act(observations: dict[str, NDArray[Any]]) -> NDArray[np.float32]:
        seen = {name: observations[name] for name in ("self", "mates", "mask", "map")}
        action, hold, mean, std = policy.answers(seen)
        if policy.description.stochastic:
            chance = rng.random(rows, dtype=np.float32)
            action = drawn(hold, mean, std, chance, rng.standard_normal(mean.shape, dtype=np.float32))
        return rest_in_dock(action, seen["self"])

    return act


def averages(episodes: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Means over episodes; bits per action joule as the ratio of sums, since an episode may spend next to nothing."""
    means = {name: float(np.mean([float(episode[name]) for episode in episodes])) for name in MEANS}
    spent = sum(episode["action_energy_j"] for episode in episodes)
    bits = sum(episode["information_bits"] for episode in episodes)
    success = float(np.mean([bool(episode["success"]) for episode in episodes]))
    return {"episodes": len(episodes), **means, "bits_per_action_joule": bits / max(spent, 1e-9), "success": success}

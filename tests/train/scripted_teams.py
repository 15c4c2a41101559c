"""Teams whose every decision is written down beforehand, in the shape of `ExplorationVectorEnv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.observations import MATE_SIZE, MATES, SELF_SIZE
from coop_envs.vector_env import team_observation_space

TERMS = ("information", "picket_lost")
Event = Mapping[str, Any]
"""``reward`` of a decision, and the robots that are ``lost`` or ``late`` in it."""


class ScriptedTeams:
    """Team b goes through ``scripts[b]``, one event a decision, again and again.

    Robot r of team b sees ``self[2] = 100 b + 10 t + r`` after t decisions of an episode; ``docked`` robots say so.
    """

    reward_terms = TERMS

    def __init__(self, scripts: Sequence[Sequence[Event]], robots: int, docked: Sequence[int] = ()) -> None:
        self.num_envs, self._robots, self._scripts = len(scripts), robots, scripts
        self.single_observation_space = team_observation_space(robots)
        self.single_action_space = np.zeros((robots, 8))
        self._docked = list(docked)
        self._time = np.zeros(self.num_envs, dtype=np.int64)
        self._alive = np.ones((self.num_envs, robots), dtype=bool)
        self.episodes = np.zeros(self.num_envs, dtype=np.int64)
        self.actions: list[NDArray[Any]] = []

    def reset(self, *, seed: int | None = None, mask: Any = None) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        chosen = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        self._begin(chosen)
        return self._observe(), {}

    def _begin(self, chosen: NDArray[Any]) -> None:
        self._time[chosen], self._alive[chosen] = 0, True
        self.episodes[chosen] += 1

    def step(self, actions: Any) -> tuple[Any, ...]:
        self.actions.append(np.array(actions))
        shape = self._alive.shape
        terminated, truncated = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
        terms = np.zeros((self.num_envs, len(TERMS)))
        started = np.logical_not(self._alive.any(axis=1))
        self._begin(started)
        for b in np.flatnonzero(~started).tolist():
            event = self._scripts[b][self._time[b]]
            terms[b, 0] = event.get("reward", 0.0)
            terminated[b, list(event.get("lost", ()))] = True
            truncated[b, list(event.get("late", ()))] = True
            self._time[b] += 1
        self._alive &= ~terminated & ~truncated
        return self._observe(), terms.sum(axis=1), terminated, truncated, {"reward_terms": terms, "started": started}

    def _observe(self) -> dict[str, NDArray[Any]]:
        b, n = self._alive.shape
        own = np.zeros((b, n, SELF_SIZE), dtype=np.float32)
        own[:, :, 2] = 100 * np.arange(b)[:, None] + 10 * self._time[:, None] + np.arange(n)
        own[:, 0, 0] = own[:, 1:, 1] = 1.0
        own[:, self._docked, 15] = 1.0
        return {
            "self": own,
            "mates": np.zeros((b, n, MATES, MATE_SIZE), dtype=np.float32),
            "mask": np.zeros((b, n, MATES), dtype=np.int8),
            "map": np.zeros((b, n, 3, 16, 16), dtype=np.uint8),
            "alive": self._alive.astype(np.int8),
        }

    def get_state(self) -> dict[str, Any]:
        return {"time": self._time.copy(), "alive": self._alive.copy()}

    def set_state(self, state: dict[str, Any]) -> None:
        self._time, self._alive = state["time"].copy(), state["alive"].copy()

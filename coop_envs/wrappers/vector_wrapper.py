"""`DisturbedTeams`: a `Disturbance` around `ExplorationVectorEnv`, or around another wrapper of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import ArrayLike, NDArray

from coop_envs.actions import ACTION_SIZE, checked_action
from coop_envs.errors import require
from coop_envs.wrappers.disturbance import Arrays, Disturbance, require_plain_actions


def teams_and_robots(env: VectorEnv[Any, Any, Any]) -> tuple[int, int]:
    """B and N of a vector environment of teams.

    Raises:
        ConfigError: it is something else.
    """
    require(isinstance(env, VectorEnv), "env", type(env).__name__, "a vector environment, as vector_env() gives it")
    shape = env.single_action_space.shape
    assert shape is not None
    return env.num_envs, shape[0]


class DisturbedTeams(VectorWrapper):
    """The teams of ``env`` with their actions and observations disturbed, team b as the single team with seed + b.

    Everything else of the environment stays reachable, ``scenario`` and ``batch`` among it; ``torch()`` gives the
    environment's own tensors, undisturbed.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], disturbance: Disturbance) -> None:
        super().__init__(env)
        require_plain_actions(env.single_action_space.shape, ACTION_SIZE)
        self.disturbance = disturbance

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)

    def reset(
        self,
        *,
        seed: int | list[int] | None = None,
        mask: ArrayLike | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Arrays, dict[str, Any]]:
        """Set down anew the teams where ``mask`` (B,) is true, or all; the others wait."""
        inner: Any = self.env
        observations, info = inner.reset(seed=seed, mask=mask, options=options)
        chosen = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        self.disturbance.begin(chosen, None if seed is None else int(np.asarray(seed).flat[0]))
        return self.disturbance.observations(observations), info

    def step(self, actions: ArrayLike) -> tuple[Arrays, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """As the environment's, with what the disturbance makes of it."""
        asked = checked_action("all", actions, self.action_space.shape or ())
        done = self.disturbance.actions(asked)
        observations, reward, terminated, truncated, info = self.env.step(done)
        info = {**info, **self.disturbance.report()}
        self.disturbance.moment.decisions += 1
        started = info["started"]
        if started.any():
            self.disturbance.begin(started)
        seen = self.disturbance.observations(observations)
        if "final_obs" in info:
            info["final_obs"] = seen
        return seen, reward, terminated, truncated, info

    def get_state(self) -> dict[str, Any]:
        """Everything that the teams' future depends on, the wrapper's part included."""
        inner: Any = self.env
        return {"disturbance": self.disturbance.get_state(), "env": inner.get_state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go back to what `get_state` gave.

        Raises:
            ConfigError: the state is of another batch or wrapper.
        """
        inner: Any = self.env
        self.disturbance.set_state(state["disturbance"])
        inner.set_state(state["env"])

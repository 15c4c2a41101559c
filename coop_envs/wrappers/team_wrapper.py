"""`DisturbedTeam`: a `Disturbance` around one team's PettingZoo environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from coop_envs.actions import ACTION_SIZE, checked_action, hold_action
from coop_envs.errors import require
from coop_envs.wrappers.disturbance import Arrays, Disturbance, require_plain_actions

Observation = dict[str, NDArray[Any]]
AnyParallelEnv = ParallelEnv[str, Observation, Any]

ALL = np.ones(1, dtype=bool)


def robots_of(env: AnyParallelEnv) -> list[str]:
    """Names of all robots of one team's environment.

    Raises:
        ConfigError: it is something else.
    """
    one_team = isinstance(env, ParallelEnv)
    require(one_team, "env", type(env).__name__, "one team, as parallel_env() gives it (many teams: Vector...)")
    return env.possible_agents


class DisturbedTeam(BaseParallelWrapper[str, Observation, Any]):
    """The team of ``env`` with its actions and observations disturbed.

    Everything else of the environment stays reachable: ``scenario``, ``team_description``, ``metrics()``, ``frame()``.
    """

    def __init__(self, env: AnyParallelEnv, disturbance: Disturbance) -> None:
        super().__init__(env)
        self.disturbance = disturbance
        self._place = {name: i for i, name in enumerate(robots_of(env))}
        if disturbance.changes_actions:
            require_plain_actions(env.action_space(env.possible_agents[0]).shape, ACTION_SIZE)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start an episode; ``seed`` starts a new series of them, None goes on with the present one."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self.disturbance.begin(ALL, seed)
        return self._seen(observations), infos

    def step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """As the environment's, with what the disturbance makes of it."""
        if not self.env.agents:
            return self.env.step(dict(actions))
        observations, rewards, terminations, truncations, infos = self.env.step(self._carried_out(actions))
        self.disturbance.moment.decisions += 1
        for key, values in self.disturbance.report().items():
            for name, info in infos.items():
                info[key] = values[0, self._place[name]].item()
        return self._seen(observations), rewards, terminations, truncations, infos

    def _carried_out(self, actions: Mapping[str, ArrayLike]) -> dict[str, Any]:
        """Actions by name; unknown names and missing robots are left for the environment to refuse."""
        if not self.disturbance.changes_actions:
            return dict(actions)
        asked = np.tile(hold_action(), (1, len(self._place), 1))
        known = {name: self._place[name] for name in actions if name in self._place}
        for name, i in known.items():
            asked[0, i] = checked_action(name, actions[name])
        done = self.disturbance.actions(asked)
        return {**actions, **{name: done[0, i] for name, i in known.items()}}

    def _seen(self, observations: dict[str, Observation]) -> dict[str, Observation]:
        if not observations:
            return observations
        first = next(iter(observations.values()))
        n = len(self._place)
        arrays: Arrays = {key: np.zeros((1, n, *part.shape), part.dtype) for key, part in first.items()}
        for name, observation in observations.items():
            for key, part in observation.items():
                arrays[key][0, self._place[name]] = part
        alive = [[int(name in self.env.agents) for name in self._place]]
        seen = self.disturbance.observations({**arrays, "alive": np.array(alive, dtype=np.int8)})
        return {name: {key: seen[key][0, self._place[name]] for key in first} for name in observations}

    def get_state(self) -> dict[str, Any]:
        """Everything that an episode's future depends on, the wrapper's part included."""
        return {"disturbance": self.disturbance.get_state(), "env": self.__getattr__("get_state")()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go back to what `get_state` gave.

        Raises:
            ConfigError: the state is of another world, team or wrapper.
        """
        self.disturbance.set_state(state["disturbance"])
        self.__getattr__("set_state")(state["env"])

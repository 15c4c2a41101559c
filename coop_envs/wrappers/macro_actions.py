"""Macro-actions as the action space: go to a cell, scan towards a cell, wait.

An action is ``MultiDiscrete([3, 16, 16])``: kind (`GO`, `SCAN`, `WAIT`) and a cell of the robot's own map window. A
factored space of three small numbers serves every learning library as it is; one `Discrete` would have 769 values, and
a `Dict` or `Tuple` is refused by some.

Macro-actions take unequal times, so robots are asked one by one. `step` goes on for as many decisions as it takes until
somebody's macro-action ends or somebody is gone, and then returns for everyone alive, as the parallel interface wants.
``infos[agent]["asked"]`` says who is asked now; the actions of others are ignored and may be left out. Rewards are sums
over the decisions of this `step`. For semi-Markov learning ``infos`` also holds of the robot's own macro-action, so
far or in all: ``macro_outcome`` (running, done, blocked, late), ``macro_return`` and ``macro_decisions``.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike
from pettingzoo.utils import BaseParallelWrapper

from coop_envs.actions import ACTION_SIZE
from coop_envs.errors import ActionError
from coop_envs.observations import WINDOW
from coop_envs.policy import TeamDescription
from coop_envs.wrappers.disturbance import require_plain_actions
from coop_envs.wrappers.macro_driving import MacroDriver, MacroSettings
from coop_envs.wrappers.team_wrapper import AnyParallelEnv, Observation, robots_of

KINDS = ("go", "scan", "wait")
SPACE = (len(KINDS), WINDOW, WINDOW)


class MacroActions(BaseParallelWrapper[str, Observation, Any]):
    """One team that is told what to do, not how; wrappers that change plain actions belong inside."""

    def __init__(self, env: AnyParallelEnv, settings: MacroSettings = MacroSettings()) -> None:  # noqa: B008  frozen
        super().__init__(env)
        require_plain_actions(env.action_space(robots_of(env)[0]).shape, ACTION_SIZE)
        self._settings = settings
        self._spaces = {name: spaces.MultiDiscrete(np.array(SPACE)) for name in env.possible_agents}
        self._drivers: dict[str, MacroDriver] = {}
        self._asked: set[str] = set()
        self._seen: dict[str, Observation] = {}
        self._returns: dict[str, tuple[float, int]] = {}

    def action_space(self, agent: str) -> spaces.MultiDiscrete:
        return self._spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start an episode, in which everybody is asked first."""
        self._seen, infos = self.env.reset(seed=seed, options=options)
        team: TeamDescription = self.__getattr__("team_description")
        self._drivers = {name: MacroDriver(team, i, self._settings) for i, name in enumerate(team.names)}
        self._asked = set(self.env.agents)
        return dict(self._seen), {name: {**info, "asked": True} for name, info in infos.items()}

    def step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Start the macro-actions of those who are asked and go on until somebody is asked again.

        Raises:
            ActionError: a robot that is asked has no action, or one outside its space.
        """
        acting = list(self.env.agents)
        for name in acting:
            if name in self._asked:
                kind, i, j = self._checked(name, actions.get(name))
                self._drivers[name].start(kind, (i, j), self._seen[name])
                self._returns[name] = (0.0, 0)
        rewards, terms = dict.fromkeys(acting, 0.0), {}
        self._asked, outcomes = set(), dict.fromkeys(acting, "running")
        terminations, truncations = dict.fromkeys(acting, False), dict.fromkeys(acting, False)
        infos: dict[str, dict[str, Any]] = {}
        while not (self._asked or any(terminations.values()) or any(truncations.values())) and acting:
            plain = {name: self._drivers[name].act(self._seen[name]) for name in acting}
            self._seen, got, terminations, truncations, infos = self.env.step(plain)
            for name in acting:
                rewards[name] += got[name]
                past, decisions = self._returns[name]
                self._returns[name] = past + got[name], decisions + 1
                outcomes[name] = self._drivers[name].outcome(self._seen[name])
            terms = _summed(terms, infos[acting[0]].get("reward_terms", {}))
            self._asked = {name for name in self.env.agents if outcomes[name] != "running"}
        told = {name: self._told(name, infos[name], outcomes[name], terms) for name in acting}
        return dict(self._seen) if acting else {}, rewards, terminations, truncations, told

    def _checked(self, name: str, action: ArrayLike | None) -> tuple[int, int, int]:
        chosen = np.asarray(-1 if action is None else action)
        if not (chosen.shape == (len(SPACE),) and self._spaces[name].contains(chosen.astype(np.int64))):
            raise ActionError(f"action[{name}]", action, f"whole numbers below {SPACE}: the robot is asked")
        kind, i, j = chosen.astype(int).tolist()
        return kind, i, j

    def _told(self, name: str, info: dict[str, Any], outcome: str, terms: dict[str, float]) -> dict[str, Any]:
        summed, decisions = self._returns[name]
        mine = {"macro_outcome": outcome, "macro_return": summed, "macro_decisions": decisions}
        return {**info, "reward_terms": terms, "asked": name in self._asked, **mine}

    def get_state(self) -> dict[str, Any]:
        """Everything that an episode's future depends on, unfinished macro-actions included."""
        own = {"drivers": self._drivers, "asked": self._asked, "seen": self._seen, "returns": self._returns}
        return {**copy.deepcopy(own), "env": self.__getattr__("get_state")()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go back to what `get_state` gave.

        Raises:
            ConfigError: the state is of another world, team or wrapper.
        """
        own = copy.deepcopy({key: value for key, value in state.items() if key != "env"})
        self._drivers, self._asked = own["drivers"], own["asked"]
        self._seen, self._returns = own["seen"], own["returns"]
        self.__getattr__("set_state")(state["env"])


def _summed(a: Mapping[str, float], b: Mapping[str, float]) -> dict[str, float]:
    return {name: a.get(name, 0.0) + value for name, value in b.items()}

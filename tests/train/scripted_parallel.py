"""A team as a PettingZoo environment whose robots end as written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from coop_envs.actions import action_space
from coop_envs.observations import MATE_SIZE, MATES, SELF_SIZE, observation_space

Ends = Mapping[str, str]


class ScriptedTeam(ParallelEnv):
    """A team whose robots end as written: ``script[t]`` says who is ``lost`` or ``late`` in step t.

    Step t gives everybody reward ``t + 1``; ``self[4]`` of robot k's observation is 0.01 k + 0.1 t.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "scripted"}

    def __init__(self, names: tuple[str, ...], script: list[Ends]) -> None:
        self.possible_agents, self.agents, self.script = list(names), [], script
        self._spaces = observation_space(), action_space()

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        return self._spaces[0]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        return self._spaces[1]

    def _observe(self, names: list[str]) -> dict[str, dict[str, np.ndarray]]:
        seen = {}
        for name in names:
            own = np.zeros(SELF_SIZE, np.float32)
            own[0], own[4] = 1.0, 0.01 * self.possible_agents.index(name) + 0.1 * self.t
            mates, mask = np.zeros((MATES, MATE_SIZE), np.float32), np.zeros(MATES, np.int8)
            seen[name] = {"self": own, "mates": mates, "mask": mask, "map": np.zeros((3, 16, 16), np.uint8)}
        return seen

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.t, self.agents = 0, list(self.possible_agents)
        return self._observe(self.agents), {name: {} for name in self.agents}

    def step(self, actions: dict[str, Any]) -> Any:
        assert set(self.agents) <= set(actions)
        acting, ends = self.agents, self.script[self.t]
        self.t += 1
        self.agents = [name for name in acting if name not in ends]
        flags = [{name: ends.get(name) == kind for name in acting} for kind in ("lost", "late")]
        return self._observe(acting), dict.fromkeys(acting, float(self.t)), *flags, {name: {} for name in acting}

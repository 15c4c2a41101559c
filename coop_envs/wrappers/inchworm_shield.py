"""The inchworm rule enforced: a robot that may not move by `coop_envs.inchworm_rule` holds instead."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from coop_envs.inchworm_rule import HOLD, permitted
from coop_envs.wrappers.disturbance import Actions, Arrays, Chosen, Disturbance
from coop_envs.wrappers.team_wrapper import AnyParallelEnv, DisturbedTeam, robots_of
from coop_envs.wrappers.vector_wrapper import DisturbedTeams, teams_and_robots

NEEDED = ("self", "mates", "mask", "alive")


class Shield(Disturbance):
    """Holds the robots of B teams that the rule does not let move, by the observations of the decision before."""

    changes_actions = True

    def __init__(self, teams: int, robots: int) -> None:
        super().__init__(teams)
        self._held = np.zeros((teams, robots), dtype=bool)

    def actions(self, actions: Actions) -> Actions:
        allowed = permitted(self.arrays, actions) if self.arrays else actions
        self._held = (allowed[..., HOLD] > 0.0) & (actions[..., HOLD] <= 0.0)
        return allowed

    def observations(self, observations: Arrays) -> Arrays:
        self.arrays = {name: observations[name].copy() for name in NEEDED}
        return observations

    def begin(self, chosen: Chosen, seed: int | None = None) -> None:
        super().begin(chosen, seed)
        self._held[chosen] = False

    def report(self) -> Arrays:
        return {"shielded": self._held.copy()}


class InchwormShield(DisturbedTeam):
    """One team that keeps the inchworm rule; ``infos[agent]["shielded"]`` says whose move became a hold."""

    def __init__(self, env: AnyParallelEnv) -> None:
        super().__init__(env, Shield(1, len(robots_of(env))))


class VectorInchwormShield(DisturbedTeams):
    """Teams that keep the inchworm rule; ``info["shielded"]`` (B, N) says whose move became a hold."""

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        super().__init__(env, Shield(*teams_and_robots(env)))

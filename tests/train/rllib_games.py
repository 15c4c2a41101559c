"""The sacrifice game as a PettingZoo environment, and as RLlib gets it."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.train.sacrifice_game import MEMBERS, observe, play
from tests.train.scripted_parallel import ScriptedTeam
from train.rllib_env import RllibTeam


class SacrificeTeam(ScriptedTeam):
    """The sacrifice game with one team."""

    def __init__(self) -> None:
        super().__init__(MEMBERS, [])

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.known = False
        return super().reset(seed, options)

    def _observe(self, names: list[str]) -> dict[str, dict[str, np.ndarray]]:
        arrays = observe(self.t + 1, self.known)
        return {name: {key: arrays[key][MEMBERS.index(name)] for key in self._spaces[0]} for name in names}

    def step(self, actions: dict[str, Any]) -> Any:
        acting = self.agents
        drives = [name in actions and float(np.asarray(actions[name])[0]) <= 0.0 for name in MEMBERS]
        self.t += 1
        reward, lost, over = play(self.t, self.known, *drives)
        self.known |= lost
        ended = {name: over or (lost and name == "picket_0") for name in acting}
        self.agents = [name for name in acting if not ended[name]]
        infos: dict[str, dict[str, Any]] = {name: {} for name in acting}
        return self._observe(acting), dict.fromkeys(acting, reward), ended, dict.fromkeys(acting, False), infos


def make_sacrifice(config: Any) -> RllibTeam:
    return RllibTeam(SacrificeTeam(), posthumous=config["posthumous"])

"""A radio that drops messages: a robot that misses the update acts on what it received last."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from gymnasium.vector import VectorEnv

from coop_envs.errors import require
from coop_envs.wrappers.disturbance import Arrays, Disturbance, stream_of
from coop_envs.wrappers.team_wrapper import AnyParallelEnv, DisturbedTeam
from coop_envs.wrappers.vector_wrapper import DisturbedTeams

KIND = 2
Missed = Literal["all", "mates"]
PARTS: dict[Missed, tuple[str, ...]] = {"all": ("self", "mates", "mask", "map"), "mates": ("mates", "mask")}


class LastReceived(Disturbance):
    """With the chance ``chance`` per robot and decision an observation does not arrive and the last one stays.

    ``missed`` is what a message holds: the whole observation, or only what it says of mates (``mates`` and ``mask``,
    as they stood in the axes of the time). The first observation of an episode always arrives.
    """

    def __init__(self, teams: int, chance: float, missed: Missed = "all", stream: int = 0) -> None:
        super().__init__(teams)
        require(0.0 <= chance <= 1.0, "chance", chance, "0 to 1")
        require(missed in PARTS, "missed", missed, " or ".join(PARTS))
        self._chance, self._parts, self._stream = chance, PARTS[missed], stream_of(KIND, stream)

    def observations(self, observations: Arrays) -> Arrays:
        robots = observations["mask"].shape[1]
        arrived = self.moment.uniform(self._stream, (robots,)) >= self._chance
        arrived |= (self.moment.decisions == 0)[:, None]
        seen = dict(observations)
        for name in self._parts:
            new = observations[name]
            if name in self.arrays and not arrived.all():
                new = np.where(arrived.reshape(*arrived.shape, *[1] * (new.ndim - 2)), new, self.arrays[name])
            self.arrays[name], seen[name] = new, new.copy()
        return seen


class MessageLoss(DisturbedTeam):
    """One team over a radio that drops messages; see `LastReceived`."""

    def __init__(self, env: AnyParallelEnv, chance: float, missed: Missed = "all", stream: int = 0) -> None:
        super().__init__(env, LastReceived(1, chance, missed, stream))


class VectorMessageLoss(DisturbedTeams):
    """Teams over a radio that drops messages; see `LastReceived`."""

    def __init__(self, env: VectorEnv[Any, Any, Any], chance: float, missed: Missed = "all", stream: int = 0) -> None:
        super().__init__(env, LastReceived(env.num_envs, chance, missed, stream))

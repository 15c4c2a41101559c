"""Actions that take effect some decisions late, as over a slow radio."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv

from coop_envs.actions import ACTION_SIZE, hold_action
from coop_envs.errors import require
from coop_envs.wrappers.disturbance import Actions, Chosen, Disturbance, stream_of
from coop_envs.wrappers.team_wrapper import AnyParallelEnv, DisturbedTeam, robots_of
from coop_envs.wrappers.vector_wrapper import DisturbedTeams, teams_and_robots

KIND = 1


class DelayLine(Disturbance):
    """Holds the actions of B teams back by whole decisions, the same for all robots of a team.

    ``decisions`` is the delay, or its least and greatest value, between which each episode draws. Until the first
    action arrives robots hold, their hats at half brightness.
    """

    changes_actions = True

    def __init__(self, teams: int, robots: int, decisions: int | tuple[int, int], stream: int = 0) -> None:
        super().__init__(teams)
        low, high = (decisions, decisions) if isinstance(decisions, int) else decisions
        require(0 <= low <= high <= 100, "decisions", decisions, "0 to 100, or a least and a greatest of these")
        self._low, self._choices, self._stream = low, high - low + 1, stream_of(KIND, stream)
        waiting = np.tile(hold_action(), (teams, high + 1, robots, 1))
        self.arrays = {"waiting": waiting, "delay": np.full(teams, low, dtype=np.int64)}
        assert waiting.shape[-1] == ACTION_SIZE

    def begin(self, chosen: Chosen, seed: int | None = None) -> None:
        super().begin(chosen, seed)
        self.arrays["waiting"][chosen] = hold_action()
        drawn = self._low + np.floor(self._choices * self.moment.uniform(self._stream, ())).astype(np.int64)
        self.arrays["delay"][chosen] = drawn[chosen]

    def actions(self, actions: Actions) -> Actions:
        """The actions (B, N, 8) that arrive now."""
        waiting = self.arrays["waiting"]
        waiting[:, 1:] = waiting[:, :-1].copy()
        waiting[:, 0] = actions
        return waiting[np.arange(len(waiting)), self.arrays["delay"]]


class ActionDelay(DisturbedTeam):
    """One team whose actions take effect ``decisions`` late; see `DelayLine`."""

    def __init__(self, env: AnyParallelEnv, decisions: int | tuple[int, int], stream: int = 0) -> None:
        super().__init__(env, DelayLine(1, len(robots_of(env)), decisions, stream))


class VectorActionDelay(DisturbedTeams):
    """Teams whose actions take effect ``decisions`` late; see `DelayLine`."""

    def __init__(self, env: VectorEnv[Any, Any, Any], decisions: int | tuple[int, int], stream: int = 0) -> None:
        super().__init__(env, DelayLine(*teams_and_robots(env), decisions, stream))

"""What wrappers do to batches of teams, as arrays; `team_wrapper` and `vector_wrapper` put it around environments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import ConfigError, require
from coop_envs.wrappers.keyed_draws import STREAM_BITS, Counts, Keys, episode_keys, normal, uniform

Arrays = dict[str, NDArray[Any]]
Chosen = NDArray[np.bool_]
Actions = NDArray[np.float32]


class Moment:
    """Seed, episode and decision of B teams, from which all random numbers of a wrapper follow.

    Team b counts as `ExplorationVectorEnv` counts: ``reset(seed)`` gives it the seed ``seed + b`` and episode 0, every
    further start the next episode.
    """

    def __init__(self, teams: int) -> None:
        self.seeds: Counts = np.arange(teams, dtype=np.int64)
        self.episodes: Counts = np.full(teams, -1, dtype=np.int64)
        self.decisions: Counts = np.zeros(teams, dtype=np.int64)
        self.keys: Keys = episode_keys(self.seeds, self.episodes)

    def restart(self, chosen: Chosen, seed: int | None = None) -> None:
        """Begin the next episode of the chosen teams (B,)."""
        if seed is not None:
            self.seeds[chosen] = seed + np.flatnonzero(chosen)
            self.episodes[chosen] = -1
        self.episodes[chosen] += 1
        self.decisions[chosen] = 0
        self.keys = episode_keys(self.seeds, self.episodes)

    def uniform(self, stream: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Uniform numbers (B, *shape) of this decision."""
        return uniform(self.keys, self.decisions, stream, shape)

    def normal(self, stream: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Standard normal numbers (B, *shape) of this decision."""
        return normal(self.keys, self.decisions, stream, shape)

    def get_state(self) -> Arrays:
        """A copy of the counts."""
        return {"seeds": self.seeds.copy(), "episodes": self.episodes.copy(), "decisions": self.decisions.copy()}

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Go back to what `get_state` gave."""
        self.seeds, self.episodes, self.decisions = (state[k].copy() for k in ("seeds", "episodes", "decisions"))
        self.keys = episode_keys(self.seeds, self.episodes)


class Disturbance:
    """Changes to the actions (B, N, 8) and observations (name: (B, N, ...)) of B teams, and the state that they need.

    Observations are those of `ExplorationVectorEnv`. `observations` may be called again in the same decision and then
    answers the same. ``moment`` and ``arrays`` are all the state there is, first axis B.
    """

    changes_actions: ClassVar[bool] = False

    def __init__(self, teams: int) -> None:
        self.moment = Moment(teams)
        self.arrays: Arrays = {}

    def begin(self, chosen: Chosen, seed: int | None = None) -> None:
        """Forget the past of the chosen teams (B,): their next episode starts."""
        self.moment.restart(chosen, seed)

    def actions(self, actions: Actions) -> Actions:
        """What is carried out when the policy asks for ``actions``."""
        return actions

    def observations(self, observations: Arrays) -> Arrays:
        """What the policy gets to see."""
        return observations

    def report(self) -> Arrays:
        """What `actions` did, by name (B, N), for infos."""
        return {}

    def get_state(self) -> dict[str, Arrays]:
        """A copy of the state."""
        arrays = {name: array.copy() for name, array in self.arrays.items()}
        return {"moment": self.moment.get_state(), "arrays": arrays}

    def set_state(self, state: Mapping[str, Arrays]) -> None:
        """Go back to what `get_state` gave.

        Raises:
            ConfigError: the state is of a wrapper with other settings, or of another batch.
        """
        given = state["arrays"]
        for name, array in self.arrays.items():
            got = None if name not in given else given[name].shape
            require(got == array.shape, f"state.{name}", got, f"an array of shape {array.shape}")
        self.arrays = {name: array.copy() for name, array in given.items()}
        self.moment.set_state(state["moment"])


def stream_of(kind: int, stream: int, part: int = 0) -> int:
    """The stream of a part, 0 to 15, of a kind of wrapper, 0 to 15; ``stream`` tells apart two wrappers of a kind."""
    require(0 <= stream < 256, "stream", stream, "0 to 255")
    return (stream << (STREAM_BITS - 8)) | (kind << 4) | part


def require_plain_actions(shape: tuple[int, ...] | None, size: int) -> None:
    """Raise `ConfigError` unless the last axis of the action space holds a robot's plain action."""
    if shape is None or shape[-1:] != (size,):
        raise ConfigError("wrapper.env.action_space", shape, f"{size} numbers a robot: put it inside MacroActions")

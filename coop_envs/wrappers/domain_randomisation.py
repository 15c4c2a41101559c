"""A scenario drawn anew for every episode: friction, noise, losses, speeds, anything that a scenario holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pettingzoo.utils import BaseParallelWrapper

from coop_envs.errors import ConfigError, require
from coop_envs.geometry.keyed_random import team_key
from coop_envs.parallel_env import ExplorationParallelEnv
from coop_envs.scenario import Scenario, load_scenario
from coop_envs.wrappers.team_wrapper import AnyParallelEnv, Observation


@dataclass(frozen=True)
class Range:
    """Numbers from ``low`` to ``high``, drawn evenly, or evenly in their logarithm; whole ones if both ends are."""

    low: float
    high: float
    log: bool = False

    def __post_init__(self) -> None:
        finite = math.isfinite(self.low) and math.isfinite(self.high)
        require(finite and self.low <= self.high, "range", (self.low, self.high), "low to high, both finite")
        require(not self.log or self.low > 0, "range.low", self.low, "more than 0 for a range in logarithms")

    def draw(self, rng: np.random.Generator) -> float:
        if isinstance(self.low, int) and isinstance(self.high, int) and not self.log:
            return int(rng.integers(self.low, self.high, endpoint=True))
        if self.log:
            return float(np.exp(rng.uniform(math.log(self.low), math.log(self.high))))
        return float(rng.uniform(self.low, self.high))

    @property
    def extremes(self) -> tuple[float, ...]:
        return self.low, self.high


@dataclass(frozen=True)
class Choice:
    """One of several values, each as likely."""

    options: tuple[Any, ...]

    def __post_init__(self) -> None:
        require(len(self.options) > 0, "choice.options", self.options, "at least one value")

    def draw(self, rng: np.random.Generator) -> Any:
        return self.options[int(rng.integers(len(self.options)))]

    @property
    def extremes(self) -> tuple[Any, ...]:
        return self.options


Ranges = Mapping[str, Range | Choice]


def sample_scenario(scenario: Scenario, ranges: Ranges, rng: np.random.Generator) -> Scenario:
    """The scenario with every entry of ``ranges`` (dotted names, as `load_scenario` takes them) drawn anew.

    Raises:
        ConfigError: an unknown entry, or values that do not go together.
    """
    return load_scenario(scenario, **{name: ranges[name].draw(rng) for name in sorted(ranges)})


def check_ranges(scenario: Scenario, ranges: Ranges) -> None:
    """Try both ends of every range, and every choice, with the others at their first end; then all at their last.

    Raises:
        ConfigError: one of them makes no valid scenario, or one of another team.
    """
    first, last = ({name: entry.extremes[end] for name, entry in ranges.items()} for end in (0, -1))
    alone = [{**first, name: value} for name, entry in ranges.items() for value in entry.extremes]
    names = [member.name for member in scenario.team.members]
    for changes in (*alone, last):
        got = [member.name for member in load_scenario(scenario, **changes).team.members]
        require(got == names, "ranges", list(changes), f"entries that leave the team {names}")


class DomainRandomisation(BaseParallelWrapper[str, Observation, Any]):
    """One team whose every episode takes place in a scenario of its own; ``scenario`` is the present one.

    It may wrap other wrappers: the environment innermost is rebuilt. An episode's scenario and course follow from the
    seed of the series and the episode's number.
    """

    def __init__(self, env: AnyParallelEnv, ranges: Ranges) -> None:
        super().__init__(env)
        check_ranges(self._base.scenario, ranges)
        self._nominal, self._ranges = self._base.scenario, dict(ranges)
        self._seed, self._episode, self._options = 0, -1, None
        self._spaces = {name: (env.observation_space(name), env.action_space(name)) for name in env.possible_agents}

    def observation_space(self, agent: str) -> Any:
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> Any:
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Draw a scenario and start an episode in it; ``seed`` starts a new series of episodes."""
        if seed is not None:
            require(seed >= 0, "seed", seed, "0 or more")
        self._seed, self._episode = (self._seed, self._episode + 1) if seed is None else (seed, 0)
        self._options = options
        return self._start(sample_scenario(self._nominal, self._ranges, np.random.default_rng(self._key)))

    @property
    def _base(self) -> ExplorationParallelEnv:
        base = self.env.unwrapped
        if not isinstance(base, ExplorationParallelEnv):
            raise ConfigError("wrapper.env", type(base).__name__, "an exploration environment, wrapped or not")
        return base

    @property
    def _key(self) -> int:
        """63 bits: seeds of vector forms are signed."""
        return team_key(self._seed, self._episode) >> 1

    def _start(self, scenario: Scenario) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        base = self._base
        if base.scenario != scenario:
            holder: Any = self
            while isinstance(holder.env, BaseParallelWrapper):
                holder = holder.env
            settings: dict[str, Any] = {
                "render_mode": base.render_mode,
                "num_worlds": base.num_worlds,
                "split": base.split,
            }
            holder.env = ExplorationParallelEnv(scenario, **settings)
            base.close()
        return self.env.reset(seed=self._key, options=self._options)

    def get_state(self) -> dict[str, Any]:
        """Everything that an episode's future depends on, its scenario included."""
        own = {"seed": self._seed, "episode": self._episode, "options": self._options}
        return {**own, "scenario": self._base.scenario, "env": self.__getattr__("get_state")()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go back to what `get_state` gave.

        Raises:
            ConfigError: the state is of another world, team or wrapper.
        """
        self._seed, self._episode, self._options = state["seed"], state["episode"], state["options"]
        self._start(state["scenario"])
        self.__getattr__("set_state")(state["env"])

"""Exploration with a team of observer and picket robots, version 0: the entry to the environment.

``parallel_env`` and ``env`` are PettingZoo's two interfaces to one team, ``vector_env`` steps many teams at once,
``team_env`` puts a team under one controller for Gymnasium. ``scenario`` is a name, a YAML file or a `Scenario`;
``overrides`` replace its entries (see `scenario.load_scenario`).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from coop_envs.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from pettingzoo import AECEnv

    from coop_envs.parallel_env import ExplorationParallelEnv
    from coop_envs.vector_env import ExplorationTeamEnv, ExplorationVectorEnv
    from coop_envs.worlds.build import Split

__all__ = ["env", "parallel_env", "team_env", "vector_env"]


def parallel_env(
    scenario: str | Path | Scenario = "arena",
    fidelity: str = "features",
    physics: str = "fast",
    render_mode: str | None = None,
    seed: int | None = None,
    *,
    num_worlds: int | None = None,
    split: Split = "train",
    **overrides: Any,
) -> ExplorationParallelEnv:
    """One team as a PettingZoo parallel environment.

    Raises:
        ConfigError: an unknown scenario, key or choice; a value out of range.
    """
    from coop_envs.parallel_env import ExplorationParallelEnv

    chosen = load_scenario(scenario, fidelity=fidelity, physics=physics, **overrides)
    return ExplorationParallelEnv(chosen, render_mode=render_mode, seed=seed, num_worlds=num_worlds, split=split)


def env(scenario: str | Path | Scenario = "arena", **settings: Any) -> AECEnv[str, Any, Any]:
    """One team as a PettingZoo AEC environment; settings as for `parallel_env`."""
    from pettingzoo.utils import OrderEnforcingWrapper, parallel_to_aec

    parallel: Any = parallel_env(scenario, **settings)
    return OrderEnforcingWrapper(parallel_to_aec(parallel))


def vector_env(
    num_envs: int = 1024,
    scenario: str | Path | Scenario = "arena",
    device: str = "cpu",
    num_worlds: int | None = None,
    max_robots: int | None = None,
    fidelity: str = "poses",
    physics: str = "fast",
    split: Split = "train",
    seed: int = 0,
    threads: int | None = None,
    **overrides: Any,
) -> ExplorationVectorEnv:
    """``num_envs`` teams in step; see `vector_env.ExplorationVectorEnv`."""
    from coop_envs.vector_env import ExplorationVectorEnv

    chosen = load_scenario(scenario, fidelity=fidelity, physics=physics, **overrides)
    settings: dict[str, Any] = {"num_worlds": num_worlds, "max_robots": max_robots, "split": split, "seed": seed}
    settings |= {"threads": threads}
    return ExplorationVectorEnv(chosen, num_envs, device=device, **settings)


def team_env(
    scenario: str | Path | Scenario = "arena",
    render_mode: str | None = None,
    fidelity: str = "poses",
    physics: str = "fast",
    *,
    device: str = "cpu",
    num_worlds: int | None = None,
    split: Split = "train",
    **overrides: Any,
) -> ExplorationTeamEnv:
    """One team under one controller, as ``gymnasium.make("coop_envs/Exploration-v0")`` gives it."""
    from coop_envs.vector_env import ExplorationTeamEnv

    chosen = load_scenario(scenario, fidelity=fidelity, physics=physics, **overrides)
    return ExplorationTeamEnv(chosen, render_mode=render_mode, device=device, num_worlds=num_worlds, split=split)

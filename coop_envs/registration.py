"""The environment's name in the registries of Gymnasium and PettingZoo.

Gymnasium 1.x and PettingZoo find no plugins by themselves, so `coop_envs` registers when it is imported. The entry
points are strings: nothing of the environment is imported before someone makes it.
"""

from __future__ import annotations

import gymnasium
import pettingzoo

NAME = "coop_envs/Exploration-v0"


def register_environments() -> None:
    """Make ``coop_envs/Exploration-v0`` known; calling it again changes nothing.

    ``pettingzoo.make("parallel" | "aec", NAME)`` gives the team, ``gymnasium.make(NAME)`` the team under one
    controller, ``gymnasium.make_vec(NAME)`` many teams at once.
    """
    if NAME not in gymnasium.registry:
        gymnasium.register(
            NAME,
            entry_point="coop_envs.exploration_v0:team_env",
            vector_entry_point="coop_envs.exploration_v0:vector_env",
        )
    if NAME not in pettingzoo.parallel_registry:
        pettingzoo.register("parallel", NAME, "coop_envs.exploration_v0:parallel_env")
        pettingzoo.register("aec", NAME, "coop_envs.exploration_v0:env")

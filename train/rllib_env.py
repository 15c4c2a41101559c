"""A team as RLlib's `MultiAgentEnv`, with endings that RLlib's new API stack gets right.

RLlib's own PettingZoo wrapper ends no episode in which some robots terminate and others run out of time, and RLlib
itself takes an episode for terminated as soon as every agent's own flag is up, which drops the bootstrap of timeouts.
So only true terminations are flagged agent by agent, and a timeout is flagged for ``__all__`` alone.

Posthumous credit: a lost robot must be credited with what its team earns afterwards, or no robot ever learns to give
itself up. RLlib bootstraps only from the module of the agent that ends, on an observation of its own; of the module
that plays pickets, say, nobody asks the value of what an observer sees. So with ``posthumous`` a lost robot stays in
the episode as a silent agent until its team ends: it gets the team's reward, sees what the first robot left sees, with
``acting`` 0 as the last entry, and what it answers is ignored. Its return is then its team's, its module learns the
value of being gone, and roles may have modules of their own. The price is rows without a choice: `train.rllib_learner`
keeps them out of the policy's loss. A reserve in its dock is silent too, until it is called.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv
from ray.rllib.env.multi_agent_env import MultiAgentEnv

from coop_envs.geometry.keyed_random import team_key
from coop_envs.observations import MAP_LAYERS, MATE_SIZE, MATES, SELF_SIZE, WINDOW, self_field
from coop_envs.scenario import Scenario

Observation = dict[str, NDArray[Any]]
Flat = NDArray[np.float32]

POOLED = 4
FLAT_SIZE = SELF_SIZE + MATES * MATE_SIZE + MATES + len(MAP_LAYERS) * POOLED**2 + 1
LIMIT = 10.0


def flattened(observation: Observation, acting: bool) -> Flat:
    """An observation as one vector (`FLAT_SIZE`,): self, mates, mask, the map in 4 x 4 means from 0 to 1, acting."""
    side = WINDOW // POOLED
    window = observation["map"].reshape(len(MAP_LAYERS), POOLED, side, POOLED, side).mean(axis=(2, 4)) / 255.0
    mates = observation["mates"] * observation["mask"][:, None]
    parts = [observation["self"], mates.ravel(), observation["mask"], window.ravel(), [float(acting)]]
    return np.clip(np.concatenate(parts), -LIMIT, LIMIT).astype(np.float32)


class RllibTeam(MultiAgentEnv):
    """The team of a PettingZoo environment whose robots share one reward.

    ``agents`` are those who are asked for an action next: with ``posthumous`` everybody until the team ends, else the
    living. Teams of different ``place`` have different episodes though they are given the same seed.
    """

    metadata: dict[str, Any] = {}  # noqa: RUF012  RLlib writes into it, and wants it on the class

    def __init__(self, env: ParallelEnv[str, Observation, Any], *, posthumous: bool = True, place: int = 0) -> None:
        self.env, self.posthumous, self.place = env, posthumous, place
        self.names = list(env.possible_agents)
        self.possible_agents, self.agents = [*self.names], []
        box = spaces.Box(-LIMIT, LIMIT, (FLAT_SIZE,), np.float32)
        self.observation_spaces = dict.fromkeys(self.names, box)
        self.action_spaces = {name: env.action_space(name) for name in self.names}
        self.render_mode = None
        super().__init__()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Flat], dict[str, dict[str, Any]]]:
        """Start an episode; without a seed the next one of the present series."""
        own_seed = None if seed is None else team_key(seed, self.place) % 2**62
        observations, infos = self.env.reset(seed=own_seed, options=options)
        self.agents = list(self.env.agents)
        return self._seen(observations, set()), infos

    def step(
        self, action_dict: Mapping[Any, Any]
    ) -> tuple[dict[str, Flat], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """One decision of the living; the team's end is under ``__all__`` of the flags."""
        acts = {name: action_dict[name] for name in self.env.agents}
        observations, rewards, terminations, truncations, infos = self.env.step(acts)
        gone = {name for name in acts if terminations[name]}
        over = not self.env.agents
        late = over and any(truncations[name] and not terminations[name] for name in acts)
        ends, cuts = {"__all__": over and not late}, {"__all__": late}
        if self.posthumous:
            rewards = dict.fromkeys(self.names, next(iter(rewards.values())))
            self.agents = [] if over else self.agents
        else:
            ends |= dict.fromkeys(gone, True)
            self.agents = list(self.env.agents)
        return self._seen(observations, gone), rewards, ends, cuts, infos

    def _seen(self, observations: dict[str, Observation], gone: set[str]) -> dict[str, Flat]:
        """What everybody who gets an observation sees; silent robots see what the first robot left sees.

        Who is cut off by a timeout is not gone: its last observation tells what its value would have been.
        """
        seen = {name: flattened(one, name not in gone and _at_work(one)) for name, one in observations.items()}
        if not self.posthumous:
            return seen
        shown = [name for name in observations if name not in gone] or list(observations)
        silent = flattened(observations[shown[0]], acting=False)
        return {name: seen[name] if name in shown else silent for name in self.names}

    def close(self) -> None:
        """Close the environment."""
        self.env.close()


def _at_work(observation: Observation) -> bool:
    return self_field(observation, "docked") < 0.5


def make_team(config: Mapping[str, Any]) -> RllibTeam:
    """What RLlib's ``env_config`` describes: ``scenario`` and, if not true, ``posthumous``; ``seed`` of the training.

    RLlib seeds a runner's team with the training's seed + the runner's number + the team's number there, which several
    teams have in common; seed and runner are told apart here.
    """
    from coop_envs import exploration_v0

    scenario: Scenario = config["scenario"]
    env = exploration_v0.parallel_env(scenario, fidelity=scenario.fidelity, num_worlds=config.get("num_worlds"))
    place = team_key(config.get("seed", 0), getattr(config, "worker_index", 0))
    return RllibTeam(env, posthumous=config.get("posthumous", True), place=place)

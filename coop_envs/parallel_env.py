"""`ExplorationParallelEnv`: one team as a PettingZoo parallel environment."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from pettingzoo import ParallelEnv

from coop_envs.actions import ACTION_NAMES, ACTION_SIZE, action_space, checked_action
from coop_envs.batch import TeamBatch
from coop_envs.device import prepare
from coop_envs.errors import ActionError, CoopError, require
from coop_envs.geometry.keyed_random import team_key
from coop_envs.metrics import episode_metrics
from coop_envs.observations import by_agent, describe, observation_arrays, observation_space
from coop_envs.packed_pool import PackedPool
from coop_envs.policy import TeamDescription
from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.recording.scan import Scan
from coop_envs.scenario import Scenario
from coop_envs.scoring import TERMS
from coop_envs.snapshot import team_frame, team_scan, world_picture
from coop_envs.world_pool import default_num_worlds, open_pool, world_index
from coop_envs.worlds.build import SPLITS, Split

Observation = dict[str, NDArray[Any]]

DEVICE = "cpu"  # one team is faster there than on a GPU, and its arrays are the host's


class ExplorationParallelEnv(ParallelEnv[str, Observation, NDArray[np.float32]]):
    """One team exploring, every robot an agent.

    Rewards are the team's, the same for all; ``infos[agent]["reward_terms"]`` holds the terms of which they are the
    sum. An agent terminates when the belief declares it lost, or when all end: at success, or without a camera left.
    Timeouts truncate. Reserves are agents from the start, docked until a loss calls them.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "exploration_v0",
        "render_modes": ["rgb_array"],
        "render_fps": 5,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        scenario: Scenario,
        *,
        render_mode: str | None = None,
        seed: int | None = None,
        num_worlds: int | None = None,
        split: Split = "train",
    ) -> None:
        require(render_mode in (None, "rgb_array"), "render_mode", render_mode, "None or 'rgb_array'")
        require(split in SPLITS, "split", split, "train or heldout")
        require(num_worlds is None or num_worlds > 0, "num_worlds", num_worlds, "1 or more")
        self.scenario, self.render_mode = scenario, render_mode
        prepare(DEVICE)
        self.num_worlds, self.split = num_worlds or default_num_worlds(scenario), split
        self.possible_agents = [member.name for member in scenario.team.members]
        self.agents: list[str] = []
        self._place = {name: i for i, name in enumerate(self.possible_agents)}
        self._seed, self._episode = seed if seed is not None else 0, -1
        self._loaded: tuple[Split, int] | None = None
        self._batch: TeamBatch | None = None
        self._picture: WorldPicture | None = None
        self._past: list[Frame] = []

    @functools.cached_property
    def _spaces(self) -> tuple[spaces.Dict, spaces.Box]:
        return observation_space(), action_space()

    def observation_space(self, agent: str) -> spaces.Dict:  # noqa: ARG002  every agent has the same
        return self._spaces[0]

    def action_space(self, agent: str) -> spaces.Box:  # noqa: ARG002  every agent has the same
        return self._spaces[1]

    @staticmethod
    def describe() -> dict[str, Any]:
        """Name, unit, scale and meaning of every entry of an observation, and the order of actions."""
        return {"observations": describe(), "actions": list(ACTION_NAMES)}

    @property
    def batch(self) -> TeamBatch:
        """The batch of one behind this environment.

        Raises:
            CoopError: before the first reset.
        """
        if self._batch is None:
            raise CoopError("environment: got no reset yet, expected reset() first")
        return self._batch

    @property
    def team_description(self) -> TeamDescription:
        """What a policy may know of the team beforehand."""
        scenario = self.scenario
        return TeamDescription(
            names=tuple(self.possible_agents),
            members=scenario.team.members,
            cell_m=scenario.map.cell_m * scenario.map.ego_stride,
            decision_s=scenario.rates.decision_s,
            goal_known=scenario.task.success == "goal",
            time_limit_s=scenario.task.time_limit_s,
            collects_lost=scenario.task.collect_lost,
        )

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start an episode; its first decision passes at rest.

        ``seed`` starts a new series of episodes, None goes on with the present one. ``options`` may hold
        ``world_index`` and ``split``, to choose the world.
        """
        if seed is not None:
            require(seed >= 0, "seed", seed, "0 or more")
            self._seed, self._episode = int(seed), 0
        else:
            self._episode += 1
        chosen = dict(options or {})
        split = chosen.get("split", self.split)
        index = int(chosen.get("world_index", world_index(self._seed, self._episode, self.num_worlds)))
        if self._loaded != (split, index):
            packed = PackedPool(self.scenario, open_pool(self.scenario, split, [index]), DEVICE)
            self._batch = TeamBatch(self.scenario, packed, 1)
            self._loaded = (split, index)
            self._picture = world_picture(self.batch.pool.worlds[0])
            self._link(self._batch)
        keys = np.array([team_key(self._seed, self._episode)], dtype=np.uint64)
        self.batch.place(np.ones(1, dtype=np.int32), keys, np.zeros(1, dtype=np.int32))
        self._actions[:] = 0.0
        self._actions[:, 0] = 1.0
        self.batch.step()
        self.agents = list(self.possible_agents)
        self._past = [self.frame().without_maps()] if self.render_mode is not None else []
        return self._observe(self.agents), {name: {} for name in self.agents}

    def _link(self, batch: TeamBatch) -> None:
        """Views of the device arrays that every step reads and writes."""
        self._actions = batch.actions.numpy()[0]
        self._views = {key: array[0] for key, array in observation_arrays(batch.observations).items()}
        self._terms, self._reward = batch.score.terms.numpy()[0], batch.score.reward.numpy()
        self._terminated, self._truncated = batch.score.terminated.numpy()[0], batch.score.truncated.numpy()[0]

    def _observe(self, agents: list[str]) -> dict[str, Observation]:
        return by_agent(self._views, {name: self._place[name] for name in agents})

    def step(
        self, actions: Mapping[str, ArrayLike]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Let every live agent act for one decision.

        Raises:
            CoopError: before the first reset.
            ActionError: an agent without action, an unknown agent, a wrong shape or a number that is not finite.
        """
        acting, batch = self.agents, self.batch
        if not acting:
            return {}, {}, {}, {}, {}
        for name in actions:
            if name not in self._place:
                raise ActionError("actions", name, f"agents among {', '.join(acting)}")
        for name in acting:
            if name not in actions:
                raise ActionError(f"action[{name}]", None, f"{ACTION_SIZE} numbers: the agent is alive")
            self._actions[self._place[name]] = checked_action(name, actions[name])
        batch.step()
        observations = self._observe(acting)
        reward = float(self._reward[0])
        terms = dict(zip(TERMS, self._terms.tolist(), strict=True))
        terminated, truncated = self._terminated.tolist(), self._truncated.tolist()
        terminations = {name: bool(terminated[self._place[name]]) for name in acting}
        truncations = {name: bool(truncated[self._place[name]]) for name in acting}
        self.agents = [name for name in acting if not terminations[name] and not truncations[name]]
        if self.render_mode is not None:
            self._past.append(self.frame().without_maps())
        infos: dict[str, dict[str, Any]] = {name: {"reward_terms": terms} for name in acting}
        return observations, dict.fromkeys(acting, reward), terminations, truncations, infos

    def frame(self, volume: bool = False) -> Frame:
        """Truth and belief now, for viewers and logs, with the map of the volume if asked."""
        return team_frame(self.batch, 0, volume)

    def world_picture(self) -> WorldPicture:
        """What is drawn of the present world."""
        assert self.batch and self._picture is not None
        return self._picture

    def scan(self) -> Scan:
        """The points measured in the last decision, for viewers and logs."""
        return team_scan(self.batch, 0)

    def metrics(self, scan: Scan | None = None) -> dict[str, Any]:
        """The episode so far in numbers; see `metrics.episode_metrics`."""
        return episode_metrics(self.batch, 0, scan)

    def render(self) -> NDArray[np.uint8] | None:
        """The top view (height, width, 3), truth and belief together."""
        if self.render_mode is None:
            return None
        from coop_envs.viewer.robots import Trail
        from coop_envs.viewer.topview import draw
        from coop_envs.viewer.window import window_around

        world, frame = self.world_picture(), self.frame()
        return draw(world, frame, Trail.from_frames(self._past), window=window_around(world, frame.true_xy_yaw[0, :2]))

    def get_state(self) -> dict[str, Any]:
        """Everything that an episode's future depends on."""
        return {
            "batch": self.batch.snapshot(),
            "agents": list(self.agents),
            "seed": self._seed,
            "episode": self._episode,
            "world": self._loaded,
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go back to what `get_state` gave.

        Raises:
            ConfigError: the state is of another world or team.
        """
        require(state.get("world") == self._loaded, "state.world", state.get("world"), str(self._loaded))
        self.batch.restore(state["batch"])
        self.agents = list(state["agents"])
        self._seed, self._episode = state["seed"], state["episode"]

    def close(self) -> None:
        """Let go of the device arrays."""
        self._batch, self._loaded = None, None

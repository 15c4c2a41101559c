"""`ExplorationVectorEnv`: B teams in step, with next-step autoreset."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import warp as wp
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from coop_envs.actions import ACTION_SIZE, checked_action
from coop_envs.batch import TeamBatch
from coop_envs.device import prepare
from coop_envs.errors import require
from coop_envs.geometry.keyed_random import team_key
from coop_envs.observations import MAP_LAYERS, MATE_SIZE, MATES, SELF_SIZE, WINDOW, observation_arrays
from coop_envs.recording.frame import WorldPicture
from coop_envs.scenario import Scenario
from coop_envs.scoring import TERMS
from coop_envs.world_pool import default_num_worlds, open_pool, world_index
from coop_envs.worlds.build import SPLITS, Split

TeamObservations = dict[str, NDArray[Any]]


def team_observation_space(robots: int) -> spaces.Dict:
    """Observations of all robots of one team: as one agent's, with a leading axis, and who is alive."""
    far = np.finfo(np.float32).max
    return spaces.Dict(
        {
            "self": spaces.Box(-far, far, (robots, SELF_SIZE), np.float32),
            "mates": spaces.Box(-far, far, (robots, MATES, MATE_SIZE), np.float32),
            "mask": spaces.Box(0, 1, (robots, MATES), np.int8),
            "map": spaces.Box(0, 255, (robots, len(MAP_LAYERS), WINDOW, WINDOW), np.uint8),
            "alive": spaces.Box(0, 1, (robots,), np.int8),
        }
    )


class ExplorationVectorEnv(VectorEnv[TeamObservations, NDArray[np.float32], NDArray[Any]]):
    """B teams of N robots; team b's episodes are those of a single environment with seed + b.

    `step` takes actions (B, N, 8) and gives observations, reward (B,), terminated and truncated (B, N). A team of which
    nobody is left is set down anew by the next step, whatever its actions; that step gives it reward 0. The entries of
    robots that are not alive are ignored. ``max_robots`` fills N up with robots that are never alive, so that one
    policy can be trained on teams of several sizes.
    """

    metadata: ClassVar[dict[str, Any]] = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}

    def __init__(
        self,
        scenario: Scenario,
        num_envs: int = 1024,
        *,
        device: str = "cpu",
        num_worlds: int | None = None,
        max_robots: int | None = None,
        split: Split = "train",
        seed: int = 0,
    ) -> None:
        require(num_envs >= 1, "num_envs", num_envs, "1 or more")
        require(num_worlds is None or num_worlds > 0, "num_worlds", num_worlds, "1 or more")
        require(split in SPLITS, "split", split, "train or heldout")
        self.scenario, self.num_envs = scenario, num_envs
        self.num_worlds = num_worlds or default_num_worlds(scenario)
        members = len(scenario.team.members)
        robots = max_robots or members
        require(robots >= members, "max_robots", max_robots, f"at least the team's {members}")
        self._members, self._fill = members, robots - members
        self.single_observation_space = team_observation_space(robots)
        self.single_action_space = spaces.Box(-1.0, 1.0, (robots, ACTION_SIZE), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.batch = TeamBatch(scenario, open_pool(scenario, split, range(self.num_worlds)), num_envs, prepare(device))
        self._seeds = seed + np.arange(num_envs, dtype=np.int64)
        self._episodes = np.full(num_envs, -1, dtype=np.int64)
        self._to_reset = np.ones(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | None = None,
        mask: ArrayLike | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002  Gymnasium's signature
    ) -> tuple[TeamObservations, dict[str, Any]]:
        """Set down anew the teams where ``mask`` (B,) is true, or all; the others wait.

        ``seed`` gives team b the seed ``seed + b``; None goes on to the next episode of the present seeds.
        """
        chosen = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        require(chosen.shape == (self.num_envs,), "mask", chosen.shape, f"shape ({self.num_envs},)")
        if seed is not None:
            require(seed >= 0, "seed", seed, "0 or more")
            self._seeds[chosen] = seed + np.flatnonzero(chosen)
            self._episodes[chosen] = -1
        self._place(chosen)
        self.batch.running.assign(chosen.astype(np.int32))
        self.batch.actions.assign(self._hold_where(chosen, np.zeros(self.batch.actions.shape, dtype=np.float32)))
        self.batch.step()
        self.batch.running.fill_(1)
        self._to_reset[chosen] = False
        return self._observe(), {}

    def _place(self, chosen: NDArray[np.bool_]) -> None:
        self._episodes[chosen] += 1
        pairs = list(zip(self._seeds.tolist(), self._episodes.tolist(), strict=True))
        keys = np.array([team_key(*pair) for pair in pairs], dtype=np.uint64)
        worlds = np.array([world_index(*pair, self.num_worlds) for pair in pairs], dtype=np.int32)
        self.batch.place(chosen.astype(np.int32), keys, worlds)

    @staticmethod
    def _hold_where(chosen: NDArray[np.bool_], actions: NDArray[np.float32]) -> NDArray[np.float32]:
        actions = actions.copy()
        actions[chosen] = 0.0
        actions[chosen, :, 0] = 1.0
        return actions

    def step(
        self, actions: ArrayLike
    ) -> tuple[TeamObservations, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Let every robot act for one decision; actions (B, N, 8).

        ``info`` holds ``reward_terms`` (B, 6), ``started`` (B,) where a team was set down anew, and, where some team
        has just ended, ``final_obs`` and ``_final_obs`` (B,).

        Raises:
            ActionError: a wrong shape or a number that is not finite.
        """
        actions = checked_action("all", actions, self.action_space.shape or ())
        started = self._to_reset.copy()
        if started.any():
            self._place(started)
            actions = self._hold_where(started, actions)
        self.batch.actions.assign(actions[:, : self._members])
        self.batch.step()
        score = self.batch.score
        reward, terms = score.reward.numpy().copy(), score.terms.numpy().copy()
        reward[started], terms[started] = 0.0, 0.0
        ended = score.done.numpy() == 1
        self._to_reset = ended.copy()
        observations = self._observe()
        info: dict[str, Any] = {"reward_terms": terms, "started": started}
        if ended.any():
            info["final_obs"], info["_final_obs"] = observations, ended.copy()
        terminated, truncated = (self._filled(ends.numpy() == 1) for ends in (score.terminated, score.truncated))
        return observations, reward, terminated, truncated, info

    def _filled(self, array: NDArray[Any]) -> NDArray[Any]:
        """A copy with its axis of robots filled up with zeros."""
        if self._fill == 0:
            return array.copy()
        return np.pad(array, [(0, 0), (0, self._fill)] + [(0, 0)] * (array.ndim - 2))

    @property
    def reward_terms(self) -> tuple[str, ...]:
        """Names of the columns of ``info["reward_terms"]``."""
        return TERMS

    def _observe(self) -> TeamObservations:
        arrays = observation_arrays(self.batch.observations)
        arrays |= {"alive": self.batch.score.alive.numpy().astype(np.int8)}
        return {name: self._filled(array) for name, array in arrays.items()}

    def torch(self) -> dict[str, Any]:
        """The device arrays of actions, observations, rewards and ends as torch tensors that share their memory.

        They hold the team's own robots, without those that ``max_robots`` adds.
        """
        out, score = self.batch.observations, self.batch.score
        b, n = score.alive.shape
        arrays = {"actions": self.batch.actions, "self": out.own, "mates": out.mates, "mask": out.mask}
        arrays |= {"reward": score.reward, "terminated": score.terminated, "truncated": score.truncated}
        arrays |= {"alive": score.alive, "reward_terms": score.terms}
        tensors = {name: wp.to_torch(array) for name, array in arrays.items()}
        tensors["map"] = wp.to_torch(out.map).view(b, n, len(MAP_LAYERS), WINDOW, WINDOW)
        return tensors

    def get_state(self) -> dict[str, Any]:
        """Everything that the teams' future depends on."""
        return {
            "batch": self.batch.snapshot(),
            "seeds": self._seeds.copy(),
            "episodes": self._episodes.copy(),
            "to_reset": self._to_reset.copy(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Go back to what `get_state` gave.

        Raises:
            ConfigError: the state is of another batch.
        """
        self.batch.restore(state["batch"])
        self._seeds, self._episodes = state["seeds"].copy(), state["episodes"].copy()
        self._to_reset = state["to_reset"].copy()

    def close_extras(self, **kwargs: Any) -> None:
        """Nothing but arrays is held."""


class ExplorationTeamEnv(gym.Env[TeamObservations, NDArray[np.float32]]):
    """One team under one controller: actions (N, 8) for all robots, one observation, one reward.

    An episode terminates when the task is done or nobody is left to go on, and truncates at the time limit.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 5}

    def __init__(self, scenario: Scenario, *, render_mode: str | None = None, **settings: Any) -> None:
        require(render_mode in (None, "rgb_array"), "render_mode", render_mode, "None or 'rgb_array'")
        self.scenario, self.render_mode, self._settings = scenario, render_mode, settings
        robots = len(scenario.team.members)
        self.observation_space = team_observation_space(robots)
        self.action_space = spaces.Box(-1.0, 1.0, (robots, ACTION_SIZE), np.float32)
        self._teams = ExplorationVectorEnv(scenario, 1, **settings)
        self._pictures: dict[int, WorldPicture] = {}

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002  Gymnasium's signature
    ) -> tuple[TeamObservations, dict[str, Any]]:
        """Start an episode; see `ExplorationVectorEnv.reset`."""
        super().reset(seed=seed)
        observations, _ = self._teams.reset(seed=seed)
        return {name: value[0] for name, value in observations.items()}, {}

    def step(self, action: ArrayLike) -> tuple[TeamObservations, float, bool, bool, dict[str, Any]]:
        """Let all robots act for one decision; actions of robots that are not alive are ignored."""
        actions = checked_action("team", action, self.action_space.shape or ())
        observations, reward, _, truncated, info = self._teams.step(actions[None])
        over, late = bool(self._teams.batch.score.done.numpy()[0]), bool(truncated[0].any())
        terms = dict(zip(TERMS, info["reward_terms"][0].tolist(), strict=True))
        now = {name: value[0] for name, value in observations.items()}
        return now, float(reward[0]), over and not late, over and late, {"reward_terms": terms}

    def render(self) -> NDArray[np.uint8] | None:
        """The top view (height, width, 3)."""
        if self.render_mode is None:
            return None
        from coop_envs.snapshot import team_frame
        from coop_envs.viewer.topview import draw
        from coop_envs.viewer.window import window_around

        world, frame = self._world_picture(), team_frame(self._teams.batch, 0)
        return draw(world, frame, window=window_around(world, frame.true_xy_yaw[0, :2]))

    def _world_picture(self) -> WorldPicture:
        """The present world's picture, made once: the viewer keeps its backdrop as long as the object lives."""
        from coop_envs.snapshot import world_picture

        w = int(self._teams.batch.state.world.numpy()[0])
        if w not in self._pictures:
            self._pictures[w] = world_picture(self._teams.batch.pool.worlds[w])
        return self._pictures[w]

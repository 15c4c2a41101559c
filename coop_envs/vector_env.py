"""`ExplorationVectorEnv`: B teams in step, with next-step autoreset."""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import warp as wp
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from coop_envs.actions import ACTION_SIZE, checked_action
from coop_envs.batch import TeamBatch, allocate_exchange
from coop_envs.device import available_cpus, prepare
from coop_envs.errors import CoopError, require
from coop_envs.lane import Lane, joined, rows_of
from coop_envs.observations import MAP_LAYERS, MATE_SIZE, MATES, SELF_SIZE, WINDOW, observation_arrays
from coop_envs.packed_pool import PackedPool
from coop_envs.recording.frame import WorldPicture
from coop_envs.scenario import Scenario
from coop_envs.scoring import TERMS
from coop_envs.world_pool import default_num_worlds, open_pool
from coop_envs.worlds.build import SPLITS, Split

TeamObservations = dict[str, NDArray[Any]]

PER_ROBOT = frozenset({"self", "mates", "mask", "map", "alive", "terminated", "truncated"})
SEEDS = 2**62
FEWEST = 8
"""Teams that are worth a thread."""
LANE = 128
"""Teams of a lane: what they hold stays in the processor's cache from one kernel to the next."""


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
    policy can be trained on teams of several sizes. On the CPU the teams are shared out among ``threads``, one for
    each CPU unless told otherwise; results do not depend on it.
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
        threads: int | None = None,
    ) -> None:
        self._threads: ThreadPoolExecutor | None = None
        require(num_envs >= 1, "num_envs", num_envs, "1 or more")
        require(num_worlds is None or num_worlds > 0, "num_worlds", num_worlds, "1 or more")
        require(split in SPLITS, "split", split, "train or heldout")
        require(0 <= seed < SEEDS, "seed", seed, f"0 up to {SEEDS}")
        require(threads is None or threads >= 1, "threads", threads, "1 or more")
        self.scenario, self.num_envs, self._split = scenario, num_envs, split
        self.num_worlds = num_worlds or default_num_worlds(scenario)
        self._members = len(scenario.team.members)
        self._robots = max_robots or self._members
        require(self._robots >= self._members, "max_robots", max_robots, f"at least the team's {self._members}")
        self.single_observation_space = team_observation_space(self._robots)
        self._boxes: dict[str, Any] = self.single_observation_space.spaces
        self.single_action_space = spaces.Box(-1.0, 1.0, (self._robots, ACTION_SIZE), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        packed = PackedPool(scenario, open_pool(scenario, split, range(self.num_worlds)), prepare(device))
        self._exchange = allocate_exchange(scenario, packed.pool, num_envs, packed.device)
        on_cpu = packed.device == "cpu"
        shares = _shares(num_envs, threads or available_cpus()) if on_cpu else [[slice(0, num_envs)]]
        self._shares = [[Lane(scenario, packed, rows, self._exchange.part(rows)) for rows in share] for share in shares]
        self._threads = ThreadPoolExecutor(len(self._shares))
        self._views = self._outcome() if packed.device == "cpu" else None
        self._begin_series(np.ones(num_envs, dtype=bool), seed)

    @property
    def lanes(self) -> list[Lane]:
        """All lanes, in the order of their teams."""
        return [lane for share in self._shares for lane in share]

    @property
    def batch(self) -> TeamBatch:
        """The batch behind an environment with a single lane.

        Raises:
            CoopError: there are several.
        """
        if len(self.lanes) > 1:
            raise CoopError(f"batch: got {len(self.lanes)} lanes, expected one; locate(team) finds a team's batch")
        return self.lanes[0].batch

    def locate(self, team: int) -> tuple[TeamBatch, int]:
        """The batch that holds a team, and its place there."""
        lane = next(lane for lane in self.lanes if lane.rows.start <= team < lane.rows.stop)
        return lane.batch, team - lane.rows.start

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
            require(0 <= seed < SEEDS, "seed", seed, f"0 up to {SEEDS}")
            self._begin_series(chosen, seed)
        self._each_lane(lambda lane: lane.reset(chosen[lane.rows]))
        views, out = self._read(), self._room_for_outcome()
        self._copy(views, slice(None), out)
        return self._observations(out), {}

    def step(
        self, actions: ArrayLike
    ) -> tuple[TeamObservations, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Let every robot act for one decision; actions (B, N, 8).

        ``info`` holds ``reward_terms`` (B, 6), ``started`` (B,) where a team was set down anew, and, where some team
        has just ended, ``final_obs`` and ``_final_obs`` (B,).

        Raises:
            ActionError: a wrong shape or a number that is not finite.
        """
        asked = checked_action("all", actions, self.action_space.shape or ())[:, : self._members]
        started = self._exchange.score.done.numpy() == 1
        out = self._room_for_outcome()
        if self._views is None:
            self._exchange.actions.assign(asked)
            self.advance()
            self._copy(self._outcome(), slice(None), out)
        else:
            self._each_lane(lambda lane: self._play(lane, asked, out))
        observations = self._observations(out)
        info: dict[str, Any] = {"reward_terms": out["reward_terms"], "started": started}
        if out["done"].any():
            info["final_obs"], info["_final_obs"] = observations, out["done"]
        return observations, out["reward"], out["terminated"], out["truncated"], info

    def advance(self) -> None:
        """One decision by the device arrays alone (see `torch`): nothing is copied to or from the host."""
        self._each_lane(Lane.step)

    def _play(self, lane: Lane, actions: NDArray[np.float32], out: dict[str, NDArray[Any]]) -> None:
        """One decision of a lane on the CPU, from its rows of ``actions`` to its rows of ``out``."""
        assert self._views is not None
        self._views["actions"][lane.rows] = actions[lane.rows]
        lane.step()
        self._copy(self._views, lane.rows, out)

    def _each_lane(self, work: Callable[[Lane], None]) -> None:
        """Do this for all lanes, those of a thread one after the other; the first share in this thread."""
        assert self._threads is not None

        def through(share: list[Lane]) -> None:
            for lane in share:
                work(lane)

        others = [self._threads.submit(through, share) for share in self._shares[1:]]
        try:
            through(self._shares[0])
        finally:
            wait(others)
        for other in others:
            other.result()

    def _begin_series(self, chosen: NDArray[np.bool_], seed: int) -> None:
        seeds = np.uint64(seed) + np.arange(self.num_envs, dtype=np.uint64)
        for lane in self.lanes:
            lane.begin_series(chosen[lane.rows], seeds[lane.rows])

    def _outcome(self) -> dict[str, NDArray[Any]]:
        """All that is exchanged, by name; on the CPU views that stay valid, else copies."""
        score = self._exchange.score
        arrays = {"alive": score.alive, "reward": score.reward, "reward_terms": score.terms, "done": score.done}
        arrays |= {"terminated": score.terminated, "truncated": score.truncated, "actions": self._exchange.actions}
        return observation_arrays(self._exchange.observations) | {name: a.numpy() for name, a in arrays.items()}

    def _read(self) -> dict[str, NDArray[Any]]:
        return self._outcome() if self._views is None else self._views

    def _room_for_outcome(self) -> dict[str, NDArray[Any]]:
        """Zeros for all that a step gives, N robots wide."""
        lead = self.num_envs, self._robots
        room = {name: np.zeros((self.num_envs, *box.shape), box.dtype) for name, box in self._boxes.items()}
        room |= {name: np.zeros(lead, dtype=bool) for name in ("terminated", "truncated")}
        room |= {"reward": np.zeros(self.num_envs, np.float32), "done": np.zeros(self.num_envs, dtype=bool)}
        return room | {"reward_terms": np.zeros((self.num_envs, len(TERMS)), np.float32)}

    def _copy(self, views: dict[str, NDArray[Any]], rows: slice, out: dict[str, NDArray[Any]]) -> None:
        for name, target in out.items():
            robots = slice(self._members) if name in PER_ROBOT else slice(None)
            target[(rows, robots)[: target.ndim]][...] = views[name][rows]

    def _observations(self, out: dict[str, NDArray[Any]]) -> TeamObservations:
        return {name: out[name] for name in self._boxes}

    @property
    def reward_terms(self) -> tuple[str, ...]:
        """Names of the columns of ``info["reward_terms"]``."""
        return TERMS

    def torch(self) -> dict[str, Any]:
        """The device arrays of actions, observations, rewards and ends as torch tensors that share their memory.

        They hold the team's own robots, without those that ``max_robots`` adds. Write ``actions``, then `advance`.
        """
        out, score = self._exchange.observations, self._exchange.score
        b, n = score.alive.shape
        arrays = {"actions": self._exchange.actions, "self": out.own, "mates": out.mates, "mask": out.mask}
        arrays |= {"reward": score.reward, "terminated": score.terminated, "truncated": score.truncated}
        arrays |= {"alive": score.alive, "reward_terms": score.terms, "done": score.done}
        tensors = {name: wp.to_torch(array) for name, array in arrays.items()}
        tensors["map"] = wp.to_torch(out.map).view(b, n, len(MAP_LAYERS), WINDOW, WINDOW)
        return tensors

    def get_state(self) -> dict[str, Any]:
        """Everything that the teams' future depends on, by part and name, arrays over B teams."""
        return joined([lane.snapshot() for lane in self.lanes]) | {"origin": self._origin()}

    def set_state(self, state: Mapping[str, Mapping[str, NDArray[Any]]]) -> None:
        """Go back to what `get_state` gave, here or with another number of threads.

        Raises:
            ConfigError: the state is of another scenario, of other worlds, or of another number of teams.
        """
        mine = self._origin()["fingerprint"]
        same = np.array_equal(state.get("origin", {}).get("fingerprint", ()), mine)
        expected = f"one of {self.num_envs} teams of the same scenario, split and worlds"
        require(same, "state", "one of another environment", expected)
        for lane in self.lanes:
            lane.restore(rows_of(state, lane.rows))

    def _origin(self) -> dict[str, NDArray[Any]]:
        """What a state must have in common with this environment, as a number for each team."""
        text = repr((self.scenario, self._split, self.num_worlds))
        return {"fingerprint": np.full(self.num_envs, zlib.crc32(text.encode()), dtype=np.uint32)}

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002  Gymnasium's signature
        """End the threads."""
        if self._threads is not None:
            self._threads.shutdown()


def _shares(teams: int, threads: int) -> list[list[slice]]:
    """Teams for each thread, none with fewer than `FEWEST`, in lanes of about `LANE`."""
    used = max(1, min(threads, teams // FEWEST))
    return [_parts(share, max(1, round((share.stop - share.start) / LANE))) for share in _parts(slice(0, teams), used)]


def _parts(rows: slice, parts: int) -> list[slice]:
    """Nearly equal runs."""
    borders = [rows.start + (rows.stop - rows.start) * k // parts for k in range(parts + 1)]
    return [slice(low, high) for low, high in itertools.pairwise(borders)]


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

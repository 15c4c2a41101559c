"""`TeamVecEnv`: teams in step as Stable-Baselines3's `VecEnv`, one row a robot, with endings that training can trust.

Row ``b * N + r`` is robot r of team b. A team has one reward, which every robot that is left gets. A lost robot's row
ends there, but its return goes on with the team's value (``TimeLimit.truncated``, and as ``terminal_observation`` what
a mate sees): losing it costs what the reward says and nothing else, so that sacrifice can pay. Then the row idles,
``alive`` 0, until its team is set down anew. Success ends without a bootstrap, the time limit with one.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from coop_envs.actions import ACTION_SIZE
from coop_envs.errors import require
from coop_envs.observations import SELF_FIELDS
from train.training_error import TrainingError

DOCKED = next(k for k, field in enumerate(SELF_FIELDS) if field.name == "docked")
Arrays = dict[str, NDArray[Any]]


class Teams(Protocol):
    """What is trained in: `ExplorationVectorEnv`, or a small game in its place."""

    num_envs: int
    single_observation_space: Any
    single_action_space: Any

    @property
    def reward_terms(self) -> tuple[str, ...]: ...

    def reset(self, *, seed: int | None = None, mask: Any = None) -> tuple[Arrays, dict[str, Any]]: ...

    def step(self, actions: Any) -> tuple[Arrays, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]: ...

    def get_state(self) -> dict[str, Any]: ...

    def set_state(self, state: dict[str, Any]) -> None: ...


class TeamVecEnv(VecEnv):
    """B teams of N robots as B x N rows.

    Args:
        teams: the teams.
        action_masks: (N, 8) 1 for the entries of the action that each robot uses.
        repeat: decisions of the teams for which an action is held; rewards add up, an end stops them.
        reward_scale: factor on the rewards that rows get; the figures of episodes are without it.
        spread: the first episodes are cut off (as by the time limit) evenly over so many steps, so that teams that
            start together do not go through their episodes, and to the time limit, in step. 0 cuts none.
    """

    def __init__(
        self,
        teams: Teams,
        action_masks: NDArray[Any],
        *,
        repeat: int = 1,
        reward_scale: float = 1.0,
        spread: int = 0,
    ) -> None:
        require(repeat >= 1, "repeat", repeat, "1 or more decisions")
        self.teams, self.repeat, self.reward_scale = teams, repeat, reward_scale
        b, n = teams.num_envs, teams.single_action_space.shape[0]
        self.shape = b, n
        own = teams.single_observation_space.spaces
        boxes: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(box.low[0], box.high[0], box.shape[1:], box.dtype)
            for name, box in own.items()
            if name != "alive"
        }
        boxes["alive"] = spaces.Box(0.0, 1.0, (1,), np.float32)
        boxes["action_mask"] = spaces.Box(0.0, 1.0, (ACTION_SIZE,), np.float32)
        super().__init__(b * n, spaces.Dict(boxes), spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32))
        self._masks = np.tile(np.asarray(action_masks, dtype=np.float32), (b, 1))
        self._alive = np.zeros((b, n), dtype=bool)
        self._return, self._length = np.zeros(b), np.zeros(b, dtype=np.int64)
        self._terms, self._lost = np.zeros((b, len(teams.reward_terms))), np.zeros(b, dtype=np.int64)
        self._cut_at = (1 + np.arange(b, dtype=np.int64)) * spread // b
        self._started_at = time.monotonic()
        self._actions = np.zeros((b, n, ACTION_SIZE), dtype=np.float32)
        self.decisions = 0
        self.term_sums = np.zeros(len(teams.reward_terms))

    def reset(self) -> Any:
        """Set all teams down anew."""
        observations, _ = self.teams.reset()
        self._begin(np.ones(self.shape[0], dtype=bool), observations)
        self._reset_seeds()
        self._reset_options()
        return self._rows(observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions (rows, 8) for `step_wait`."""
        self._actions = np.asarray(actions, dtype=np.float32).reshape(*self.shape, ACTION_SIZE)

    def step_wait(self) -> Any:
        """One step of every team: ``repeat`` decisions with the same action.

        Raises:
            TrainingError: a reward is not finite.
        """
        working = self._alive
        reward, ended, late, over, now, final = self._play()
        self._length += 1
        cut = ~over & (self._length >= self._cut_at) & (self._cut_at > 0)
        if cut.any():
            late |= cut[:, None] & self._alive
            over |= cut
            final = _taken(final, now, cut)
        done = working & (ended | late)
        infos = self._infos(done, late, over, now, final)
        if over.any():
            self._tell(infos, over & ~cut)
            self._cut_at[over] = 0
            now, _ = self.teams.reset(mask=over)
            self._begin(over, now)
        rewards = (self.reward_scale * reward[:, None] * working).astype(np.float32)
        return self._rows(now), rewards.ravel(), done.ravel(), infos

    def _play(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any], Arrays, Arrays]:
        """Carry the actions out, each team to its end at most.

        Reward (B,); robots terminated and truncated (B, N); teams of which nobody is left (B,); observations now, and
        those at their end of teams that are over.
        """
        b, n = self.shape
        reward, over = np.zeros(b), np.zeros(b, dtype=bool)
        ended, late = np.zeros((b, n), dtype=bool), np.zeros((b, n), dtype=bool)
        now: Arrays = {}
        final: Arrays = {}
        for _ in range(self.repeat):
            now, gained, terminated, truncated, info = self.teams.step(self._actions)
            self._check(gained)
            going = ~over
            reward += np.where(going, gained, 0.0)
            self._terms[going] += info["reward_terms"][going]
            self.term_sums += info["reward_terms"][going].sum(axis=0)
            self.decisions += int(going.sum())
            ended |= terminated & going[:, None]
            late |= truncated & going[:, None]
            self._alive = np.where(going[:, None], now["alive"] != 0, self._alive)
            others = self._alive.any(axis=1) | truncated.any(axis=1)
            self._lost += (terminated & (going & others)[:, None]).sum(axis=1)
            ends = going & ~self._alive.any(axis=1)
            if ends.any():
                over |= ends
                final = _taken(final, now, ends)
            if over.all():
                break
        self._return += reward
        return reward, ended, late, over, now, final

    def _check(self, reward: NDArray[Any]) -> None:
        if not np.isfinite(reward).all():
            b = int(np.flatnonzero(~np.isfinite(reward))[0])
            raise TrainingError(f"reward of team {b}: got {reward[b]} in step {self._length[b]} of its episode")

    def _infos(
        self, done: NDArray[Any], late: NDArray[Any], over: NDArray[Any], now: Arrays, final: Arrays
    ) -> list[dict[str, Any]]:
        """For every row that is done, what it saw last, or what a mate sees that goes on in its place."""
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for b, r in np.argwhere(done).tolist():
            arrays = final if over[b] else now
            at_work = arrays["self"][b, :, DOCKED] == 0.0
            heirs = late[b] if over[b] else self._alive[b]
            bootstraps = bool(heirs.any())
            seen_by = r if late[b, r] or not bootstraps else _first(heirs & at_work, heirs)
            infos[b * self.shape[1] + r] = {
                "TimeLimit.truncated": bootstraps,
                "terminal_observation": self._row(arrays, b, seen_by),
            }
        return infos

    def _tell(self, infos: list[dict[str, Any]], over: NDArray[Any]) -> None:
        """Put the figures of the episodes that are over into the infos of their teams' first rows.

        ``robots_lost`` counts robots that terminated while mates went on, or were stopped by the time limit. Where all
        that are left terminate in one decision, their flags do not tell success from loss: they are not counted.
        """
        names, elapsed = self.teams.reward_terms, time.monotonic() - self._started_at
        for b in np.flatnonzero(over).tolist():
            figures = {"r": float(self._return[b]), "l": int(self._length[b]), "t": elapsed}
            terms = dict(zip(names, self._terms[b].tolist(), strict=True))
            infos[b * self.shape[1]]["episode"] = figures | {"terms": terms, "robots_lost": int(self._lost[b])}

    def _begin(self, chosen: NDArray[Any], observations: Arrays) -> None:
        self._alive = np.where(chosen[:, None], observations["alive"] != 0, self._alive)
        for account in (self._return, self._length, self._terms, self._lost):
            account[chosen] = 0

    def _rows(self, arrays: Arrays) -> Arrays:
        rows = {name: array.reshape(self.num_envs, *array.shape[2:]) for name, array in arrays.items()}
        rows["alive"] = self._alive.astype(np.float32).reshape(-1, 1)
        return rows | {"action_mask": self._masks}

    def _row(self, arrays: Arrays, b: int, r: int) -> Arrays:
        row = {name: array[b, r] for name, array in arrays.items() if name != "alive"}
        return row | {"alive": np.ones(1, dtype=np.float32), "action_mask": self._masks[r]}

    def get_state(self) -> dict[str, Any]:
        """Everything that the rows' future depends on."""
        names = ("_alive", "_return", "_length", "_terms", "_lost", "_cut_at", "term_sums")
        own = {name.strip("_"): getattr(self, name).copy() for name in names}
        return {"teams": self.teams.get_state(), **own, "decisions": self.decisions}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Go back to what `get_state` gave."""
        self.teams.set_state(state["teams"])
        for name in ("_alive", "_return", "_length", "_terms", "_lost", "_cut_at", "term_sums"):
            setattr(self, name, state[name.strip("_")].copy())
        self.decisions = int(state["decisions"])

    def close(self) -> None:
        """Let go of the teams."""
        close = getattr(self.teams, "close", None)
        if close is not None:
            close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the teams, once for each of the rows asked for; ``render_mode`` is None."""
        value = None if attr_name == "render_mode" else getattr(self.teams, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ARG002
        """Refused: rows have no attributes of their own."""
        raise AttributeError(attr_name)

    def env_method(self, method_name: str, *_args: Any, indices: Any = None, **_kwargs: Any) -> list[Any]:  # noqa: ARG002
        """Refused: rows have no methods of their own."""
        raise AttributeError(method_name)

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:  # noqa: ARG002
        """Rows are never wrapped."""
        return [False for _ in self._get_indices(indices)]


def _taken(final: Arrays, now: Arrays, chosen: NDArray[Any]) -> Arrays:
    """``final`` with the observations of the chosen teams taken from ``now``."""
    if not final:
        return {name: array.copy() for name, array in now.items()}
    for name, array in now.items():
        final[name][chosen] = array[chosen]
    return final


def _first(preferred: NDArray[Any], otherwise: NDArray[Any]) -> int:
    """Place of the first true entry, of the second array if the first has none."""
    return int(np.argmax(preferred if preferred.any() else otherwise))

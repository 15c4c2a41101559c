"""A game of two steps that only a team wins whose picket gives itself up.

In step 1 the picket may drive: then it is lost, which costs 1, and the way is known. In step 2 the observer may drive:
if the way is known, the team earns 5. Both then end. What the observer does first, and the picket second, is of no
account. The best return is 4; a picket whose own ending counts for nothing beyond it learns to hold, for 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.observations import MATE_FIELDS, MATE_SIZE, MATES, SELF_FIELDS, SELF_SIZE
from coop_envs.vector_env import team_observation_space

LOSS, PRIZE, BEST = -1.0, 5.0, 4.0
OBSERVER, PICKET = 0, 1
MEMBERS = ("observer_0", "picket_0")
TERMS = ("information", "picket_lost")
TIME_LEFT = [field.name for field in SELF_FIELDS].index("time_left")
LOST = [field.name for field in MATE_FIELDS].index("lost")


def play(step: int, known: bool, observer_drives: bool, picket_drives: bool) -> tuple[float, bool, bool]:
    """One step, 1 or 2, with or without the way known: reward, whether the picket is lost, whether the game is over."""
    if step == 1:
        return (LOSS, True, False) if picket_drives else (0.0, False, False)
    return PRIZE * (known and observer_drives), False, True


def observe(step: int, known: bool) -> dict[str, NDArray[Any]]:
    """What observer and picket (2, ...) see before a step (3: after the game): the time, and whether one is lost."""
    own = np.zeros((2, SELF_SIZE), dtype=np.float32)
    own[OBSERVER, 0] = own[PICKET, 1] = 1.0
    own[:, TIME_LEFT] = (3 - step) / 2
    mates = np.zeros((2, MATES, MATE_SIZE), dtype=np.float32)
    mates[OBSERVER, 0, LOST] = float(known)
    mask = np.zeros((2, MATES), dtype=np.int8)
    mask[:, 0] = 1
    alive = np.array([step < 3, step < 3 and not known], dtype=np.int8)
    return {"self": own, "mates": mates, "mask": mask, "map": np.zeros((2, 3, 16, 16), dtype=np.uint8), "alive": alive}


class SacrificeGame:
    """B games in step, in the shape of `ExplorationVectorEnv`."""

    reward_terms = TERMS

    def __init__(self, num_envs: int) -> None:
        self.num_envs = num_envs
        self.single_observation_space = team_observation_space(2)
        self.single_action_space = np.zeros((2, 8))
        self._step, self._known = np.ones(num_envs, dtype=np.int64), np.zeros(num_envs, dtype=bool)

    def reset(self, *, seed: int | None = None, mask: Any = None) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        chosen = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        self._step[chosen], self._known[chosen] = 1, False
        return self._observe(), {}

    def step(self, actions: Any) -> tuple[Any, ...]:
        drives = np.asarray(actions)[:, :, 0] <= 0
        terms = np.zeros((self.num_envs, 2))
        terminated, truncated = np.zeros((self.num_envs, 2), dtype=bool), np.zeros((self.num_envs, 2), dtype=bool)
        started = self._step == 3
        for b in range(self.num_envs):
            if started[b]:
                self._step[b], self._known[b] = 1, False
                continue
            reward, lost, over = play(int(self._step[b]), bool(self._known[b]), *drives[b].tolist())
            terms[b, int(lost)] = reward
            terminated[b] = [over, lost or (over and not self._known[b])]
            self._known[b] |= lost
            self._step[b] += 1
        return self._observe(), terms.sum(axis=1), terminated, truncated, {"reward_terms": terms, "started": started}

    def _observe(self) -> dict[str, NDArray[Any]]:
        pairs = zip(self._step.tolist(), self._known.tolist(), strict=True)
        rows = [observe(step, known) for step, known in pairs]
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]}

    def get_state(self) -> dict[str, Any]:
        return {"step": self._step.copy(), "known": self._known.copy()}

    def set_state(self, state: dict[str, Any]) -> None:
        self._step, self._known = state["step"].copy(), state["known"].copy()

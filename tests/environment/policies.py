"""Actions to drive environments with in tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coop_envs.actions import ACTION_SIZE


def random_actions(rng: np.random.Generator, robots: int) -> NDArray[np.float32]:
    """Lively actions (robots, 8): mostly moving, sometimes holding, hats mostly bright."""
    actions = rng.uniform(-1.0, 1.0, (robots, ACTION_SIZE)).astype(np.float32)
    actions[:, 0] = np.where(rng.random(robots) < 0.2, 1.0, -1.0)
    actions[:, 7] = np.where(rng.random(robots) < 0.8, 1.0, actions[:, 7])
    return actions


def hold_all(robots: int) -> NDArray[np.float32]:
    """Everybody stands, hats at half."""
    actions = np.zeros((robots, ACTION_SIZE), dtype=np.float32)
    actions[:, 0] = 1.0
    return actions

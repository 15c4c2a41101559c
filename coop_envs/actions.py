"""The action space that every agent shares, and the check of what a policy sends."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from coop_envs.agents.control import ACTION_NAMES
from coop_envs.errors import ActionError

__all__ = ["ACTION_NAMES", "ACTION_SIZE", "action_space", "checked_action", "hold_action"]

ACTION_SIZE = len(ACTION_NAMES)


def action_space() -> spaces.Box:
    """Eight numbers in [-1, 1], in the order of `ACTION_NAMES`."""
    return spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)


def hold_action(brightness: float = 0.0) -> NDArray[np.float32]:
    """Stand still with the hat at ``brightness`` (-1 off, 1 full)."""
    action = np.zeros(ACTION_SIZE, dtype=np.float32)
    action[0], action[-1] = 1.0, brightness
    return action


def checked_action(name: str, action: ArrayLike, shape: tuple[int, ...] = (ACTION_SIZE,)) -> NDArray[np.float32]:
    """The action as float32; values beyond [-1, 1] are left to the controller, which clips them.

    Raises:
        ActionError: it is of another shape or not finite.
    """
    try:
        array = np.asarray(action, dtype=np.float32)
    except (TypeError, ValueError):
        raise ActionError(f"action[{name}]", action, f"{shape} finite numbers") from None
    if array.shape != shape:
        raise ActionError(f"action[{name}].shape", array.shape, str(shape))
    if not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array.ravel()))[0])
        field = ACTION_NAMES[bad % ACTION_SIZE]
        raise ActionError(f"action[{name}].{field}", float(array.ravel()[bad]), "a finite number in [-1, 1]")
    return array

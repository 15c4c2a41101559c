"""A policy that holds still; the environment variables of a test may make it slow or make it fail."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from coop_envs.policy import TeamDescription, TeamNeeds


class Still:
    """Holds. ``SLOW_S`` is slept before each decision; the seed ``FAIL_SEED`` raises."""

    name = "still"
    needs = TeamNeeds(lasers=int(os.environ.get("LASERS_NEEDED", "0")))

    def reset(self, team: TeamDescription, seed: int) -> None:
        self.seed = seed

    def act(self, observations: dict[str, Any]) -> dict[str, Any]:
        time.sleep(float(os.environ.get("SLOW_S", "0")))
        if os.environ.get("FAIL_SEED") == str(self.seed):
            raise RuntimeError("the policy gave up")
        return {agent: np.ones(8, dtype=np.float32) for agent in observations}


def make_policy() -> Still:
    """What `load_policy` calls."""
    return Still()

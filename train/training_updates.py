"""The seam to Stable-Baselines3's loop: what a training is told of its rollouts and updates."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

if TYPE_CHECKING:
    from train.training import Training

TELL_PERIOD_S = 0.2
EPISODE = {"return": "r", "length": "l", "robots_lost": "robots_lost"}
"""Figures of a row by their names in the infos of episodes."""


class Updates(BaseCallback):
    """Tells a training of its rollouts and updates."""

    def __init__(self, training: Training) -> None:
        super().__init__()
        self.training, self._rollout, self._told_at = training, None, 0.0

    def _on_rollout_start(self) -> None:
        self._after_update()
        teams = self.training.teams
        self._began_at, self._decisions, self._terms = time.monotonic(), teams.decisions, teams.term_sums.copy()

    def _on_step(self) -> bool:
        now = time.monotonic()
        if now - self._told_at > TELL_PERIOD_S:
            self._told_at = now
            rows = self.training.document["training"]
            self.training.tell(self.training.steps, rows[-1] if rows else {})
        return True

    def _on_rollout_end(self) -> None:
        teams, model = self.training.teams, self.training.model
        decisions = max(teams.decisions - self._decisions, 1)
        per_s = (teams.term_sums - self._terms) / (decisions * self.training.scenario.rates.decision_s)
        episodes = list(model.ep_info_buffer or [])
        self._rollout = {
            "episodes": len(episodes),
            **{name: _mean([e[key] for e in episodes]) for name, key in EPISODE.items()},
            "reward_per_s": dict(zip(teams.teams.reward_terms, per_s.tolist(), strict=True)),
        }

    def _on_training_end(self) -> None:
        self._after_update()

    def _after_update(self) -> None:
        if self._rollout is None:
            self.training.note_state()
        else:
            rows = self.training.settings.teams * self.training.settings.ppo.rollout_steps
            speed = {"steps_per_s": rows / (time.monotonic() - self._began_at)}
            self.training.after_update(self._rollout | speed)
            self._rollout = None


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None

"""A rollout of rows of which only those count whose robot was there and at work."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples

from train.team_vec_env import DOCKED


class TeamRolloutBuffer(DictRolloutBuffer):
    """Once returns are known, rows that are not alive, or docked, drop out: of losses, normalisations and figures."""

    def get(self, batch_size: int | None = None) -> Generator[DictRolloutBufferSamples, None, None]:
        """Minibatches of the rows that count, in random order, of about ``batch_size`` rows and nearly equal."""
        assert self.full
        if not self.generator_ready:
            self._drop_rows()
            self.generator_ready = True
        order = np.random.permutation(len(self.actions))  # noqa: NPY002  the generator whose state SB3 seeds
        parts = max(1, round(len(order) / (batch_size or len(order) or 1)))
        for rows in np.array_split(order, parts):
            yield self._get_samples(rows)

    def _drop_rows(self) -> None:
        """Flatten steps and rows into one axis (a view), and keep those that count."""
        flat = {name: _flat(array) for name, array in self.observations.items()}
        kept = (flat["alive"][:, 0] > 0) & (flat["self"][:, DOCKED] == 0)
        rows = slice(None) if kept.all() else np.flatnonzero(kept)
        self.observations = {name: array[rows] for name, array in flat.items()}
        for name in ("actions", "values", "log_probs", "advantages", "returns"):
            setattr(self, name, _flat(getattr(self, name))[rows])

    def to_torch(self, array: NDArray[Any], copy: bool = True) -> torch.Tensor:  # noqa: ARG002
        """The array as a tensor that shares its memory: what is sampled is a copy already."""
        return torch.as_tensor(array, device=self.device)


def _flat(array: NDArray[Any]) -> NDArray[Any]:
    return array.reshape(-1, *array.shape[2:])

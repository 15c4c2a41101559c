"""Running mean and variance of the observed numbers, kept inside the network and its file."""

from __future__ import annotations

import torch
from torch import Tensor, nn

LEAST_STD = 0.1  # entries are of order one by their scales; one that hardly ever varied must not drown the others
CLIP = 10.0


class RunningMoments(nn.Module):
    """Mean and variance (k,) of all rows seen so far; before the first, 0 and 1."""

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, entries: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(entries))
        self.register_buffer("variance", torch.ones(entries))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def update(self, rows: Tensor) -> None:
        """Take in rows (n, k).

        Source: Chan, Golub, LeVeque, "Updating formulae and a pairwise algorithm for computing sample variances", 1979.
        """
        if not len(rows):
            return
        rows = rows.double()
        fresh, spread = rows.mean(0), rows.var(0, correction=0)
        total = self.count + len(rows)
        share, delta = len(rows) / total, fresh - self.mean
        variance = (1 - share) * self.variance + share * spread + share * (1 - share) * delta**2
        self.mean.copy_(self.mean + share * delta)
        self.variance.copy_(variance)
        self.count.copy_(total)

    def forward(self, rows: Tensor) -> Tensor:
        """Rows (..., k) without their mean, over their standard deviation, clipped to 10 of them."""
        std = self.variance.sqrt().clamp(min=LEAST_STD)
        return ((rows - self.mean) / std).clamp(-CLIP, CLIP)


class Normaliser(nn.Module):
    """Moments of ``self`` and ``mates``; whoever trains updates them between rollouts, never within one."""

    def __init__(self, self_entries: int, mate_entries: int) -> None:
        super().__init__()
        self.self_moments = RunningMoments(self_entries)
        self.mate_moments = RunningMoments(mate_entries)

    @torch.no_grad()
    def update(self, observations: dict[str, Tensor]) -> None:
        """Take in rows (n, ...), and the mates in them of which ``mask`` is set."""
        own, mates, seen = (observations[key] for key in ("self", "mates", "mask"))
        self.self_moments.update(own)
        self.mate_moments.update(mates[seen > 0])

    def forward(self, own: Tensor, mates: Tensor) -> tuple[Tensor, Tensor]:
        return self.self_moments(own), self.mate_moments(mates)

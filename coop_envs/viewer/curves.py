"""How a quantity grows over episodes: medians and quartiles against time or energy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Episode = Mapping[str, Any]


@dataclass(frozen=True)
class Band:
    """Median and quartiles over episodes of a quantity, at points ``x`` (k,)."""

    x: NDArray[np.float64]
    median: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def band(curves: Sequence[tuple[ArrayLike, ArrayLike]], x: NDArray[np.float64]) -> Band:
    """Median and quartiles at ``x`` over curves (x_k, y_k); a curve that ended keeps its last value."""
    values = np.array([np.interp(x, np.asarray(at), np.asarray(y)) for at, y in curves])
    low, median, high = np.quantile(values, (0.25, 0.5, 0.75), axis=0)
    return Band(x, median, low, high)


def bands(
    results: Mapping[str, Sequence[Episode]], against: str, quantity: str = "coverage", count: int = 200
) -> dict[str, Band]:
    """A band for each policy of one series against another, both named as in an episode's ``series``."""
    curves = {
        policy: [
            (episode["series"][against], episode["series"][quantity])
            for episode in episodes
            if (episode.get("series") or {}).get(against)
        ]
        for policy, episodes in results.items()
    }
    ends = [float(np.max(at)) for episodes in curves.values() for at, _ in episodes]
    x = np.linspace(0.0, max(ends, default=1.0), count)
    return {policy: band(episodes, x) for policy, episodes in curves.items() if episodes}

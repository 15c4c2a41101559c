"""Information of a map in bits: how far its cells' entropies have fallen, counted against it where it is wrong.

Sums are integers (micro-bits), so that their order does not matter.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.mapping.ground_map import LOG_ODDS_SCALE

MICRO = 1.0e6


def cell_information_ubit() -> NDArray[np.int32]:
    """Micro-bits that a cell of log-odds k/16 holds, at index k + 128: 1e6 (1 - H(p)), (256,)."""
    p = 1.0 / (1.0 + np.exp(-(np.arange(256) - 128.0) / LOG_ODDS_SCALE))
    entropy = -(p * np.log2(p) + (1.0 - p) * np.log2(1.0 - p))
    return np.rint(MICRO * (1.0 - entropy)).astype(np.int32)


def information_bits(log_odds: NDArray[np.int8], facts: NDArray[np.bool_]) -> float:
    """Bits that cells (n,) of these log-odds hold: what leans to the facts counts, what leans away counts against."""
    held = cell_information_ubit()[log_odds.astype(np.int64) + 128]
    return float(np.where((log_odds > 0) == facts, held, -held).sum()) / MICRO


@wp.func
def held_ubit(table: wp.array[int], log_odds: int, truth: bool) -> int:
    """Micro-bits that a cell holds: positive where it leans to the truth, negative where it leans away."""
    if (log_odds > 0) == truth:
        return table[log_odds + 128]
    return -table[log_odds + 128]

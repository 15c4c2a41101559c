"""Random numbers for B teams at once on the host, each a pure function of its key: batch size and order do not matter.

A draw is the SplitMix64 sequence that starts at the hash of (episode key, decision, stream).

Source: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Keys = NDArray[np.uint64]
Counts = NDArray[np.int64]

GAMMA = np.uint64(0x9E3779B97F4A7C15)
FIRST, SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
STREAM_BITS = 16


def mixed(x: Keys) -> Keys:
    """SplitMix64's step and finaliser, as `geometry.keyed_random.mix`, of every number."""
    x = x + GAMMA
    x = (x ^ (x >> np.uint64(30))) * FIRST
    x = (x ^ (x >> np.uint64(27))) * SECOND
    return x ^ (x >> np.uint64(31))


def episode_keys(seeds: Counts, episodes: Counts) -> Keys:
    """`geometry.keyed_random.team_key` of every team (B,)."""
    return mixed(mixed(seeds.astype(np.uint64)) ^ episodes.astype(np.uint64))


def uniform(keys: Keys, decisions: Counts, stream: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Uniform numbers in (0, 1), (B, *shape), for the decisions (B,) of the episodes with these keys (B,)."""
    bits = _bits(keys, decisions, stream, math.prod(shape)) >> np.uint64(11)
    return ((bits.astype(np.float64) + 0.5) * 2.0**-53).reshape(len(keys), *shape)


def normal(keys: Keys, decisions: Counts, stream: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Standard normal numbers (B, *shape), by Box and Muller."""
    size = math.prod(shape)
    u = uniform(keys, decisions, stream, (2, size))
    return (np.sqrt(-2.0 * np.log(u[:, 0])) * np.cos(math.tau * u[:, 1])).reshape(len(keys), *shape)


def _bits(keys: Keys, decisions: Counts, stream: int, size: int) -> Keys:
    place = (decisions.astype(np.uint64) << np.uint64(STREAM_BITS)) | np.uint64(stream)
    start = mixed(keys ^ mixed(place))
    return mixed(start[:, None] + GAMMA * np.arange(size, dtype=np.uint64))

"""How sure a figure is: interquartile means with stratified bootstrap intervals, success rates, paired differences.

Source: R. Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical Precipice", 2021 (interquartile
mean, stratified bootstrap); E. B. Wilson, 1927 (interval of a rate).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Statistic = Callable[[NDArray[np.float64]], NDArray[np.float64]]
CONFIDENCE = 0.95
RESAMPLES = 2000


@dataclass(frozen=True)
class Estimate:
    """A value with the interval that holds it with 95 % confidence, from n episodes."""

    value: float
    low: float
    high: float
    n: int


def interquartile_mean(values: ArrayLike) -> NDArray[np.float64]:
    """Mean of the middle half along the last axis; a quarter of the entries, rounded down, is cut at each end."""
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=-1)
    cut = ordered.shape[-1] // 4
    return ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1)


def bootstrap(
    strata: Sequence[ArrayLike], statistic: Statistic = interquartile_mean, resamples: int = RESAMPLES, seed: int = 0
) -> Estimate:
    """``statistic`` over all strata together, and its percentile interval when each stratum is resampled by itself.

    Strata are tasks: the episodes of one scenario are one stratum.
    """
    samples = [np.asarray(stratum, dtype=np.float64) for stratum in strata]
    generator = np.random.default_rng(seed)
    drawn = [s[generator.integers(s.size, size=(resamples, s.size))] for s in samples]
    low, high = _percentiles(statistic(np.concatenate(drawn, axis=-1)))
    pooled = np.concatenate(samples)
    return Estimate(float(statistic(pooled)), low, high, pooled.size)


def success_rate(successes: Sequence[bool]) -> Estimate:
    """Share of successes with Wilson's interval."""
    from scipy.stats import binomtest

    test = binomtest(sum(successes), len(successes))
    interval = test.proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(float(test.statistic), float(interval.low), float(interval.high), len(successes))


def paired_difference(
    a: ArrayLike,
    b: ArrayLike,
    per_a: ArrayLike = 1.0,
    per_b: ArrayLike = 1.0,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Estimate:
    """Difference of means a - b over episodes on the same worlds and seeds; with ``per_*``, of ratios of sums.

    ``paired_difference(lost_a, lost_b, area_a, area_b)`` compares pickets lost per square metre covered: a ratio of
    sums stays defined where a single episode covers nothing. Episodes are resampled in pairs.
    """
    pairs = np.stack([np.broadcast_to(np.asarray(x, dtype=np.float64), np.shape(a)) for x in (a, b, per_a, per_b)])
    drawn = np.random.default_rng(seed).integers(pairs.shape[1], size=(resamples, pairs.shape[1]))
    low, high = _percentiles(_ratio_difference(pairs[:, drawn]))
    return Estimate(float(_ratio_difference(pairs)), low, high, pairs.shape[1])


def _ratio_difference(pairs: NDArray[np.float64]) -> NDArray[np.float64]:
    a, b, per_a, per_b = pairs.sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return a / per_a - b / per_b


def _percentiles(estimates: NDArray[np.float64]) -> tuple[float, float]:
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(estimates, [tail, 1.0 - tail], method="inverted_cdf")
    return float(low), float(high)

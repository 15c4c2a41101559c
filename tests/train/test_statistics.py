"""Estimates against scipy's, and intervals against the coverage they promise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from train.statistics import bootstrap, interquartile_mean, paired_difference, success_rate

FLOATS = st.floats(-1e6, 1e6)


@given(st.lists(FLOATS, min_size=1, max_size=40))
def test_interquartile_mean_is_the_trimmed_mean(values):
    assert interquartile_mean(values) == pytest.approx(stats.trim_mean(values, 0.25), rel=1e-9, abs=1e-6)


def test_interquartile_mean_drops_the_tails():
    assert interquartile_mean([-1000, 1, 2, 3, 4, 5, 6, 1000]) == pytest.approx(3.5)


def test_bootstrap_agrees_with_scipy():
    values = np.random.default_rng(1).gamma(2.0, size=60)
    theirs = stats.bootstrap(
        (values,), lambda x, axis: stats.trim_mean(x, 0.25, axis=axis), n_resamples=4000, method="percentile", rng=2
    ).confidence_interval
    ours = bootstrap([values], resamples=4000)
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=0.05)
    assert ours.low < ours.value < ours.high


def test_bootstrap_keeps_strata_apart():
    """Two tasks without spread leave nothing to resample; pooled, the same episodes would."""
    apart = bootstrap([[0.0] * 10, [1.0] * 10])
    pooled = bootstrap([[0.0] * 10 + [1.0] * 10])
    assert apart.low == apart.high == apart.value == 0.5
    assert pooled.low < 0.5 < pooled.high


def test_bootstrap_interval_holds_the_mean_about_as_often_as_it_says():
    generator = np.random.default_rng(3)
    held = 0
    for trial in range(300):
        interval = bootstrap([generator.normal(size=40)], resamples=300, seed=trial)
        held += interval.low <= 0.0 <= interval.high
    assert 0.88 <= held / 300 <= 0.99


def test_an_infinite_value_reaches_the_summary_only_past_the_tail():
    assert bootstrap([[1.0, 2.0, 3.0, 4.0, 5.0, np.inf]]).value == pytest.approx(3.5)
    assert bootstrap([[1.0, np.inf, np.inf]]).value == np.inf


@given(st.integers(0, 30), st.integers(1, 30))
def test_success_rate_follows_wilsons_formula(wins, more):
    n, z = wins + more, stats.norm.ppf(0.975)
    rate = success_rate([True] * wins + [False] * more)
    centre = (wins + z * z / 2) / (n + z * z)
    half = z / (n + z * z) * np.sqrt(wins * more / n + z * z / 4)
    assert (rate.low, rate.high) == pytest.approx((centre - half, centre + half), abs=1e-9)


def test_paired_difference_sees_what_unpaired_noise_hides():
    noise = np.random.default_rng(4).normal(scale=100.0, size=50)
    difference = paired_difference(noise + 1.0, noise)
    assert difference.value == pytest.approx(1.0)
    assert 0.99 < difference.low <= difference.high < 1.01


def test_ratios_of_sums_stay_defined_where_an_episode_covers_nothing():
    difference = paired_difference([1, 2, 3], [1, 1, 1], per_a=[0.0, 1.0, 2.0], per_b=[1.0, 1.0, 1.0])
    assert difference.value == pytest.approx(6 / 3 - 1)
    assert difference.n == 3

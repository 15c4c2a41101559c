from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from coop_envs.geometry.keyed_random import MASK, mix, team_key
from tests.geometry.kernels import keys, mixed, on_device, pairs, triples, uniforms

GOLDEN = 0x9E3779B97F4A7C15
# The first outputs of SplitMix64 with seed 1234567, as published (rosettacode.org, Pseudo-random_numbers/Splitmix64).
PUBLISHED = (
    6457827717110365317,
    3203168211198807973,
    9817491932198370423,
    4593380528125082431,
    16408922859458223821,
)
STATES = [(1234567 + n * GOLDEN) & MASK for n in range(len(PUBLISHED))]
DRAWS = 100_000
LEAST_P = 1e-4
"""Every number is a function of fixed keys, so a test that passes once always does."""

words = st.integers(0, MASK)


def places(count, channel=0):
    """(tick, robot, channel) of ``count`` draws of 16 robots."""
    n = np.arange(count)
    return np.stack([n // 16, n % 16, np.full(count, channel)], axis=-1).astype(np.int32)


def test_published_sequence():
    assert tuple(mix(state) for state in STATES) == PUBLISHED
    assert tuple(on_device(mixed, np.array(STATES, dtype=np.uint64)).tolist()) == PUBLISHED


@settings(deadline=None)
@given(st.lists(words, min_size=1, max_size=20))
def test_host_and_device_agree(values):
    assert on_device(mixed, np.array(values, dtype=np.uint64)).tolist() == [mix(value) for value in values]


@settings(deadline=None)
@given(words, st.integers(0, 2**31 - 1), st.integers(0, 2**16 - 1), st.integers(0, 2**16 - 1))
def test_a_draw_is_the_hash_of_its_place(team, tick, robot, channel):
    place = np.array([[tick, robot, channel]], dtype=np.int32)
    (found,) = on_device(keys, np.array([team], dtype=np.uint64), place).tolist()
    assert found == mix(team ^ mix((tick << 32) | (robot << 16) | channel))


def test_no_two_places_share_a_key():
    tick, robot, channel = np.meshgrid(np.arange(300), np.arange(16), np.arange(80), indexing="ij")
    place = np.stack([tick.ravel(), robot.ravel(), channel.ravel()], axis=-1).astype(np.int32)
    found = on_device(keys, np.full(len(place), team_key(1, 0), dtype=np.uint64), place)
    assert len(np.unique(found)) == len(place)


def test_episodes_and_seeds_have_keys_of_their_own():
    found = {team_key(seed, episode) for seed in range(100) for episode in range(100)}
    assert len(found) == 100 * 100
    assert team_key(-1, 0) == team_key(MASK, 0)


def test_uniform_lies_strictly_between_0_and_1():
    low, high = on_device(uniforms, np.array([0, MASK], dtype=np.uint64))
    assert 0.0 < low < 1e-6 and 1.0 - 1e-6 < high < 1.0


def test_uniform_distribution():
    team = np.full(DRAWS, team_key(7, 3), dtype=np.uint64)
    u = on_device(uniforms, on_device(keys, team, places(DRAWS)))
    assert stats.kstest(u, "uniform").pvalue > LEAST_P


def test_normals_are_standard_and_independent():
    team = np.full(DRAWS, team_key(7, 3), dtype=np.uint64)
    a = on_device(pairs, on_device(keys, team, places(DRAWS))).astype(float)
    b = on_device(triples, team, places(DRAWS, channel=5)).astype(float)
    numbers = np.concatenate([a, b], axis=1)
    for column in numbers.T:
        assert stats.kstest(column, "norm").pvalue > LEAST_P
    radius2 = np.sum(a**2, axis=1)
    assert stats.kstest(radius2, stats.chi2(2).cdf).pvalue > LEAST_P
    neighbours = np.concatenate([numbers[16:], numbers[:-16], numbers[1:-15]], axis=1)
    correlation = np.corrcoef(neighbours, rowvar=False)
    np.testing.assert_allclose(correlation, np.eye(15), atol=5 / np.sqrt(DRAWS))


def test_the_rarest_numbers_are_finite():
    extreme = np.array([0, MASK, MASK >> 24, MASK << 40 & MASK], dtype=np.uint64)
    assert np.all(np.isfinite(on_device(pairs, extreme)))


@pytest.mark.parametrize("size", [1, 7])
def test_batch_size_and_order_do_not_matter(size):
    team = np.array([team_key(seed, 0) for seed in range(21)], dtype=np.uint64)
    place = places(21)
    together = on_device(triples, team, place)
    order = np.random.default_rng(0).permutation(21)
    apart = np.concatenate([on_device(triples, team[c], place[c]) for c in np.split(order, 21 // size)])
    np.testing.assert_array_equal(apart, together[order])

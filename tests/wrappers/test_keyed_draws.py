"""Draws of the host: hashed as the device's keys, uniform and normal, whatever B."""

from __future__ import annotations

import numpy as np
from scipy import stats

from coop_envs.geometry.keyed_random import team_key
from coop_envs.wrappers.keyed_draws import episode_keys, normal, uniform

SEEDS = np.array([0, 1, 7, 2**62], dtype=np.int64)


def test_episode_keys_are_the_environments_keys() -> None:
    for episode in (0, 1, 99):
        got = episode_keys(SEEDS, np.full(4, episode)).tolist()
        assert got == [team_key(seed, episode) for seed in SEEDS.tolist()]


def test_a_teams_numbers_do_not_depend_on_the_others() -> None:
    keys, decisions = episode_keys(SEEDS, np.zeros(4, dtype=np.int64)), np.array([0, 5, 5, 9])
    together = normal(keys, decisions, 3, (2, 5))
    for b in range(4):
        np.testing.assert_array_equal(normal(keys[b : b + 1], decisions[b : b + 1], 3, (2, 5))[0], together[b])


def test_numbers_have_their_distributions_and_no_correlation_from_one_decision_or_stream_to_the_next() -> None:
    keys, zero = episode_keys(np.arange(2000), np.zeros(2000, dtype=np.int64)), np.zeros(2000, dtype=np.int64)
    u, z = uniform(keys, zero, 1, (10,)), normal(keys, zero, 1, (10,))
    assert stats.kstest(u.ravel(), "uniform").pvalue > 1e-3
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-3
    assert u.min() > 0.0 and u.max() < 1.0
    for other in (uniform(keys, zero + 1, 1, (10,)), uniform(keys, zero, 2, (10,)), np.roll(u, 1, axis=1)):
        assert abs(np.corrcoef(u.ravel(), other.ravel())[0, 1]) < 4.0 / np.sqrt(u.size)

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from coop_envs.agents.catalog import load_robot
from coop_envs.agents.power import sampled_energy_j, segment_energy_j
from coop_envs.agents.power_regression import MARKER_STATE, SCANNER_STATE, regress_power
from coop_envs.errors import ConfigError

EQ_6_17 = np.array([[14.0, 0, 1.68, 0], [0, 0.035, 0, 0], [1.68, 0, 0, 0], [0, 0, 0, 7.56]])
EQ_6_18_SCANNER = np.array([[0, 0, 0.25], [0, 0, 0.025], [0.25, 0.025, 0]])


def driving(count, seed=0):
    """States (count, 4) of a robot that drives about on hilly ground."""
    rng = np.random.default_rng(seed)
    free = rng.uniform([-1.0, -10.0, -0.3], [1.0, 10.0, 0.3], (count, 3))
    return np.column_stack([free, np.ones(count)])


def watts(matrix, states):
    return np.einsum("ni,ij,nj->n", states, matrix, states)


def test_a_log_without_noise_gives_the_matrix_back():
    fit = regress_power(driving(50), watts(EQ_6_17, driving(50)))
    np.testing.assert_allclose(fit.matrix, EQ_6_17, atol=1e-9)
    assert fit.residual_w < 1e-9 and fit.samples == 50


def test_noisy_logs_give_eq_6_17_within_their_standard_errors():
    """Of 200 logs, each entry's error over its standard error has mean 0 and deviation 1; zeros come out as zeros."""
    rng = np.random.default_rng(1)
    states = driving(300)
    upper = np.triu_indices(4)
    scores = []
    for _ in range(200):
        fit = regress_power(states, watts(EQ_6_17, states) + 0.2 * rng.normal(size=300))
        scores.append(((fit.matrix - EQ_6_17) / fit.standard_error)[upper])
        assert fit.residual_w == pytest.approx(0.2, rel=0.2)
    np.testing.assert_allclose(np.mean(scores, axis=0), 0.0, atol=4 / np.sqrt(200))
    np.testing.assert_allclose(np.std(scores, axis=0), 1.0, atol=0.2)


def test_the_zumys_file_holds_the_thesis_matrices():
    power = load_robot("zumy").power
    np.testing.assert_allclose(power.robot, EQ_6_17)
    np.testing.assert_allclose(power.scanner, EQ_6_18_SCANNER)


def test_markers_and_scanner_too():
    level = np.linspace(0, 4590, 40)
    lit = np.column_stack([level, np.ones(40)])
    fit = regress_power(lit, 4e-4 * level, MARKER_STATE)
    assert fit.matrix[0, 1] == pytest.approx(2e-4) and fit.matrix[0, 0] == pytest.approx(0.0, abs=1e-12)
    commands = np.column_stack([np.random.default_rng(2).uniform(size=(40, 2)), np.ones(40)])
    fit = regress_power(commands, watts(EQ_6_18_SCANNER, commands), SCANNER_STATE)
    np.testing.assert_allclose(fit.matrix, EQ_6_18_SCANNER, atol=1e-12)


def flat(states):
    return states * [1, 1, 0, 1]


def one_speed(states):
    return np.column_stack([np.full(len(states), 0.1), states[:, 1:]])


def turning_with_speed(states):
    return np.column_stack([states[:, 0], 2 * states[:, 0], states[:, 2:]])


@pytest.mark.parametrize(
    ("drive", "named"),
    [
        (flat, r"v\*climb, omega\*climb, climb\^2, climb always 0"),
        (one_speed, r"v\^2, .*v, .*constant linearly dependent"),
        (turning_with_speed, r"v\^2, v\*omega, .*omega\^2"),
    ],
)
def test_what_was_never_excited_is_named(drive, named):
    states = drive(driving(100))
    with pytest.raises(ConfigError, match=named):
        regress_power(states, watts(EQ_6_17, states))


@pytest.mark.parametrize(
    ("states", "power", "named"),
    [
        (driving(10), np.ones(10), "more than 10 samples"),
        (driving(50)[:, :3], np.ones(50), "v, omega, climb, 1"),
        (driving(50), np.ones(49), "one power for each"),
        (driving(50), np.full(50, np.nan), "finite"),
    ],
)
def test_a_log_that_cannot_be_read_is_refused(states, power, named):
    with pytest.raises(ConfigError, match=named):
        regress_power(states, power)


def test_sampled_energies_converge_to_the_exact_ones_in_first_order():
    """Eq (6.16) holds each state for a period; eq (6.5) integrates it. Halving the period halves the difference."""
    corners = driving(6, seed=3)
    duration = 2.0
    exact = sum(segment_energy_j(EQ_6_17, a, b, duration) for a, b in pairwise(corners))
    ratios = []
    for steps in (100, 200, 400):
        share = np.arange(steps)[:, None] / steps
        states = np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])
        ratios.append(sampled_energy_j(EQ_6_17, states, duration / steps) - exact)
    assert abs(ratios[-1]) < 0.01 * exact
    np.testing.assert_allclose([ratios[0] / ratios[1], ratios[1] / ratios[2]], 2.0, rtol=0.05)

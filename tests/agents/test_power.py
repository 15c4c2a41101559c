from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from coop_envs.agents.catalog import load_hat, load_robot
from coop_envs.agents.power import segment_energy_j

POWER = load_robot("zumy").power
ROBOT, MARKER, SCANNER = (np.array(matrix) for matrix in (POWER.robot, POWER.marker, POWER.scanner))

states = st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3).map(lambda x: np.array([*x, 1.0]))


def watts(matrix, *state):
    """x^T M x of a state that holds still, by the energy of a second."""
    x = np.array([*state, 1.0])
    return segment_energy_j(matrix, x, x, 1.0)


@pytest.mark.parametrize(
    ("state", "figure"),
    [((0.0, 0.0, 0.0), 7.56), ((0.1, 0.0, 0.0), 7.70), ((0.0, 0.5, 0.0), 7.569), ((0.1, 0.0, 1.0), 7.70 + 0.336)],
)
def test_a_zumys_power(state, figure):
    """Figures of the thesis's experiments; straight up, 0.1 m/s lifts its 3.36 N."""
    assert watts(ROBOT, *state) == pytest.approx(figure, abs=5e-4)


def test_markers_power():
    """Six colours at full brightness draw 0.918 W, six white LEDs 1.836 W, a dark hat nothing."""
    channels = {0: 255, 60: 510, 120: 255, 180: 510, 240: 255, 300: 510}
    colours = sum(channels[round(led.hue_deg)] for led in load_hat("hat0").leds)
    assert watts(MARKER, colours) == pytest.approx(0.918, abs=1e-6)
    assert watts(MARKER, 6 * 3 * 255) == pytest.approx(1.836, abs=1e-6)
    assert watts(MARKER, 0.0) == 0.0


def test_the_galvo_comes_first_and_the_laser_second():
    assert watts(SCANNER, 1.0, 0.0) == pytest.approx(0.5)
    assert watts(SCANNER, 0.0, 1.0) == pytest.approx(0.05)


@given(states, states, st.floats(0.1, 30.0))
def test_a_segments_energy_is_the_integral_of_its_power(start, end, duration):
    def power(t):
        x = start + (end - start) * t / duration
        return x @ ROBOT @ x

    assert segment_energy_j(ROBOT, start, end, duration) == pytest.approx(
        quad(power, 0.0, duration)[0], rel=1e-9, abs=1e-9
    )


@given(states, states, st.floats(0.0, 1.0))
def test_segments_add_up(start, end, share):
    middle = start + share * (end - start)
    parts = segment_energy_j(ROBOT, start, middle, share) + segment_energy_j(ROBOT, middle, end, 1.0 - share)
    assert parts == pytest.approx(segment_energy_j(ROBOT, start, end, 1.0), rel=1e-9, abs=1e-9)


def test_why_the_matrix_must_be_symmetric():
    """Only the symmetric part of M draws power, but eq (6.5) with the other part in it would say otherwise."""
    twisted = ROBOT + np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])
    start, end = np.array([0.3, 0.0, 0.0, 1.0]), np.array([0.0, 0.7, 0.0, 1.0])
    assert watts(twisted, 0.2, 0.4, 0.0) == pytest.approx(watts(ROBOT, 0.2, 0.4, 0.0))
    difference = segment_energy_j(twisted, start, end, 1.0) - segment_energy_j(ROBOT, start, end, 1.0)
    assert abs(difference) > 0.01

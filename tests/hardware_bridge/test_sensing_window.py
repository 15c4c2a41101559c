"""Raw inputs of a decision as measurements: each spot in its tick, each signal over its window."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_team
from coop_envs.device import prepare
from coop_envs.sensing.measurements import allocate_measurements
from hardware_bridge.battery import charge
from hardware_bridge.reading import CameraFrame, Sample
from hardware_bridge.seeing import Seeing
from hardware_bridge.sensing_window import LATE_SHARE, SensingWindow
from hardware_bridge.tick_inputs import TickInputs

TICK_S, TICKS = 1 / 30, 6
TEAM = load_team("surveyors")
NAMES = [member.name for member in TEAM.members]
DARK, ON_THE_GROUND = [0.0] * len(NAMES), [False] * len(NAMES)


def made():
    prepare("cpu")
    measurements = allocate_measurements(1, len(NAMES), TICKS, "cpu")
    return SensingWindow(TEAM, Seeing(), measurements, "cpu"), measurements


WINDOW, MEASUREMENTS = made()


def still(k, t):
    return Sample(t, None, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0, 0.01 * k), (0.0, 0.0, 9.8), 7.4)


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 1e4), st.integers(0, TICKS - 1), st.floats(0.15, 0.95), st.integers(0, 10_000))
def test_a_spot_goes_to_the_tick_in_which_it_was_taken(start, tick, share, seed):
    """Also where ticks are late and uneven, as on a busy machine."""
    rng = np.random.default_rng(seed)
    edges = start + np.cumsum(rng.uniform(0.6, 1.6, size=TICKS)) * TICK_S
    begins = [start, *edges]
    mean = (edges[-1] - start) / TICKS
    taken = begins[tick] + LATE_SHARE * mean + share * (edges[tick] - begins[tick])
    frame = CameraFrame(taken, (), (100.0 + tick, 50.0, 0.5))
    WINDOW.take(TickInputs(float(edges[-1]), frames={NAMES[0]: (frame,)}))
    WINDOW.close(start, edges, DARK, ON_THE_GROUND)
    sigma = MEASUREMENTS.spot_sigma.numpy()[0, 0]
    assert np.flatnonzero(sigma).tolist() == [tick]
    assert MEASUREMENTS.spot.numpy()[0, 0, tick].tolist() == [100.0 + tick, 50.0]
    assert MEASUREMENTS.spot_stamp.numpy()[0, 0, tick] == pytest.approx(taken - edges[tick], abs=1e-5)
    WINDOW.close(float(edges[-1]), edges[-1] + TICK_S * np.array([1.0, 2, 3, 4, 5, 6]), DARK, ON_THE_GROUND)


def test_a_frame_after_the_last_tick_waits_for_the_next_decision():
    window, measurements = made()
    edges = TICK_S * np.array([1.0, 2, 3, 4, 5, 6])
    window.take(TickInputs(0.2, frames={NAMES[0]: (CameraFrame(0.2 + 0.5 * TICK_S, (), (1.0, 2.0, 0.5)),)}))
    window.close(0.0, edges, DARK, ON_THE_GROUND)
    assert not measurements.spot_sigma.numpy().any()
    window.close(0.2, edges + 0.2, DARK, ON_THE_GROUND)
    assert np.flatnonzero(measurements.spot_sigma.numpy()[0, 0]).tolist() == [0]
    window.close(0.4, edges + 0.4, DARK, ON_THE_GROUND)
    assert not measurements.spot_sigma.numpy().any()


def test_samples_become_means_and_who_is_silent_was_not_heard():
    window, measurements = made()
    edges = TICK_S * np.array([1.0, 2, 3, 4, 5, 6])
    for k in range(7):
        window.take(TickInputs(k * TICK_S, samples={NAMES[0]: (still(3, k * TICK_S),)}))
    window.close(0.0, edges, DARK, [False, False, True])
    np.testing.assert_allclose(measurements.gyro.numpy()[0, 0, :, 2], 0.03, atol=1e-6)
    np.testing.assert_allclose(measurements.accel.numpy()[0, 0, :, 2], 9.8, atol=1e-5)
    assert measurements.heard.numpy()[0].tolist() == [1, 0, 0]
    assert measurements.docked.numpy()[0].tolist() == [0, 0, 1]
    share = charge(TEAM.members[0].robot.battery, 7.4)
    np.testing.assert_allclose(measurements.battery.numpy()[0], [share, 1.0, 1.0])
    assert window.battery(0) == share and window.battery(1) is None
    window.close(0.2, edges + 0.2, DARK, ON_THE_GROUND)
    assert measurements.heard.numpy()[0].tolist() == [0, 0, 0]


def test_ages_count_from_the_last_sign_of_life():
    window, _ = made()
    assert window.sample_age_s(0, 5.0) == window.frame_age_s(5.0) == math.inf
    window.take(TickInputs(1.0, {NAMES[0]: (still(0, 1.0),)}, {NAMES[1]: (CameraFrame(0.9, ()),)}))
    assert window.sample_age_s(0, 1.5) == pytest.approx(0.5)
    assert window.frame_age_s(1.5) == pytest.approx(0.6)

"""Against generated truth: a clock that drifts, wraps and jumps, seen through random delays."""

from __future__ import annotations

import itertools
import random

import pytest

from coop_envs.localization.clocks.alignment import WRAP_S, ClockAlignment, DeviceClock


def arrivals(start_us, ppm, seconds, seed=0, hz=100.0, mean_delay_s=0.003, begin_s=0.0):
    """(time taken, arrival, 32-bit reading) of samples; delays are exponential, and none overtakes another."""
    rng, last = random.Random(seed), 0.0
    for k in range(int(seconds * hz)):
        taken = begin_s + k / hz
        last = max(last, taken + rng.expovariate(1 / mean_delay_s))
        yield taken, last, int(start_us + (taken - begin_s) * (1 + ppm * 1e-6) * 1e6) % 2**32


@pytest.mark.parametrize("ppm", [-100.0, 0.0, 100.0])
def test_the_time_of_a_sample_is_found_under_drift_and_delays(ppm):
    alignment = ClockAlignment()
    samples = list(arrivals(0, ppm, 120.0))
    errors = [abs(alignment.observe(host, us)[1] - taken) for taken, host, us in samples]
    assert max(errors[1000:]) < 0.002  # after 10 s
    assert max(errors[6000:]) < 0.0007
    assert alignment.drift_ppm == pytest.approx(ppm, abs=15.0)
    assert alignment.jumps == 0


def test_a_wrap_is_no_jump():
    alignment, clock = ClockAlignment(), DeviceClock()
    samples = list(arrivals(2**32 - 20_000_000, 40.0, 40.0))
    assert max(us for *_, us in samples) > 2**32 - 20_000 and min(us for *_, us in samples) < 20_000
    device = [clock.unwrap(host, us) for _, host, us in samples]
    assert all(0.009 < b - a < 0.011 for a, b in itertools.pairwise(device))
    errors = [abs(alignment.observe(host, us)[1] - taken) for taken, host, us in samples]
    assert max(errors[1000:]) < 0.002 and alignment.jumps == 0


def test_many_wraps_with_silence_between():
    clock, truth = DeviceClock(), []
    for k in range(9):
        host = k * 1800.0  # half an hour of silence each time
        truth.append(clock.unwrap(host, int(host * 1e6 * (1 + 5e-5)) % 2**32))
    assert truth[-1] == pytest.approx(8 * 1800.0 * (1 + 5e-5), abs=1e-3) and truth[-1] > 3 * WRAP_S


@pytest.mark.parametrize("restart_us", [0, 3_000_000, 900_000_000, 4_000_000_000])
def test_a_clock_that_begins_anew_is_noticed_and_learned(restart_us):
    alignment = ClockAlignment()
    for _, host, us in arrivals(500_000_000, 50.0, 15.0):
        alignment.observe(host, us)
    after = list(arrivals(restart_us, 50.0, 20.0, seed=1, begin_s=15.0))
    errors = [abs(alignment.observe(host, us)[1] - taken) for taken, host, us in after]
    assert alignment.jumps == 1
    assert max(errors[500:]) < 0.002


def test_late_samples_are_dated_back_and_teach_nothing():
    alignment = ClockAlignment()
    for taken, host, us in arrivals(0, 0.0, 60.0):
        late = 0.4 if 20.0 <= taken < 58.0 else 0.0
        _, when = alignment.observe(host + late, us)
        assert when <= host + late
        if taken > 10.0:
            assert abs(when - taken) < 0.002
    assert alignment.jumps == 0


def test_the_same_inputs_give_the_same_outputs():
    once, again = ClockAlignment(), ClockAlignment()
    for _, host, us in arrivals(7, 20.0, 20.0):
        assert once.observe(host, us) == again.observe(host, us)


def test_a_sample_is_never_taken_after_it_arrived():
    alignment = ClockAlignment()
    for _, host, us in arrivals(1234, -80.0, 30.0, mean_delay_s=0.02):
        assert alignment.observe(host, us)[1] <= host

"""Clocks: offsets that are known are found, by turns alone and by times of arrival."""

from __future__ import annotations

import dataclasses
import random

import numpy as np
import pytest

from coop_envs.localization.clocks.streams import ArrivalClock, OffsetClock, have_arrivals, stamps_agree, stream_name
from coop_envs.localization.clocks.turns import clock_offsets
from coop_envs.localization.logs.events import ImuSample, Log, PoseSighting
from coop_envs.localization.result import Kind
from tests.localization.generated_team import generated_log

OFFSETS_S = {"observer_0": 0.031, "picket_0": -0.047, "picket_1": 0.012}


@pytest.mark.parametrize(("imu_hz", "seed"), [(30.0, 0), pytest.param(100.0, 1, marks=pytest.mark.slow)])
def test_turns_tell_clock_offsets_to_five_milliseconds(imu_hz, seed):
    """The observer's gyro against resting pickets, theirs against the resting camera; frames at 30 Hz."""
    log = generated_log(seed, increments=4, imu_hz=imu_hz, turn_rad=1.5, clock_s=OFFSETS_S, odometry=False)
    found = clock_offsets(log.events, log, significant=True)
    assert set(found) == {f"imu {name}" for name in OFFSETS_S}
    for name, offset_s in OFFSETS_S.items():
        assert found[f"imu {name}"] == pytest.approx(-offset_s, abs=0.005)


@pytest.mark.slow
def test_a_late_camera_shows_in_every_imu():
    clocks = {"camera observer_0": 0.080}
    log = generated_log(2, increments=3, imu_hz=30.0, turn_rad=1.5, clock_s=clocks, odometry=False)
    found = clock_offsets(log.events, log, significant=True)
    assert all(found[f"imu {name}"] == pytest.approx(0.080, abs=0.006) for name in OFFSETS_S)


def test_clocks_that_agree_are_left_alone():
    log = generated_log(3, increments=2, imu_hz=30.0, turn_rad=1.5, odometry=False)
    assert clock_offsets(log.events, log, significant=True) == {}
    assert clock_offsets(log.events[:200], log, significant=False) == {}  # all rest: nothing turns


@pytest.mark.slow
def test_outliers_and_gaps_do_not_mislead():
    """A picket's radio is gone while it drives: its turn in the gap is no lag."""
    silent = [("picket_0", 3.0, 4.5), ("picket_0", 12.0, 13.0)]
    log = generated_log(4, increments=3, turn_rad=1.5, clock_s=OFFSETS_S, silent=silent, outliers=0.1, odometry=False)
    found = clock_offsets(log.events, log, significant=False)
    for name, offset_s in OFFSETS_S.items():
        assert found[f"imu {name}"] == pytest.approx(-offset_s, abs=0.008)


def on_own_clocks(log: Log, offset_s: dict[str, float], drift: dict[str, float], jump=None) -> Log:
    """The log as robots stamp it whose clocks start anywhere and run as they like; ``jump``: who, when, how far."""
    out = []
    for event in log.events:
        name = event.camera if isinstance(event, PoseSighting) else event.robot
        stamp = event.time_s * (1.0 + drift[name]) + offset_s[name]
        if jump is not None and name == jump[0] and event.time_s > jump[1]:
            stamp -= jump[2]
        out.append(dataclasses.replace(event, time_s=stamp))
    return dataclasses.replace(log, events=out)


STARTED_S = {"observer_0": 1234.5, "picket_0": -77.0, "picket_1": 3.0}
DRIFT = {"observer_0": 40e-6, "picket_0": -60e-6, "picket_1": 0.0}


def test_arrivals_align_clocks_that_start_anywhere():
    log = generated_log(0, increments=2, latency_s=0.01)
    own = on_own_clocks(log, STARTED_S, DRIFT)
    assert have_arrivals(own.events) and stamps_agree(log.events) and not stamps_agree(own.events)
    clock = ArrivalClock(2.0)
    errors = [clock.align(a).time_s - b.time_s for a, b in zip(own.events, log.events, strict=True)]
    assert np.abs(errors[1000:]).max() < 0.003 and clock.jumps == []


def test_a_clock_that_begins_anew_is_noticed_once():
    log = generated_log(0, increments=2, latency_s=0.01)
    own = on_own_clocks(log, STARTED_S, DRIFT, jump=("picket_0", 12.0, 900.0))
    clock = ArrivalClock(2.0)
    pairs = [(clock.align(a), b) for a, b in zip(own.events, log.events, strict=True)]
    assert [(one.kind, one.robot) for one in clock.jumps] == [(Kind.CLOCK_JUMP, "picket_0")]
    assert clock.jumps[0].time_s == pytest.approx(12.0, abs=0.1)
    assert max(abs(a.time_s - b.time_s) for a, b in pairs if b.time_s > 13.0) < 0.003


def test_late_and_copied_events_keep_their_time():
    """Events that others overtook teach the clock nothing and mean no jump; a copy gets the time of the first."""
    rng = random.Random(1)
    log = generated_log(0, increments=1, latency_s=0.005)
    delays_s = [0.5 if rng.random() < 0.05 else 0.0 for _ in log.events]
    late = [(float(e.arrival_s or 0.0) + s, k, e) for k, (e, s) in enumerate(zip(log.events, delays_s, strict=True))]
    clock = ArrivalClock(2.0)
    first = {}
    for arrival_s, _, event in sorted(late, key=lambda one: one[:2]):
        aligned = clock.align(dataclasses.replace(event, arrival_s=arrival_s))
        first.setdefault((stream_name(event), event.time_s), aligned.time_s)
        copy = clock.align(dataclasses.replace(event, arrival_s=arrival_s + 0.1))
        assert copy.time_s == aligned.time_s == first[stream_name(event), event.time_s]
        if event.time_s > 2.0:
            assert abs(aligned.time_s - event.time_s) < 0.003
    assert clock.jumps == []


def test_offsets_go_to_their_streams():
    sample = ImuSample(1.0, "picket_0", np.zeros(3), np.zeros(3))
    sighting = PoseSighting(1.0, "observer_0", "picket_0", np.eye(3), np.zeros(3), np.eye(6))
    clock = OffsetClock({"imu picket_0": 0.5, "camera observer_0": -0.25})
    assert clock.align(sample).time_s == 1.5 and clock.align(sighting).time_s == 0.75
    assert clock.align(dataclasses.replace(sample, robot="picket_1")).time_s == 1.0

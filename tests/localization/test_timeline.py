"""Whatever the order of arrival, the outcome is that of the order of time."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Hashable
from dataclasses import dataclass

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from coop_envs.localization.timeline import Order, Timeline, Window

HORIZON_S = 1.0
REACH_S = 0.2


@dataclass(frozen=True)
class Ping:
    """An event of a stream; those of streams 0 and 1 mark, those of 2 and 3 tell of the time before them."""

    time_s: float
    stream: int

    @property
    def marks(self) -> bool:
        return self.stream < 2


class Diary:
    """Remembers all that it was played: its digest depends on every bit, and on their order."""

    def __init__(self) -> None:
        self.digest = ""
        self.windows: tuple[Window[Ping], ...] = ()
        self.steps = 0

    def snapshot(self) -> tuple[str, tuple[Window[Ping], ...]]:
        return self.digest, self.windows

    def restore(self, snapshot: tuple[str, tuple[Window[Ping], ...]]) -> None:
        self.digest, self.windows = snapshot

    def step(self, window: Window[Ping]) -> None:
        self.steps += 1
        held: dict[Hashable, float] = {ping.stream: ping.time_s for ping in window.events}
        after = sorted((p.stream, p.time_s) for k, p in window.after.items() if held.get(k, -9.0) < window.end_s)
        told = (self.digest, window.start_s, window.end_s, window.events, after)
        self.digest = hashlib.sha256(repr(told).encode()).hexdigest()
        self.windows += (window,)


def timeline(start_s: float = 0.0, **changes) -> tuple[Timeline, Diary]:
    diary = Diary()
    order: Order[Ping] = Order(
        time_s=lambda ping: ping.time_s,
        stream=lambda ping: ping.stream,
        marks=lambda ping: ping.marks,
        reach_s=lambda ping: 0.0 if ping.marks else REACH_S,
        **{"horizon_s": HORIZON_S, **changes},
    )
    return Timeline(diary, order, start_s), diary


def played_in_order(events) -> Diary:
    line, diary = timeline()
    for event in sorted(events, key=lambda ping: ping.time_s):
        line.add(event)
    line.finish()
    return diary


pings = st.builds(Ping, st.integers(0, 3000).map(lambda k: k / 1000), st.integers(0, 3))


@settings(max_examples=150, deadline=None)
@example({Ping(0.001, 0), Ping(0.202, 0), Ping(0.203, 0)}, 0, 1.0, False)
@given(st.sets(pings, min_size=1, max_size=60), st.integers(0, 2**31), st.floats(0.0, HORIZON_S), st.booleans())
def test_any_order_of_arrival_within_the_horizon_ends_the_same(events, seed, late_s, twice):
    """Every event comes up to ``late_s`` late, some twice; the filter is asked to go on after each."""
    rng = random.Random(seed)
    arrivals = [(ping.time_s + rng.uniform(0.0, late_s), k, ping) for k, ping in enumerate(events)]
    arrivals += [(ping.time_s + rng.uniform(0.0, HORIZON_S), k, ping) for _, k, ping in arrivals if twice]
    line, diary = timeline()
    for at, _, ping in sorted(arrivals, key=lambda entry: entry[:2]):
        line.add(ping)
        line.advance(at - rng.uniform(0.0, 0.3))
    line.finish()
    assert line.counts.taken == len(events) and line.counts.late == 0
    assert line.counts.duplicate == (len(events) if twice else 0)
    assert diary.digest == played_in_order(events).digest


def test_windows_end_at_marks_and_are_not_long():
    diary = played_in_order([Ping(0.03, 0), Ping(0.03, 1), Ping(0.3, 0), Ping(0.35, 2)])
    assert [window.end_s for window in diary.windows] == pytest.approx([0.03, 0.13, 0.23, 0.3])
    assert diary.windows[0].events == (Ping(0.03, 0), Ping(0.03, 1))
    assert diary.windows[1].after == {}  # the next ping of stream 2 reaches back to 0.15 only
    assert diary.windows[2].after == {2: Ping(0.35, 2)}


def test_every_event_is_played_once():
    rng = random.Random(3)
    events = {Ping(rng.randrange(5000) / 1000, rng.randrange(4)) for _ in range(400)}
    played = [event for window in played_in_order(events).windows for event in window.events]
    last_s = max(event.time_s for event in played)
    assert set(played) == {event for event in events if event.time_s <= last_s} and len(played) == len(set(played))
    assert [event.time_s for event in played] == sorted(event.time_s for event in played)


def test_too_late_and_twice_are_dropped_and_counted():
    line, diary = timeline()
    for k in range(40):
        assert line.add(Ping(0.1 * k, 0))
        line.advance(0.1 * k)
    before = diary.digest
    assert not line.add(Ping(2.89, 1))
    assert not line.add(Ping(0.1 * 39, 0))
    line.finish()
    assert diary.digest == before
    assert line.add(Ping(2.91, 1))
    assert not line.add(Ping(2.91, 1))
    assert vars(line.counts) == {"taken": 41, "late": 1, "duplicate": 2, "replayed": 1}
    line.finish()
    assert diary.digest != before


def test_only_what_a_late_event_touches_is_played_again():
    line, diary = timeline(snapshot_every_s=0.0)
    for k in range(100):
        line.add(Ping(0.02 * k, 0))
        line.advance(0.02 * k)
    steps = diary.steps
    line.add(Ping(1.91, 1))
    line.advance(1.98)
    assert diary.steps - steps == 5  # 1.90-1.91, 1.91-1.92, ..., 1.96-1.98


def test_emptiness_is_one_window_whenever_it_is_known():
    """A clock that leaps ahead by an hour costs no hour of windows."""
    events = [Ping(0.1, 2), Ping(3700.0, 2), Ping(3700.1, 0)]
    diary = played_in_order(events)
    assert len(diary.windows) < 60
    assert max(window.end_s - window.start_s for window in diary.windows) == pytest.approx(1000.0)
    assert diary.windows[-1].end_s == 3700.1


def test_memory_is_bounded():
    line, diary = timeline()
    for k in range(3000):
        for stream in range(4):
            line.add(Ping(0.01 * k, stream))
        line.advance(0.01 * k - 0.05)
        diary.windows = ()
    held = sum(len(stream) for stream in line._streams.values())
    assert held < 4 * 100 * 3.5 * HORIZON_S and len(line._snapshots) < 40 and len(line._marks) < 400

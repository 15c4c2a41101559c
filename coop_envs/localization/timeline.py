"""`Timeline`: events that come late, out of order or twice, played to a filter in order of time.

Events wait in a buffer sorted by time. Windows are cut from it: one ends at every event that marks an instant, such as
a camera's frame, and none is longer than ``longest_s``. What a window holds depends on the events alone, not on when
they came: if one comes late, the filter goes back to its state before the first window that the event touches, and
the windows since are played again. So the outcome is the same, bit for bit, as if all had come in order.

Source: thesis figure 5.3, whose measurement buffer sorts, but does not go back.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

Event = TypeVar("Event")
Snapshot = TypeVar("Snapshot")

SLACK = 0.01
"""By this share a window may be longer, rather than leave a sliver before a mark."""
EMPTY_S = (1000.0, 100.0, 10.0, 1.0)
"""Where nothing came from anybody for so long, that time is one window."""


@dataclass(frozen=True, slots=True)
class Window(Generic[Event]):
    """The time from ``start_s``, excluded, to ``end_s``.

    ``events`` are what happened in it, by time and then by stream. ``after`` has each stream's next event, if it comes
    within the stream's reach: what was measured since the stream's last event may belong to this window.
    """

    start_s: float
    end_s: float
    events: tuple[Event, ...]
    after: Mapping[Hashable, Event]


class Replayable(Protocol[Event, Snapshot]):
    """What a timeline plays windows to. A step must depend on the window and the state that a snapshot holds alone."""

    def snapshot(self) -> Snapshot:
        """The whole state, not to change any more."""
        ...

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a state."""
        ...

    def step(self, window: Window[Event]) -> None:
        """Take in the next window."""
        ...


@dataclass(frozen=True)
class Order(Generic[Event]):
    """How a timeline orders events.

    ``time_s`` and ``stream`` tell an event's time, and whose it is: no stream has two events at one time. A window ends
    where ``marks`` is true. ``reach_s`` is how far back from its time an event tells something at most; further back
    than its stream's last event it never does. Events that lie more than ``horizon_s`` before what was played are
    dropped; no reach may be longer.
    """

    time_s: Callable[[Event], float]
    stream: Callable[[Event], Hashable]
    marks: Callable[[Event], bool]
    reach_s: Callable[[Event], float]
    longest_s: float = 0.1
    horizon_s: float = 2.0
    snapshot_every_s: float = 0.1


@dataclass
class Counts:
    """How many events were taken, came a second time, came too late, or were taken late and had windows replayed."""

    taken: int = 0
    duplicate: int = 0
    late: int = 0
    replayed: int = 0


class Timeline(Generic[Event, Snapshot]):
    """Plays events to ``filter`` from ``start_s`` on; `add` takes them in any order, `advance` plays up to a time."""

    def __init__(self, model: Replayable[Event, Snapshot], order: Order[Event], start_s: float) -> None:
        self.counts = Counts()
        self._model, self._order = model, order
        self._start_s = self._now_s = self._reached_s = start_s
        self._streams: dict[Hashable, list[tuple[float, Event]]] = {}
        self._names: dict[Hashable, str] = {}
        self._marks: list[float] = []
        self._snapshots: list[tuple[float, Snapshot]] = [(start_s, model.snapshot())]
        self._dirty_s = math.inf
        self._newest_s = start_s

    @property
    def now_s(self) -> float:
        """The end of the last window that was played."""
        return self._now_s

    def add(self, event: Event) -> bool:
        """Take in an event; False where it is dropped, being too old or a duplicate."""
        at, name = self._order.time_s(event), self._order.stream(event)
        stream = self._streams.setdefault(name, [])
        self._names.setdefault(name, repr(name))
        if at < max(self._start_s, self._reached_s - self._order.horizon_s):
            self.counts.late += 1
            return False
        k = bisect_left(stream, at, key=_time)
        if k < len(stream) and stream[k][0] == at:
            self.counts.duplicate += 1
            return False
        reach_s = self._reach(event, stream, k)
        if self._order.marks(event):
            reach_s = max(reach_s, 2.0 * SLACK * self._order.longest_s)
        self._touch(at - reach_s, at)
        stream.insert(k, (at, event))
        if self._order.marks(event):
            self._mark(at)
        self._newest_s = max(self._newest_s, at)
        self.counts.taken += 1
        return True

    def advance(self, to_s: float) -> None:
        """Play the windows that end at ``to_s`` or before, those that late events touched again.

        Nothing is played beyond the newest event.
        """
        if self._dirty_s < self._now_s:
            self._go_back()
        self._dirty_s = math.inf
        limit_s = min(to_s, self._newest_s)
        while (end_s := self._next_end()) <= limit_s:
            self._model.step(self._window(end_s))
            self._now_s = end_s
            if end_s - self._snapshots[-1][0] >= self._order.snapshot_every_s:
                self._snapshots.append((end_s, self._model.snapshot()))
        self._reached_s = max(self._reached_s, self._now_s)
        self._forget()

    def finish(self) -> None:
        """Play all that there is."""
        self.advance(math.inf)

    def _reach(self, event: Event, stream: list[tuple[float, Event]], k: int) -> float:
        """How far back an event about to be entered at place k tells something."""
        reach_s = self._order.reach_s(event)
        return min(reach_s, self._order.time_s(event) - stream[k - 1][0]) if k > 0 else reach_s

    def _touch(self, since_s: float, at: float) -> None:
        """Windows that end after ``since_s``, and the one that holds ``at``, are to be played again."""
        since_s = min(since_s, math.nextafter(at, -math.inf))
        self.counts.replayed += int(self._start_s < self._now_s and since_s < self._now_s)
        self._dirty_s = min(self._dirty_s, since_s)

    def _mark(self, at: float) -> None:
        k = bisect_left(self._marks, at)
        if k == len(self._marks) or self._marks[k] != at:
            self._marks.insert(k, at)

    def _go_back(self) -> None:
        k = max(bisect_right(self._snapshots, self._dirty_s, key=_time) - 1, 0)
        del self._snapshots[k + 1 :]
        self._now_s, snapshot = self._snapshots[k]
        self._model.restore(snapshot)

    def _next_end(self) -> float:
        """Where the window that begins now ends: at the next mark, but not too late, unless nothing is there."""
        k = bisect_right(self._marks, self._now_s)
        mark_s = self._marks[k] if k < len(self._marks) else math.inf
        quiet_s = min(mark_s, self._next_event_s()) - self._now_s if mark_s > self._now_s + EMPTY_S[-1] else 0.0
        length_s = next((empty_s for empty_s in EMPTY_S if quiet_s > empty_s), self._order.longest_s)
        return mark_s if mark_s <= self._now_s + (1.0 + SLACK) * length_s else self._now_s + length_s

    def _next_event_s(self) -> float:
        """The time of the first event after now."""
        times = (stream[k][0] for stream in self._streams.values() if (k := _first_after(stream, self._now_s)) >= 0)
        return min(times, default=math.inf)

    def _window(self, end_s: float) -> Window[Event]:
        events: list[tuple[float, str, Event]] = []
        after: dict[Hashable, Event] = {}
        for name, stream in self._streams.items():
            first = bisect_right(stream, self._now_s, key=_time) if self._now_s > self._start_s else 0
            last = bisect_right(stream, end_s, key=_time)
            events += [(at, self._names[name], event) for at, event in stream[first:last]]
            if last < len(stream) and stream[last][0] - self._order.reach_s(stream[last][1]) < end_s:
                after[name] = stream[last][1]
        events.sort(key=_time_and_name)
        return Window(self._now_s, end_s, tuple(event for _, _, event in events), after)

    def _forget(self) -> None:
        """Drop snapshots and events that nothing can reach back to."""
        oldest_s = self._reached_s - 2.0 * self._order.horizon_s
        k = bisect_right(self._snapshots, oldest_s, key=_time) - 1
        if k > 0:
            del self._snapshots[:k]
            kept_s = self._snapshots[0][0] - self._order.horizon_s
            for stream in self._streams.values():
                del stream[: max(0, min(bisect_left(stream, kept_s, key=_time), len(stream) - 1))]
            del self._marks[: bisect_left(self._marks, kept_s)]


def _time(entry: tuple[Any, ...]) -> float:
    return entry[0]


def _time_and_name(entry: tuple[Any, ...]) -> tuple[float, str]:
    return entry[0], entry[1]


def _first_after(stream: list[tuple[float, Any]], at: float) -> int:
    k = bisect_right(stream, at, key=_time)
    return k if k < len(stream) else -1

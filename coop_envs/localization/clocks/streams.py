"""Every event's time on one clock: from times of arrival, or by constant offsets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Protocol

from coop_envs.localization.clocks.alignment import BACK_S, ClockAlignment
from coop_envs.localization.logs.events import Event, PoseSighting, RangeBearing
from coop_envs.localization.result import Happening, Kind

AGREE_S = 0.25
"""Stamps that are never after their arrival, and always come at last so shortly before it, are the host's own."""
EARLY_S = 0.002
REMEMBERED = 8192


class Clock(Protocol):
    """Takes events from their own clocks to one."""

    def align(self, event: Event) -> Event:
        """The event with its time on the common clock."""
        ...


def measured_by(event: Event) -> str:
    """Whose clock an event's time is on."""
    return event.camera if isinstance(event, PoseSighting) else event.robot


class ArrivalClock:
    """Learns each robot's clock from when its events arrive; the common clock is the host's.

    A robot has one clock for all its sensors. Events that others of the robot have overtaken by up to ``late_s`` are
    late; what goes back further was stamped by a clock that began anew, which is noted in ``jumps``. An event gets the
    same time whenever it is asked for: a second copy stays a copy.
    """

    def __init__(self, late_s: float) -> None:
        self.jumps: list[Happening] = []
        self._late_s = late_s
        self._clocks: dict[str, ClockAlignment] = {}
        self._newest_s: dict[str, float] = {}
        self._known: dict[tuple[str, float], float] = {}

    def align(self, event: Event) -> Event:
        """The event with its time on the host's clock; as it is, where it came without a time of arrival."""
        if event.arrival_s is None:
            return event
        key = (measured_by(event), event.time_s)
        if key not in self._known:
            self._known[key] = self._align(key[0], event.time_s, event.arrival_s)
            if len(self._known) > REMEMBERED:
                del self._known[next(iter(self._known))]
        return dataclasses.replace(event, time_s=self._known[key])

    def _align(self, robot: str, time_s: float, arrival_s: float) -> float:
        clock = self._clocks.setdefault(robot, ClockAlignment())
        newest_s = self._newest_s.get(robot, time_s)
        if newest_s - self._late_s <= time_s < newest_s - BACK_S:
            return clock.recall(arrival_s, time_s)
        jumps = clock.jumps
        aligned_s = clock.align(arrival_s, time_s)
        self._newest_s[robot] = time_s
        if clock.jumps > jumps:
            detail = f"from {newest_s:.3f} to {time_s:.3f} s"
            self.jumps.append(Happening(aligned_s, Kind.CLOCK_JUMP, robot, detail))
        return aligned_s


class OffsetClock:
    """Adds a constant to each stream's stamps: ``offset_s`` by the stream's name, as `stream_name` gives it."""

    def __init__(self, offset_s: Mapping[str, float]) -> None:
        self._offset_s = offset_s

    def align(self, event: Event) -> Event:
        """The event with its offset added."""
        offset_s = self._offset_s.get(stream_name(event), 0.0)
        return dataclasses.replace(event, time_s=event.time_s + offset_s) if offset_s else event


def stream_name(event: Event) -> str:
    """Whose stamps: ``imu NAME`` for what a robot feels, odometry and fixes too, ``camera NAME`` for what it sees."""
    if isinstance(event, PoseSighting):
        return f"camera {event.camera}"
    if isinstance(event, RangeBearing):
        return f"camera {event.robot}"
    return f"imu {event.robot}"


def stamps_agree(events: Sequence[Event]) -> bool:
    """Whether all robots stamp with the host's clock, or one that agrees with it, as times of arrival show."""
    delays: dict[str, list[float]] = {}
    for event in events:
        if event.arrival_s is not None:
            delays.setdefault(measured_by(event), []).append(event.arrival_s - event.time_s)
    halves = [part for own in delays.values() for part in (own[: len(own) // 2], own[len(own) // 2 :]) if part]
    return all(-EARLY_S <= min(part) < AGREE_S for part in halves)


def have_arrivals(events: Sequence[Event]) -> bool:
    """Whether anybody noted when events came."""
    return any(event.arrival_s is not None for event in events)

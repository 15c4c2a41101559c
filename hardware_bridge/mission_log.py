"""`MissionLog`: writes a mission's log beside the mission, from a thread of its own.

A tick only encodes and queues; the disk's pace is the writer thread's business. What was queued is with the operating
system `FLUSH_S` later, and outlives the process from then on. When the disk cannot keep up, pictures and arrays, which
replay makes anew, are left out first and counted on ``/events``. Inputs are never left out: a log that would have to do
so, or that the disk refuses, ends there. It says so in one line, keeps its ``.part`` name, and the mission goes on.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import ConfigError, CoopError
from coop_envs.recording import EpisodeWriter, Frame, LogMetadata, WorldPicture
from coop_envs.recording.whole_file import unfinished_path
from hardware_bridge.command import RobotCommand
from hardware_bridge.mission_log_format import (
    ARRAYS,
    EVENTS,
    INPUTS,
    INTERVENTIONS,
    METADATA_NAME,
    SENT,
    TIMING,
    WANTED,
    MissionEvent,
    MissionMetadata,
    TickCommands,
    TickTiming,
    encode_message,
    schema_of,
)
from hardware_bridge.safety.situation import Intervention
from hardware_bridge.tick_inputs import TickInputs

FLUSH_S = 0.25
DRAIN_S = 0.05
CLOSING_S = 10.0
DERIVED_WAITING = 1000
MOST_WAITING = 20_000

_Job = Callable[[EpisodeWriter], None]


class MissionLog:
    """One mission's log; use as a context manager. However the mission ends, an exception included, the log is whole.

    Args:
        path: the log to write, ``.mcap``; until it is whole it has ``.part`` before its suffix.
        metadata: what a replay needs besides the inputs.
        waits: the mission waits for the disk instead of leaving anything out; for simulated time.
        say: where the one line goes that tells of a log that ends early.

    Raises:
        ConfigError: another suffix, or a folder that cannot be written to.
    """

    def __init__(
        self,
        path: str | Path,
        metadata: MissionMetadata,
        *,
        waits: bool = False,
        say: Callable[[str], object] | None = None,
    ) -> None:
        self.path, self._metadata, self._waits = Path(path), metadata, waits
        self._say = say or (lambda line: sys.stderr.write(f"{line}\n"))
        known = LogMetadata("", metadata.seed, metadata.policy, metadata.version, metadata.command)
        self._writer = EpisodeWriter(path, known, keep_unfinished=True)
        self._jobs: deque[_Job] = deque()
        self._dropped = 0
        self._cut: str | None = None
        self._ending = threading.Event()
        self._last_s = 0.0
        self._thread = threading.Thread(target=self._run, name="mission log", daemon=True)

    @property
    def cut(self) -> str | None:
        """Why the log ended before the mission did, None while it has not."""
        return self._cut

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            unfinished_path(self.path).touch()
        except OSError as error:
            raise ConfigError("log", str(self.path), f"a path that can be written to ({error.strerror})") from None
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            text = " ".join(f"{kind.__name__} {error}".split())
            self.write_event(MissionEvent(self._last_s, "mission ended", text))
        self._ending.set()
        self._thread.join(CLOSING_S)
        if self._thread.is_alive():
            self._end(f"the disk has not taken the rest in {CLOSING_S:.0f} s")

    def write_inputs(self, inputs: TickInputs) -> None:
        """Write a tick's inputs, before its commands."""
        self._last_s = inputs.time_s
        self._message(INPUTS, inputs.time_s, inputs)

    def write_commands(
        self, time_s: float, wanted: Mapping[str, RobotCommand], sent: Mapping[str, RobotCommand]
    ) -> None:
        """Write a tick's commands by agent's name, as wanted and as the links say they were sent."""
        self._message(WANTED, time_s, TickCommands(time_s, wanted))
        self._message(SENT, time_s, TickCommands(time_s, sent))

    def write_interventions(self, interventions: Iterable[Intervention]) -> None:
        """Write what the supervisor changed."""
        for one in interventions:
            self._message(INTERVENTIONS, one.time_s, one)

    def write_timing(self, timing: TickTiming) -> None:
        """Write how a tick kept time."""
        self._message(TIMING, timing.time_s, timing)

    def write_event(self, event: MissionEvent) -> None:
        """Write something that happened once."""
        self._message(EVENTS, event.time_s, event)

    def write_arrays(self, topic: str, time_s: float, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write a decision's belief or measurements.

        Raises:
            ConfigError: another topic.
        """
        if topic not in ARRAYS:
            raise ConfigError("topic", topic, f"one of {', '.join(ARRAYS)}")
        copies = {name: np.array(value) for name, value in arrays.items()}
        self._put(lambda log: log.write_arrays(topic, time_s, copies), derived=True)

    def write_frame(self, frame: Frame) -> None:
        """Write what a decision looks like from the side."""
        self._put(lambda log: log.write_frame(frame), derived=True)

    def write_world(self, world: WorldPicture) -> None:
        """Write what is drawn of the world, as far as anyone knows it."""
        self._put(lambda log: log.write_world(world), derived=True)

    def _message(self, topic: str, time_s: float, message: object) -> None:
        data, kind = encode_message(message), type(message)
        schema_name = f"{METADATA_NAME}.{kind.__name__}"
        self._put(lambda log: log.write_json(topic, schema_name, schema_of(kind), time_s, data))

    def _put(self, job: _Job, derived: bool = False) -> None:
        while self._waits and len(self._jobs) >= DERIVED_WAITING and self._cut is None:
            time.sleep(DRAIN_S / 10)
        if self._cut is not None:
            return
        if derived and len(self._jobs) >= DERIVED_WAITING:
            self._dropped += 1
        elif len(self._jobs) >= MOST_WAITING:
            self._end(f"the disk is {MOST_WAITING} messages behind")
        else:
            self._jobs.append(job)

    def _end(self, reason: str) -> None:
        if self._cut is None:
            self._cut = reason
            self._say(f"log: {self.path.name} ends at {self._last_s:.2f} s, the mission goes on: {reason}")

    def _run(self) -> None:
        why = "its writer failed"
        try:
            with self._writer as log:
                log.write_metadata(METADATA_NAME, {key: str(value) for key, value in asdict(self._metadata).items()})
                self._write_all(log)
                if self._cut is not None:
                    raise _CutShort
            why = None
        except _CutShort:
            why = None
        except OSError as error:
            why = os.strerror(error.errno) if error.errno else str(error)
        finally:
            if why is not None:
                self._end(why)
            self._jobs.clear()

    def _write_all(self, log: EpisodeWriter) -> None:
        """Write what is queued until the mission ends or the log is cut, then the rest."""
        log.flush()
        flushed, ending = time.monotonic(), False
        while not ending:
            ending = self._ending.wait(DRAIN_S) or self._cut is not None
            while self._jobs:
                self._write(log, self._jobs.popleft())
            self._tell_of_dropped(log)
            if time.monotonic() - flushed >= FLUSH_S:
                log.flush()
                flushed = time.monotonic()

    def _write(self, log: EpisodeWriter, job: _Job) -> None:
        try:
            job(log)
        except CoopError as error:
            self._say(f"log: {error}")

    def _tell_of_dropped(self, log: EpisodeWriter) -> None:
        count, self._dropped = self._dropped, 0
        if count:
            text = f"the disk was behind: {count} pictures and arrays are left out, no inputs"
            event = MissionEvent(self._last_s, "log", text)
            schema_name = f"{METADATA_NAME}.{MissionEvent.__name__}"
            log.write_json(EVENTS, schema_name, schema_of(MissionEvent), event.time_s, encode_message(event))


class _CutShort(Exception):  # noqa: N818 - not an error: keeps the log's unfinished name
    """The log ended before the mission."""

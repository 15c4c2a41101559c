"""`MissionReader`: a mission's log, whole or cut short, as the dataclasses that were written, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from numpy.typing import NDArray
from pydantic import ValidationError

from coop_envs.errors import ConfigError
from coop_envs.recording import EpisodeReader, Frame
from coop_envs.recording.whole_file import unfinished_path
from coop_envs.validation import validated
from hardware_bridge.command import RobotCommand
from hardware_bridge.mission_log_format import (
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
    adapter,
)
from hardware_bridge.safety.situation import Intervention
from hardware_bridge.tick_inputs import TickInputs

T = TypeVar("T")


@dataclass(frozen=True)
class RecordedTick:
    """A tick's inputs and its commands by agent's name; None for commands that a kill came before."""

    inputs: TickInputs
    wanted: dict[str, RobotCommand] | None = None
    sent: dict[str, RobotCommand] | None = None


class MissionReader:
    """Reads a mission's log; ``note`` says if it was cut short, and is None for a whole one.

    Each method reads the file anew.

    Raises:
        ConfigError: no such file, no MCAP file, or not a mission's log.
    """

    def __init__(self, path: str | Path) -> None:
        self._path, self._reader = Path(path), EpisodeReader(path)
        values: dict[str, Any] = dict(self._reader.metadata_record(METADATA_NAME))
        if not values:
            raise ConfigError("log", str(path), "a mission's log (coop deploy, coop play), not an episode's")
        self.metadata: MissionMetadata = validated(MissionMetadata, values, "log.metadata")

    @property
    def note(self) -> str | None:
        """What is wrong with the log, as far as it has been read."""
        stem = self._path.stem.removesuffix(".part")
        unfinished = unfinished_path(self._path.with_stem(stem)) == self._path
        return self._reader.note or (f"{self._path.name} ends before its mission" if unfinished else None)

    def ticks(self) -> Iterator[RecordedTick]:
        """Every tick, in order."""
        tick: RecordedTick | None = None
        for topic, message in self._reader.messages(INPUTS, WANTED, SENT):
            if topic == INPUTS:
                if tick is not None:
                    yield tick
                tick = RecordedTick(self._made(TickInputs, message))
            elif tick is not None:
                robots = dict(self._made(TickCommands, message).robots)
                tick = replace(tick, wanted=robots) if topic == WANTED else replace(tick, sent=robots)
        if tick is not None:
            yield tick

    def interventions(self) -> Iterator[Intervention]:
        """What the supervisor changed."""
        return self._all(INTERVENTIONS, Intervention)

    def events(self) -> Iterator[MissionEvent]:
        """What happened once."""
        return self._all(EVENTS, MissionEvent)

    def timings(self) -> Iterator[TickTiming]:
        """How every tick kept time."""
        return self._all(TIMING, TickTiming)

    def arrays(self, topic: str) -> Iterator[tuple[float, dict[str, NDArray[Any]]]]:
        """Time and arrays of every decision on a topic, as written."""
        return self._reader.arrays(topic)

    def frames(self) -> Iterator[Frame]:
        """What the decisions looked like."""
        return self._reader.frames()

    def _all(self, topic: str, kind: type[T]) -> Iterator[T]:
        for _, message in self._reader.messages(topic):
            yield self._made(kind, message)

    def _made(self, kind: type[T], message: Any) -> T:
        try:
            return adapter(kind).validate_python(message)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            field = ".".join(str(part) for part in first["loc"])
            raise ConfigError(f"log.{kind.__name__}.{field}", first["input"], first["msg"].lower()) from None

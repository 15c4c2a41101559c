"""Writing episode logs: under a ``.part`` name, renamed when complete, readable up to the last second if cut short."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import ConfigError
from coop_envs.recording.frame import Frame, WorldPicture, frame_to_arrays, world_to_arrays
from coop_envs.recording.json_arrays import encode_array, plain_numbers
from coop_envs.recording.log_format import (
    APART,
    ARRAYS_SCHEMA,
    FRAME,
    FRAME_SCHEMA,
    MAP,
    MAP_FIELDS,
    METADATA_NAME,
    POINT_FIELDS,
    POINTS,
    VOLUME,
    VOLUME_FIELDS,
    WORLD,
    LogMetadata,
)
from coop_envs.recording.whole_file import written_whole

if TYPE_CHECKING:
    from mcap.writer import Writer


OWN = (WORLD, FRAME, MAP, POINTS, VOLUME)


class EpisodeWriter(AbstractContextManager["EpisodeWriter"]):
    """Writes one episode's log; use as a context manager.

    On an exception inside the ``with`` block the log is removed, or, with ``keep_unfinished``, left under its
    ``.part`` name (a robot's log is worth most when things went wrong).

    Args:
        path: the log to write, ``.mcap``.
        metadata: what identifies the episode.
        map_period_s: maps are written this often, and all so far is made readable.
        keep_unfinished: keep what was written before an exception.

    Raises:
        ConfigError: another suffix.
    """

    def __init__(
        self, path: str | Path, metadata: LogMetadata, *, map_period_s: float = 1.0, keep_unfinished: bool = False
    ) -> None:
        if Path(path).suffix != ".mcap":
            raise ConfigError("log", str(path), "a path that ends in .mcap")
        self._metadata, self._map_period_s = metadata, map_period_s
        self._file = written_whole(path, keep_unfinished)
        self._channels: dict[str, int] = {}
        self._map_due_s = -math.inf
        self._last: Frame | None = None
        self._map_is_old = False
        self._last_frame_s = -math.inf

    def __enter__(self) -> Self:
        from mcap.writer import Writer

        with ExitStack() as stack:
            stream = stack.enter_context(stack.enter_context(self._file).open("wb"))
            self._writer: Writer = Writer(stream)
            self._writer.start(profile="", library="coop_envs")
            values = {name: str(value) for name, value in asdict(self._metadata).items()}
            self._writer.add_metadata(METADATA_NAME, values)
            stack.callback(self._finish)
            self._open = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        return self._open.__exit__(kind, error, trace)

    def write_world(self, world: WorldPicture) -> None:
        """Write what is drawn of the world, before the first frame."""
        arrays = {name: encode_array(value, compress=True) for name, value in world_to_arrays(world).items()}
        self._add(WORLD, "coop_envs.WorldPicture", ARRAYS_SCHEMA, 0.0, {"time_s": 0.0, "arrays": arrays})

    def write_frame(self, frame: Frame) -> None:
        """Write a frame and its points; its maps too, if the last ones are ``map_period_s`` old.

        Raises:
            ConfigError: a time before the last frame's.
        """
        if frame.time_s < self._last_frame_s:
            raise ConfigError("frame.time_s", frame.time_s, f"{self._last_frame_s} s or later")
        self._last_frame_s = frame.time_s
        self._last, self._map_is_old = frame, True
        if frame.time_s >= self._map_due_s:
            self._writer.flush()
            self._write_part(MAP, "coop_envs.Map", frame, MAP_FIELDS)
            self._map_is_old = False
            self._map_due_s = frame.time_s + self._map_period_s
        if len(frame.scan):
            self._write_part(POINTS, "coop_envs.Points", frame, POINT_FIELDS)
        arrays = frame_to_arrays(frame)
        message = {name: plain_numbers(arrays[name].tolist()) for name in arrays if name not in APART}
        self._add(FRAME, "coop_envs.Frame", FRAME_SCHEMA, frame.time_s, message)

    def write_arrays(self, topic: str, time_s: float, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write named arrays bit-exactly on a topic of their own.

        Raises:
            ConfigError: a topic of world or frames, or an array of objects.
        """
        if topic in OWN:
            raise ConfigError("topic", topic, f"another topic than {', '.join(OWN)}")
        encoded = {name: encode_array(value) for name, value in arrays.items()}
        self._add(topic, "coop_envs.Arrays", ARRAYS_SCHEMA, time_s, {"time_s": float(time_s), "arrays": encoded})

    def write_json(self, topic: str, schema_name: str, schema: dict[str, Any], time_s: float, message: bytes) -> None:
        """Write one JSON object, encoded already, on a topic of its own.

        Raises:
            ConfigError: a topic of world or frames.
        """
        if topic in OWN:
            raise ConfigError("topic", topic, f"another topic than {', '.join(OWN)}")
        self._add_encoded(topic, schema_name, schema, time_s, message)

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record besides the episode's own."""
        self._writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """Hand all so far to the operating system: it outlives this process, however that ends."""
        self._writer.flush()

    def _write_part(self, topic: str, schema_name: str, frame: Frame, names: tuple[str, ...]) -> None:
        encoded = {name: encode_array(np.asarray(getattr(frame, name)), compress=True) for name in names}
        self._add(topic, schema_name, ARRAYS_SCHEMA, frame.time_s, {"time_s": frame.time_s, "arrays": encoded})

    def _add(self, topic: str, schema_name: str, schema: dict[str, Any], time_s: float, message: Any) -> None:
        data = json.dumps(message, allow_nan=False, separators=(",", ":")).encode()
        self._add_encoded(topic, schema_name, schema, time_s, data)

    def _add_encoded(self, topic: str, schema_name: str, schema: dict[str, Any], time_s: float, data: bytes) -> None:
        time_ns = round(time_s * 1e9)
        if topic not in self._channels:
            schema_id = self._writer.register_schema(schema_name, "jsonschema", json.dumps(schema).encode())
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        self._writer.add_message(self._channels[topic], log_time=time_ns, publish_time=time_ns, data=data)

    def _finish(self) -> None:
        if self._last is not None and self._map_is_old:
            self._write_part(MAP, "coop_envs.Map", self._last, MAP_FIELDS)
        if self._last is not None and len(self._last.map_volume):
            self._write_part(VOLUME, "coop_envs.Volume", self._last, VOLUME_FIELDS)
        self._writer.finish()

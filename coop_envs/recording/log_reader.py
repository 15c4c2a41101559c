"""Reading episode logs, whole or cut short."""

from __future__ import annotations

import itertools
import json
from collections import ChainMap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from coop_envs.errors import ConfigError
from coop_envs.recording.frame import Frame, WorldPicture, frame_from_arrays, world_from_arrays
from coop_envs.recording.json_arrays import decode_array
from coop_envs.recording.log_format import (
    FRAME,
    MAP,
    MEASUREMENTS,
    METADATA_NAME,
    POINTS,
    VOLUME,
    WORLD,
    LogMetadata,
)
from coop_envs.recording.mcap_records import ends_well, mcap_records

if TYPE_CHECKING:
    from mcap.records import McapRecord


class EpisodeReader:
    """Reads an episode's log, also one that was cut short: then up to the cut, and ``note`` says so.

    ``note`` is None for a complete log. Each method reads the file anew.

    Raises:
        ConfigError: no such file, no MCAP file, or one without this package's metadata.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        if not self._path.is_file():
            raise ConfigError("log", str(path), "an existing episode log (.mcap)")
        self.note: str | None = None
        if not ends_well(self._path):
            self._note_cut()
        self.metadata = self._read_metadata()

    def world(self) -> WorldPicture | None:
        """What is drawn of the world, None if the log holds none."""
        message = next((message for _, _, message in self._messages(WORLD)), None)
        return None if message is None else world_from_arrays(_decode(message))

    def frames(self) -> Iterator[Frame]:
        """The frames in order of time, each with its points and the latest maps written up to its time.

        The last frame alone has the volume.
        """
        maps: dict[str, NDArray[Any]] = {}
        for _, group in itertools.groupby(self._messages(FRAME, MAP, POINTS, VOLUME), key=lambda item: item[0]):
            messages = {topic: message for _, topic, message in group}
            if MAP in messages:
                maps = _decode(messages[MAP])
            if FRAME in messages:
                own = [_decode(messages[topic]) for topic in (POINTS, VOLUME) if topic in messages]
                yield frame_from_arrays(dict(ChainMap(messages[FRAME], maps, *own)))

    def arrays(self, topic: str = MEASUREMENTS) -> Iterator[tuple[float, dict[str, NDArray[Any]]]]:
        """Time in seconds and named arrays, bit for bit as written."""
        for _, _, message in self._messages(topic):
            yield message["time_s"], _decode(message)

    def messages(self, *topics: str) -> Iterator[tuple[str, Any]]:
        """Topic and JSON object of every message on these topics, in the order written."""
        for _, topic, message in self._messages(*topics):
            yield topic, message

    def metadata_record(self, name: str) -> dict[str, str]:
        """The values of a metadata record besides the episode's own, empty if the log holds none of that name."""
        from mcap.records import Metadata

        for record in self._records():
            if isinstance(record, Metadata) and record.name == name:
                return dict(record.metadata)
        return {}

    def _note_cut(self) -> None:
        self.note = f"{self._path.name} was cut short or damaged: read up to there"

    def _read_metadata(self) -> LogMetadata:
        from mcap.records import Metadata

        for record in self._records():
            if isinstance(record, Metadata) and record.name == METADATA_NAME:
                text = dict(record.metadata)
                return LogMetadata(seed=int(text.pop("seed")), **text)
        raise ConfigError("log", str(self._path), f"an MCAP file with a metadata record named {METADATA_NAME}")

    def _messages(self, *topics: str) -> Iterator[tuple[int, str, Any]]:
        """(log time in ns, topic, JSON message) of the messages on these topics, in the order written."""
        from mcap.records import Channel, Message

        wanted: dict[int, str] = {}
        for record in self._records():
            if isinstance(record, Channel) and record.topic in topics:
                wanted[record.id] = record.topic
            elif isinstance(record, Message) and record.channel_id in wanted:
                yield record.log_time, wanted[record.channel_id], json.loads(record.data)

    def _records(self) -> Iterator[McapRecord]:
        """All records up to the first that cannot be read."""
        return mcap_records(self._path, self._note_cut)


def _decode(message: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    return {name: decode_array(value) for name, value in message["arrays"].items()}

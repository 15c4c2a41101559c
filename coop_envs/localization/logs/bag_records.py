"""The messages of a ROS 1 bag, read from front to back, so that a bag without its end gives what it holds.

Source: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from coop_envs.errors import ConfigError

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, CHUNK, CONNECTION = 2, 3, 5, 7
LONGEST_HEADER = 1 << 20
"""Longer ones are garbage in place of a length."""

Header = dict[str, bytes]


class DamagedError(Exception):
    """Bytes that are no record."""


@dataclass(frozen=True)
class Connection:
    """Where a bag's message came from: its topic, the type's name and checksum."""

    topic: str
    kind: str
    checksum: str


@dataclass(frozen=True, eq=False)
class BagMessage:
    """One message, still serialised, and when it was recorded."""

    connection: Connection
    recorded_s: float
    data: bytes


class BagFile:
    """A ROS 1 bag; once its `messages` are through, ``notes`` say what it lacks.

    Raises:
        ConfigError: no bag of version 2.0.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._connections: dict[int, Connection] = {}
        self._notes: dict[str, None] = {}
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise ConfigError("log", str(path), "a ROS bag of version 2.0")

    @property
    def notes(self) -> list[str]:
        return list(self._notes)

    @property
    def topics(self) -> dict[str, str]:
        """Type by topic, of those that came up so far."""
        return {connection.topic: connection.kind for connection in self._connections.values()}

    def messages(self, wanted: Callable[[str], bool]) -> Iterator[BagMessage]:
        """The messages on the topics that are wanted, in the order in which they stand in the file."""
        with self._path.open("rb") as stream:
            stream.seek(len(MAGIC))
            for header, data, whole in self._file_records(stream):
                if _code(header) == CHUNK:
                    yield from self._in_chunk(header, data, whole, wanted)
                elif whole:
                    yield from self._take(header, data, wanted)

    def _file_records(self, stream: BinaryIO) -> Iterator[tuple[Header, bytes, bool]]:
        size = self._path.stat().st_size
        try:
            for header, data, whole in _records(stream, size):
                if _code(header) == BAG_HEADER:
                    self._look_for_index(header, size)
                yield header, data, whole
                if not whole:
                    self._note("was cut short: read up to there")
        except DamagedError:
            self._note("was cut short or damaged: read up to there")

    def _look_for_index(self, header: Header, size: int) -> None:
        position = int.from_bytes(header.get("index_pos", b""), "little")
        if position == 0:
            self._note("has no index, its recorder was not ended properly: read from front to back")
        elif position > size:
            self._note("was cut short: read up to there")

    def _in_chunk(
        self, header: Header, data: bytes, whole: bool, wanted: Callable[[str], bool]
    ) -> Iterator[BagMessage]:
        opened = _decompressed(header, data)
        if whole and len(opened) < int.from_bytes(header.get("size", b""), "little"):
            self._note("has a part that cannot be decompressed: read up to there")
        try:
            for inner, content, complete in _records(BytesIO(opened), len(opened)):
                if complete:
                    yield from self._take(inner, content, wanted)
        except DamagedError:
            if whole:
                self._note("has a damaged part: read up to there")

    def _take(self, header: Header, data: bytes, wanted: Callable[[str], bool]) -> Iterator[BagMessage]:
        number = int.from_bytes(header.get("conn", b""), "little")
        if _code(header) == CONNECTION:
            try:
                fields = _fields(data)
            except DamagedError:
                self._note("has a damaged connection: left out")
                return
            texts = (header.get("topic", b""), fields.get("type", b""), fields.get("md5sum", b""))
            self._connections[number] = Connection(*(text.decode("utf-8", "replace") for text in texts))
        elif _code(header) == MESSAGE:
            time = header.get("time", b"")
            connection = self._connections.get(number)
            if connection is None or len(time) != 8:
                self._note("has messages of which nobody knows whose they are: left out")
            elif wanted(connection.topic):
                yield BagMessage(connection, seconds(*struct.unpack("<II", time)), data)

    def _note(self, what: str) -> None:
        self._notes[f"{self._path.name} {what}"] = None


def seconds(whole: int, nanoseconds: int) -> float:
    """ROS's two numbers as one."""
    return whole + nanoseconds * 1e-9


def _records(stream: BinaryIO, size: int) -> Iterator[tuple[Header, bytes, bool]]:
    """Header, data and whether these are all of a record's data, from here to the stream's end (``size``).

    Raises:
        DamagedError: what comes next is no record.
    """
    while stream.tell() < size:
        length = _length(stream)
        if length > min(LONGEST_HEADER, size - stream.tell()):
            raise DamagedError
        header = _fields(stream.read(length))
        expected = _length(stream)
        data = stream.read(min(expected, size - stream.tell()))
        yield header, data, len(data) == expected


def _length(stream: BinaryIO) -> int:
    four = stream.read(4)
    if len(four) < 4:
        raise DamagedError
    return int.from_bytes(four, "little")


def _fields(data: bytes) -> Header:
    """The fields ``name=value`` of a header.

    Raises:
        DamagedError: there are none.
    """
    found: Header = {}
    at = 0
    while at < len(data):
        end = at + 4 + int.from_bytes(data[at : at + 4], "little")
        name, equals, value = data[at + 4 : end].partition(b"=")
        if end > len(data) or not equals:
            raise DamagedError
        found[name.decode("latin-1")] = value
        at = end
    return found


def _code(header: Header) -> int:
    return int.from_bytes(header.get("op", b""), "little")


def _decompressed(header: Header, data: bytes) -> bytes:
    """A chunk's records, as far as its bytes can be decompressed, at most as many as it says."""
    size = int.from_bytes(header.get("size", b""), "little")
    compression = header.get("compression", b"none")
    if compression == b"none":
        return data
    out = bytearray()
    try:
        decompress = _decompressor(compression)
        for start in range(0, len(data), 4096):
            if len(out) < size:
                out += decompress(data[start : start + 4096])
    except (OSError, RuntimeError, EOFError, DamagedError):
        pass
    return bytes(out[:size])


def _decompressor(compression: bytes) -> Callable[[bytes], bytes]:
    if compression == b"bz2":
        return bz2.BZ2Decompressor().decompress
    if compression == b"lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameDecompressor().decompress
    raise DamagedError

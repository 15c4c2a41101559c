"""A log as a ROS 1 bag of standard messages; `bag_topics` says on which topics.

``header.stamp`` is when something was measured, the time of recording is its arrival.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.assembly import assemble
from coop_envs.localization.logs.bag_messages import READERS, Row, row_of
from coop_envs.localization.logs.bag_records import BagFile, BagMessage, seconds
from coop_envs.localization.logs.bag_topics import Source, Topics
from coop_envs.localization.logs.columns import ARRIVAL, KINDS, TRUTH, Kind, RawRows
from coop_envs.localization.logs.events import Log
from coop_envs.localization.logs.team_file import LogTeam, TeamReference, read_team

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


def read_bag(path: Path, team: TeamReference | None = None) -> Log:
    """The log in a ROS 1 bag, as far as it can be read; ``notes`` say what is missing.

    Raises:
        ConfigError: messages that cannot be used, or no bag of version 2.0.
    """
    who = LogTeam() if team is None else read_team(team)
    bag, topics = BagFile(path), Topics(who.topics)
    reader = _Reader(path.name)
    for message in bag.messages(lambda topic: topics.source(topic) is not None):
        source = topics.source(message.connection.topic)
        assert source is not None
        reader.add(message, source)
    notes = [*bag.notes, *reader.notes()]
    unread = sorted(topic for topic in bag.topics if topics.source(topic) is None)
    if unread:
        notes.append(f"{path.name}: topics not read: {', '.join(unread)}")
    return assemble(path.name, reader.rows(), who, notes)


class _Reader:
    """Messages in, rows of every kind out."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._types = _Types()
        self._rows: dict[str, list[tuple[float, str, Row]]] = defaultdict(list)
        self._counts: dict[str, int] = defaultdict(int)
        self._unstamped: dict[str, int] = defaultdict(int)
        self._unfit: dict[str, str] = {}

    def add(self, message: BagMessage, source: Source) -> None:
        connection = message.connection
        self._counts[connection.topic] += 1
        place = f"{self._name} message {self._counts[connection.topic]} on {connection.topic}"
        if connection.kind not in READERS[source.kind]:
            readable = ", ".join(READERS[source.kind])
            self._unfit[connection.topic] = f"{connection.kind} is not read as {source.kind}, {readable} are"
            return
        parsed = self._types.parsed(message, place)
        row = row_of(parsed, source.kind, source, place) | {**source.names, "time_s": message.recorded_s}
        stamp = getattr(getattr(parsed, "header", None), "stamp", None)
        if stamp is not None and (stamp.sec or stamp.nanosec):
            row["time_s"] = seconds(stamp.sec, stamp.nanosec)
        else:
            self._unstamped[connection.topic] += 1
        if ARRIVAL in KINDS[source.kind].optional:
            row[ARRIVAL] = message.recorded_s
        self._rows[source.kind].append((message.recorded_s, place, row))

    def rows(self) -> list[RawRows]:
        """Rows by kind, in the order of recording; truth in that of its stamps."""
        return [_raw(KINDS[kind], rows) for kind, rows in self._rows.items()]

    def notes(self) -> list[str]:
        unstamped = [
            f"{self._name}: messages on {topic} without a stamp: {count}, taken as measured when recorded"
            for topic, count in self._unstamped.items()
        ]
        return unstamped + [f"{self._name}: {topic}: {why}" for topic, why in self._unfit.items()]


def _raw(kind: Kind, rows: list[tuple[float, str, Row]]) -> RawRows:
    ordered = sorted(rows, key=lambda item: item[2]["time_s"] if kind is TRUTH else item[0])
    columns = dict.fromkeys(name for _, _, row in ordered for name in row)
    cells = {name: [row.get(name) for _, _, row in ordered] for name in columns}
    return RawRows(kind, cells, lambda i: ordered[i][1])


class _Types:
    """Standard ROS 1 messages from bytes."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._store: Typestore = get_typestore(Stores.ROS1_NOETIC)
        self._checksums: dict[str, str] = {}

    def parsed(self, message: BagMessage, place: str) -> Any:
        """The message; raises `ConfigError` where its bytes are not of its type."""
        from rosbags.serde import SerdeError

        connection = message.connection
        name = connection.kind.replace("/", "/msg/")
        if name not in self._checksums:
            self._checksums[name] = self._store.generate_msgdef(name, ros_version=1)[1]
        if connection.checksum not in ("*", self._checksums[name]):
            expected = f"{self._checksums[name]}, the standard {connection.kind}"
            raise ConfigError(f"{place}, md5sum", connection.checksum, expected)
        try:
            return self._store.deserialize_ros1(message.data, name)
        except (SerdeError, struct.error, ValueError, IndexError) as error:
            raise ConfigError(place, str(error), f"a message {connection.kind}") from None

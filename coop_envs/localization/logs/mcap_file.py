"""A log as one MCAP file: a channel for each kind of row, JSON messages with the columns of the CSV files.

The team file stands in a metadata record. Messages are stamped with their arrival, or with the time of measurement
where nobody noted one.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.assembly import assemble
from coop_envs.localization.logs.columns import ARRIVAL, KINDS, LANDMARKS, TRUTH, Kind, RawRows, check_columns
from coop_envs.localization.logs.events import Log
from coop_envs.localization.logs.rows import Row, event_kind, event_row, log_rows
from coop_envs.localization.logs.team_file import LogTeam, TeamReference, read_team, read_team_text, team_text
from coop_envs.recording.log_format import METADATA_NAME as EPISODE
from coop_envs.recording.mcap_records import ends_well, mcap_records
from coop_envs.recording.whole_file import written_whole

if TYPE_CHECKING:
    from mcap.writer import Writer

METADATA_NAME = "coop_envs.log"
TEAM = "team.yaml"
LAST_NS = 2**64 - 1
CHUNK_BYTES = 2**16
"""A file that is cut short loses the last chunk."""


def read_mcap(path: Path, team: TeamReference | None = None) -> Log:
    """The log in an MCAP file, up to where it was cut short; ``team`` takes the place of the one in the file.

    Raises:
        ConfigError: rows that cannot be used, or another thing than a log.
    """
    from mcap.records import Channel, Message, Metadata

    notes: list[str] = []
    cut = f"{path.name} was cut short or damaged: read up to there"
    if not ends_well(path):
        notes.append(cut)
    rows: dict[str, list[Any]] = {}
    kinds: dict[int, str] = {}
    unread: set[str] = set()
    own: str | None = None
    for record in mcap_records(path, lambda: notes.append(cut)):
        if isinstance(record, Message) and record.channel_id in kinds:
            rows.setdefault(kinds[record.channel_id], []).append(record.data)
        elif isinstance(record, Channel):
            kind = record.topic.removeprefix("/")
            if kind in KINDS and record.message_encoding == "json":
                kinds[record.id] = kind
            else:
                unread.add(record.topic)
        elif isinstance(record, Metadata) and record.name == METADATA_NAME:
            own = record.metadata.get(TEAM)
        elif isinstance(record, Metadata) and record.name == EPISODE:
            raise ConfigError("log", str(path), "a log of events, not the record of an episode")
    if unread:
        notes.append(f"{path.name}: channels not read: {', '.join(sorted(unread))}")
    who = _team(path, team, own)
    return assemble(
        path.name,
        (_raw(path, KINDS[kind], rows[kind]) for kind in KINDS if kind in rows),
        who,
        list(dict.fromkeys(notes)),
    )


def _team(path: Path, given: TeamReference | None, own: str | None) -> LogTeam | None:
    if given is not None:
        return read_team(given)
    return None if own is None else read_team_text(own, f"{path.name} {TEAM}")


def _raw(path: Path, kind: Kind, messages: list[bytes]) -> RawRows:
    def place(i: int) -> str:
        return f"{path.name} message {i + 1} on /{kind.name}"

    rows = [_object(message, place(i)) for i, message in enumerate(messages)]
    names: dict[str, int] = {}
    for i, row in enumerate(rows):
        if not row.keys() <= names.keys():
            names |= {name: i for name in row if name not in names}
    for name, i in names.items():
        if name not in kind.columns:
            check_columns(kind, [name], place(i))
    check_columns(kind, list(names), f"{path.name} on /{kind.name}")
    return RawRows(kind, {name: [row.get(name) for row in rows] for name in names}, place)


def _object(message: bytes, place: str) -> Row:
    try:
        row = json.loads(message)
    except (ValueError, RecursionError):
        row = message
    if not isinstance(row, dict):
        raise ConfigError(place, row, "a JSON object")
    return row


def write_mcap(path: Path, log: Log) -> None:
    """Write a log as an MCAP file that appears whole or not at all."""
    from mcap.writer import Writer

    with written_whole(path) as part, part.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES)
        writer.start(profile="", library="coop_envs")
        writer.add_metadata(METADATA_NAME, {TEAM: team_text(log.team, log.robots, log.starts)})
        channels: dict[str, int] = {}
        for kind, row in _rows(log):
            if kind not in channels:
                channels[kind] = _channel(writer, KINDS[kind])
            measured, heard = row.get("time_s", 0.0), row.get(ARRIVAL, row.get("time_s", 0.0))
            data = json.dumps(row, allow_nan=False, separators=(",", ":")).encode()
            writer.add_message(channels[kind], log_time=_ns(heard), publish_time=_ns(measured), data=data)
        writer.finish()


def _rows(log: Log) -> Iterable[tuple[str, Row]]:
    for event in log.events:
        yield event_kind(event), event_row(event)
    rest = log_rows(Log(log.robots, (), landmarks=log.landmarks, truth=log.truth))
    for kind in (LANDMARKS.name, TRUTH.name):
        yield from ((kind, row) for row in rest.get(kind, ()))


def _channel(writer: Writer, kind: Kind) -> int:
    schema_id = writer.register_schema(f"coop_envs.{kind.name}", "jsonschema", json.dumps(json_schema(kind)).encode())
    return writer.register_channel(f"/{kind.name}", "json", schema_id)


def json_schema(kind: Kind) -> dict[str, Any]:
    """The JSON schema of a kind's messages."""
    types = {name: {"type": "string" if name in kind.texts else "number"} for name in kind.columns}
    return {"type": "object", "properties": types, "required": [*kind.texts, *kind.numbers]}


def _ns(time_s: float) -> int:
    """Nanoseconds as MCAP counts them; the row itself has the time in full."""
    return min(max(round(time_s * 1e9), 0), LAST_NS)

"""What a mission's log holds besides an episode's: raw inputs and commands of every tick, as JSON with its schema.

Stamped with the host's clock, on these topics:

- ``/inputs`` every tick: the `TickInputs`, all that a replay needs.
- ``/commands_wanted``, ``/commands_sent`` every tick: by agent's name, before the supervisor, and after the links'
  clipping and quantising.
- ``/interventions``: what the supervisor changed and why; ``/events``: robots and links that left, and the like.
- ``/timing`` every tick: `TickTiming`.
- ``/belief``, ``/measurements`` every decision: arrays, bit for bit.
- ``/frame``, ``/map``, ``/points``, ``/volume``, ``/world``: as in an episode's log, so that its tools draw missions.

Floats are written with as many digits as it takes to read the same bits; those that JSON has no number for are the
strings "NaN", "Infinity", "-Infinity" (of a NaN that is no array's, only that it is one is kept).
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter
from pydantic_core import to_json

from coop_envs.recording.log_format import MEASUREMENTS
from hardware_bridge.command import RobotCommand

INPUTS, WANTED, SENT = "/inputs", "/commands_wanted", "/commands_sent"
INTERVENTIONS, EVENTS, TIMING = "/interventions", "/events", "/timing"
BELIEF = "/belief"
ARRAYS = (BELIEF, MEASUREMENTS)
METADATA_NAME = "hardware_bridge"


@dataclass(frozen=True)
class MissionMetadata:
    """What a replay needs besides the inputs and the policy's file.

    ``team`` is the team file's text, ``policy`` the name or path that was asked for, ``policy_sha256`` the digest of
    its file, empty for a policy that has a name; ``started`` is the wall clock's stamp at the start, ISO 8601.
    ``settings`` is whatever else the runner was told, as text.
    """

    team: str
    policy: str
    seed: int
    version: str
    started: str
    policy_sha256: str = ""
    command: str = ""
    settings: str = ""


@dataclass(frozen=True)
class TickCommands:
    """Commands of one tick by agent's name; of those sent, a robot whose link failed is absent."""

    time_s: float
    robots: Mapping[str, RobotCommand] = field(default_factory=dict)


@dataclass(frozen=True)
class TickTiming:
    """How one tick kept time.

    ``late_s`` is how long after it was due the tick began (its jitter), ``busy_s`` how long it took;
    ``measurement_to_command_s`` is from the arrival of the newest measurement that it used to its commands' leaving,
    None in a tick without any.
    """

    time_s: float
    late_s: float
    busy_s: float
    measurement_to_command_s: float | None = None


@dataclass(frozen=True)
class MissionEvent:
    """Something that happened once: ``kind`` in a word or two, ``text`` in a line; ``robot`` is empty for the team."""

    time_s: float
    kind: str
    text: str
    robot: str = ""


def encode_message(message: object) -> bytes:
    """A dataclass as JSON; numbers of numpy become plain ones of the same value."""
    return to_json(message, inf_nan_mode="strings", fallback=_plain_value)


@functools.cache
def adapter(kind: type[Any]) -> TypeAdapter[Any]:
    """What makes a dataclass of a JSON object."""
    return TypeAdapter(kind)


@functools.cache
def schema_of(kind: type[Any]) -> dict[str, Any]:
    """A dataclass's JSON schema, without references and defaults: plotting tools know few of JSON schema's ways."""
    schema = adapter(kind).json_schema()
    return _plain(schema, schema.get("$defs", {}))


def _plain_value(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else value.tolist()


def _plain(node: Any, definitions: Mapping[str, Any]) -> Any:
    if isinstance(node, list):
        return [_plain(item, definitions) for item in node]
    if not isinstance(node, dict):
        return node
    if "$ref" in node:
        return _plain(definitions[node["$ref"].rpartition("/")[2]], definitions)
    dropped = {"$defs", "default", "title", "required"}
    kept = {key: value for key, value in node.items() if key not in dropped}
    if "properties" in kept:
        kept["properties"] = {name: _plain(value, definitions) for name, value in kept["properties"].items()}
    return {key: value if key == "properties" else _plain(value, definitions) for key, value in kept.items()}

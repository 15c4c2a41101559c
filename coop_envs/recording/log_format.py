"""What an episode log holds: an MCAP file with JSON messages, for this package and for standard tools (Foxglove).

Channels, each with its JSON schema, stamped with the episode's time:

- ``/world`` once: the `WorldPicture`.
- ``/frame`` at every decision: the `Frame` without its maps, plain numbers that can be plotted.
- ``/map`` about once a second and at the end: the belief's maps.
- any other topic: a dict of arrays, bit-exact (raw measurements go to ``/measurements``).

What identifies the episode stands in an MCAP metadata record.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from coop_envs.recording.frame import Frame
from coop_envs.recording.json_arrays import ARRAY_SCHEMA

WORLD, FRAME, MAP, MEASUREMENTS = "/world", "/frame", "/map", "/measurements"
MAP_FIELDS = ("map_ground", "map_obstacle", "T_world_map", "cell_m")
METADATA_NAME = "coop_envs"
MAGIC = b"\x89MCAP0\r\n"


@dataclass(frozen=True)
class LogMetadata:
    """What identifies a recorded episode; ``scenario`` is the scenario as YAML text."""

    scenario: str
    seed: int
    policy: str
    version: str
    command: str = ""


def frame_schema() -> dict[str, Any]:
    """JSON schema of a `Frame` without its maps: arrays nested as their axes, row by row."""
    items = {"names": "string", "role": "string", "stationary": "boolean", "sees": "boolean"}
    properties: dict[str, Any] = {}
    for field in dataclasses.fields(Frame):
        if field.name in MAP_FIELDS:
            continue
        schema: dict[str, Any] = {"type": items.get(field.name, "number")}
        for _ in ("n",) if field.name in ("names", "role") else Frame.axes(field.name):
            schema = {"type": "array", "items": schema}
        properties[field.name] = schema
    return {"type": "object", "properties": properties}


FRAME_SCHEMA = frame_schema()
ARRAYS_SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "time_s": {"type": "number"},
        "arrays": {"type": "object", "additionalProperties": ARRAY_SCHEMA},
    },
    "required": ["time_s", "arrays"],
}

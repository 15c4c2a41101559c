"""What an episode log holds: an MCAP file with JSON messages, for this package and for standard tools (Foxglove).

Channels, each with its JSON schema, stamped with the episode's time:

- ``/world`` once: the `WorldPicture`.
- ``/frame`` at every frame: the `Frame` without its maps and points, plain numbers that can be plotted.
- ``/points`` with every frame that has any: the points measured since the frame before.
- ``/map`` about once a second and at the end: the belief's maps of ground and obstacles.
- ``/volume`` at the end: the belief's map of the volume, where there is one.
- any other topic: a dict of arrays, bit-exact (raw measurements go to ``/measurements``).

What identifies the episode stands in an MCAP metadata record.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from coop_envs.recording.frame import Frame
from coop_envs.recording.json_arrays import ARRAY_SCHEMA
from coop_envs.recording.scan import Scan

WORLD, FRAME, MAP, MEASUREMENTS = "/world", "/frame", "/map", "/measurements"
POINTS, VOLUME = "/points", "/volume"
MAP_FIELDS = ("map_ground", "map_obstacle", "T_world_map", "cell_m")
VOLUME_FIELDS = ("map_volume", "volume_floor_m")
POINT_FIELDS = tuple(field.name for field in dataclasses.fields(Scan))
APART = {*MAP_FIELDS, *VOLUME_FIELDS, *POINT_FIELDS}
"""Fields of a frame that have topics of their own."""
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
    """JSON schema of a `Frame` without what has topics of its own: arrays nested as their axes, row by row."""
    items = {"names": "string", "role": "string", "stationary": "boolean", "sees": "boolean"}
    items |= {"collected": "boolean", "scanning": "boolean"}
    properties: dict[str, Any] = {}
    for field in dataclasses.fields(Frame):
        if field.name in APART:
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

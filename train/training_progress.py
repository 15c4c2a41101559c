"""How a training went, as plain data: the document behind ``progress.json``, the curves and the report.

    {schema, status, command, version, machine, settings, started, finished, steps, wall_s, evaluation_s, steps_per_s,
     weights_sha256,
     training: [{steps, wall_s, return, length, steps_per_s, reward_per_s: {TERM: ...}, policy_loss, ...}, ...],
     held_out: [{steps, wall_s, episodes, return, information_bits, ...}, ...]}

``status`` is running, complete, interrupted or failed. Times are of the training, whatever came between its parts.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from coop_envs.recording.whole_file import written_whole
from train.results import machine, plain

SCHEMA = 1
MOST_ROWS = 2000

Document = dict[str, Any]


def new_document(command: str, settings: Mapping[str, Any]) -> Document:
    """A document of a training that has not begun."""
    return {
        "schema": SCHEMA,
        "status": "running",
        "command": command,
        "version": version("coop_envs"),
        "machine": machine() | {"torch": version("torch"), "stable-baselines3": version("stable-baselines3")},
        "settings": dict(settings),
        "started": _now(),
        "finished": None,
        "steps": 0,
        "wall_s": 0.0,
        "evaluation_s": 0.0,
        "steps_per_s": 0.0,
        "weights_sha256": None,
        "extended": False,
        "training": [],
        "held_out": [],
    }


def add_row(document: Document, row: dict[str, Any]) -> None:
    """Add an update's figures; of very many every other is let go."""
    rows = document["training"]
    rows.append(row)
    if len(rows) > MOST_ROWS:
        del rows[1:-1:2]


def close(document: Document, status: str) -> None:
    """Say how it ended, and when."""
    document["status"], document["finished"] = status, _now()


def write(document: Document, path: Path) -> None:
    """Write the document as JSON, whole or not at all, and for good."""
    with written_whole(path) as part, part.open("w", encoding="utf-8") as file:
        file.write(to_json(document))
        file.flush()
        os.fsync(file.fileno())


def to_json(document: Document) -> str:
    """The document as text, ending in a new line."""
    return json.dumps(plain(document), allow_nan=False) + "\n"


def summary(document: Document) -> Document:
    """The document without its curves: of each the last point."""
    last = {name: (document[name] or [None])[-1] for name in ("training", "held_out")}
    return {name: value for name, value in document.items() if name not in last} | last


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def finished(path: Path, steps: int) -> bool:
    """Whether the document there is of a training that came to the end of so many steps."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return document.get("status") == "complete" and document.get("settings", {}).get("steps") == steps

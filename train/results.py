"""The document behind ``results.json``: one row an episode, summaries by policy, differences between policies.

    {schema, command, created, finished, status, machine, options,
     policies: {NAME: {episodes: [row, ...], summary: {metric: {kind, value, low, high, n, mean}}}},
     comparisons: [{a, b, metric, value, low, high, n}, ...]}

``status`` is running, complete or interrupted; a row's is finished or crashed. Every episode counts: one that crashed
has covered nothing and succeeded in nothing, and what cannot be known of it is null. A share of coverage that an
episode never reached (``t90_s`` null) counts as reached after infinite time, so its summary may be null too.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from coop_envs.recording.whole_file import written_whole
from train.statistics import bootstrap, paired_difference, success_rate

SCHEMA = 1
METRICS = (
    "coverage",
    "information_bits",
    "energy_j",
    "action_energy_j",
    "bits_per_joule",
    "hazards_found",
    "pickets_lost",
    "observer_survived",
    "position_drift_m",
    "heading_drift_deg",
    "drift_percent_of_path",
    "nees",
    "simulated_s",
    "wall_s",
    "success",
)
CRASHED = dict.fromkeys(METRICS) | {
    "coverage": 0.0,
    "information_bits": 0.0,
    "bits_per_joule": 0.0,
    "observer_survived": False,
    "success": False,
}
NEVER_REACHED = {"t50_s": math.inf, "t90_s": math.inf, "t99_s": math.inf}
NOT_SUMMARISED = {"episode", "seed", "world_index"}
COMPARED = {
    "success": ("success", None),
    "coverage": ("coverage", None),
    "information_bits": ("information_bits", None),
    "energy_j": ("energy_j", None),
    "action_energy_j": ("action_energy_j", None),
    "bits_per_joule": ("information_bits", "energy_j"),
    "bits_per_action_joule": ("information_bits", "action_energy_j"),
    "pickets_lost": ("pickets_lost", None),
    "pickets_lost_per_mapped_m2": ("pickets_lost", "mapped_m2"),
    "simulated_s": ("simulated_s", None),
}

Row = dict[str, Any]
Document = dict[str, Any]


def new_document(command: str, options: Mapping[str, Any], policies: Sequence[str]) -> Document:
    """A document without episodes yet."""
    return {
        "schema": SCHEMA,
        "command": command,
        "created": _now(),
        "finished": None,
        "status": "running",
        "machine": machine(),
        "options": dict(options),
        "policies": {name: {"episodes": [], "summary": {}} for name in policies},
        "comparisons": [],
    }


def machine() -> dict[str, Any]:
    """What the figures were made on."""
    return {
        "platform": platform.platform(),
        "python": platform.python_version(),
        "cpus": os.cpu_count(),
        "packages": {name: version(name) for name in ("coop_envs", "numpy", "warp-lang")},
    }


def add_row(document: Document, row: Row) -> None:
    """Add an episode's row under its policy, in the order of episodes."""
    rows = document["policies"][row["policy"]]["episodes"]
    rows.append(row)
    rows.sort(key=lambda other: other["episode"])


def summarise(document: Document, status: str) -> None:
    """Fill in summaries and comparisons from the rows there are, and the status."""
    document["status"] = status
    document["finished"] = None if status == "running" else _now()
    policies = document["policies"]
    for entry in policies.values():
        entry["summary"] = summary(entry["episodes"])
    pairs = itertools.combinations(policies, 2)
    document["comparisons"] = [
        {"a": a, "b": b, **difference}
        for a, b in pairs
        for difference in comparisons(policies[a]["episodes"], policies[b]["episodes"])
    ]


def summary(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """By metric, the rate of a yes-or-no entry (Wilson) or the interquartile mean of a number (bootstrap)."""
    names = dict.fromkeys(name for row in rows for name in row if name not in NOT_SUMMARISED)
    columns = {name: _known([row.get(name) for row in rows], NEVER_REACHED.get(name)) for name in names}
    return {name: _estimate(values) for name, values in columns.items() if _are_figures(values)}


def comparisons(rows_a: Iterable[Row], rows_b: Iterable[Row]) -> list[dict[str, Any]]:
    """Paired differences a - b over the episodes that both have, for each metric of `COMPARED`."""
    by_episode = {row["episode"]: row for row in rows_b}
    pairs = [(row, by_episode[row["episode"]]) for row in rows_a if row["episode"] in by_episode]
    found = []
    for name, (metric, per) in COMPARED.items():
        needed = [metric] if per is None else [metric, per]
        known = [pair for pair in pairs if all(row.get(key) is not None for row in pair for key in needed)]
        if known:
            a, b = ([float(pair[side][metric]) for pair in known] for side in (0, 1))
            per_a, per_b = ([float(pair[side][per]) if per else 1.0 for pair in known] for side in (0, 1))
            found.append({"metric": name, **asdict(paired_difference(a, b, per_a, per_b))})
    return found


def write(document: Document, path: Path) -> None:
    """Write the document as JSON, whole or not at all."""
    with written_whole(path) as part:
        part.write_text(to_json(document), encoding="utf-8")


def to_json(document: Document) -> str:
    """The document as text, ending in a new line."""
    return json.dumps(plain(document), allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """The value in JSON's own types; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def _known(values: Sequence[Any], otherwise: float | None) -> list[Any]:
    filled = [otherwise if value is None else value for value in values]
    return [value for value in filled if value is not None]


def _are_figures(values: Sequence[Any]) -> bool:
    return bool(values) and all(isinstance(value, bool | int | float) for value in values)


def _estimate(values: Sequence[Any]) -> dict[str, Any]:
    rate = isinstance(values[0], bool)
    estimate = success_rate(values) if rate else bootstrap([values])
    return {"kind": "rate" if rate else "iqm", **asdict(estimate), "mean": float(np.mean(values))}


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")

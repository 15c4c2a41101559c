"""From the results to ``report.html``."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coop_envs.viewer.canvas import Picture
from coop_envs.viewer.metrics import known_metrics
from train.results import Document, Row

PICTURED = 3
"""Episodes of each policy that are shown in pictures."""

Pictures = dict[str, list[tuple[str, tuple[Picture, ...]]]]
"""For each policy, captions and the pictures of an episode."""


def installed(module: str) -> bool:
    """Whether a module of an extra is there."""
    return importlib.util.find_spec(module) is not None


def reportable() -> bool:
    """Whether the viz extra is there."""
    return installed("jinja2") and installed("matplotlib")


def keep_picture(pictures: Pictures, row: Row) -> None:
    """Take the pictures out of an episode's row, with a caption, if it has any."""
    shown = row.pop("pictures", None)
    if shown is not None:
        outcome = "success" if row.get("success") else "no success"
        caption = f"seed {row['seed']}, world {row['world_index']}: {outcome} after {row['simulated_s']:.0f} s"
        pictures.setdefault(row["policy"], []).append((caption, shown))


def report(document: Document, pictures: Pictures, path: Path) -> None:
    """Write the report of a summarised document."""
    from coop_envs.viewer.report import write_report

    policies = document["policies"]
    options = document["options"]
    write_report(
        path,
        title=f"Evaluation: {Path(options['world'] or options['scenario']).name}",
        command=document["command"],
        environment=_environment(document),
        results={name: entry["episodes"] for name, entry in policies.items()},
        aggregates={name: _intervals(entry["summary"]) for name, entry in policies.items()},
        comparisons=document["comparisons"],
        pictures={name: sorted(pictures[name], key=lambda entry: entry[0]) for name in policies if name in pictures},
        limitations=_limitations(document),
    )


def _environment(document: Document) -> dict[str, Any]:
    options = {name: str(value) for name, value in document["options"].items() if value not in (None, False)}
    return {"finished": document["finished"], **document["machine"], "options": options}


def _intervals(summary: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    known = {metric.name for metric in known_metrics()}
    return {
        name: {"iqm": entry["value"], "low": entry["low"], "high": entry["high"], "n": entry["n"]}
        for name, entry in summary.items()
        if name in known
    }


def _limitations(document: Document) -> list[str]:
    rows = [row for entry in document["policies"].values() for row in entry["episodes"]]
    crashed = sum(row["error"] is not None for row in rows)
    left_out = "what cannot be known of them, their curves too, is left out"
    notes = {
        f"{crashed} episodes crashed and count as failures; {left_out}.": crashed > 0,
        "The evaluation was interrupted; only finished episodes count.": document["status"] == "interrupted",
    }
    return [note for note, applies in notes.items() if applies]

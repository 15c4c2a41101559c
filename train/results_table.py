"""The results as tables for a terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.table import Table

from coop_envs.viewer.metrics import Metric, known_metrics
from train.results import Document

SHOWN = (
    "success",
    "coverage",
    "information_bits",
    "action_energy_j",
    "pickets_lost",
    "observer_survived",
    "drift_percent_of_path",
    "simulated_s",
)
DIFFERENCES = ("success", "coverage", "pickets_lost", "pickets_lost_per_covered_m2", "simulated_s")
PLAIN = Metric("", "", decimals=2)


def results_tables(document: Document) -> Group:
    """A column a policy, a row a metric; below it the paired differences between policies."""
    policies = document["policies"]
    table = Table("per episode", *policies, caption="rate or interquartile mean (95 % interval)")
    table.add_row("episodes", *[str(len(entry["episodes"])) for entry in policies.values()])
    metrics = {metric.name: metric for metric in known_metrics()}
    for name in SHOWN:
        metric = metrics[name]
        cells = [_cell(metric, entry["summary"].get(name)) for entry in policies.values()]
        table.add_row(f"{metric.label} {metric.unit}".strip(), *cells)
    return Group(table, *_differences(document))


def _differences(document: Document) -> list[Table]:
    shown = [entry for entry in document["comparisons"] if entry["metric"] in DIFFERENCES]
    if not shown:
        return []
    table = Table("difference", *DIFFERENCES, caption="paired differences of means (95 % interval)")
    for a, b in dict.fromkeys((entry["a"], entry["b"]) for entry in shown):
        found = {entry["metric"]: entry for entry in shown if (entry["a"], entry["b"]) == (a, b)}
        table.add_row(f"{a} - {b}", *[_cell(PLAIN, found.get(name)) for name in DIFFERENCES])
    return [table]


def _cell(metric: Metric, estimate: dict[str, Any] | None) -> str:
    if estimate is None:
        return "-"
    return f"{metric.text(estimate['value'])} ({metric.text(estimate['low'])} to {metric.text(estimate['high'])})"

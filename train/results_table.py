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
    "mapped_m2",
    "information_bits",
    "action_energy_j",
    "pickets_lost",
    "observer_survived",
    "drift_percent_of_path",
    "simulated_s",
)
DIFFERENCES = ("success", "coverage", "pickets_lost", "pickets_lost_per_mapped_m2", "simulated_s")
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
    by_metric: dict[str, dict[str, dict[str, Any]]] = {}
    for entry in document["comparisons"]:
        by_metric.setdefault(entry["metric"], {})[f"{entry['a']} - {entry['b']}"] = entry
    pairs = dict.fromkeys(pair for found in by_metric.values() for pair in found)
    table = Table("paired difference", *pairs, caption="of means or ratios of sums (95 % interval)")
    for metric in (metric for metric in DIFFERENCES if metric in by_metric):
        table.add_row(metric, *[_cell(PLAIN, by_metric[metric].get(pair)) for pair in pairs])
    return [table] if pairs else []


def _cell(metric: Metric, estimate: dict[str, Any] | None) -> str:
    if estimate is None:
        return "-"
    return f"{metric.text(estimate['value'])} ({metric.text(estimate['low'])} to {metric.text(estimate['high'])})"

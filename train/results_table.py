"""The results as tables for a terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.table import Table

from coop_envs.viewer.metrics import Metric, compared_metrics, known_metrics
from train.results import Document

SHOWN = (
    "success",
    "coverage",
    "mapped_m2",
    "information_bits",
    "action_energy_j",
    "bits_per_action_joule",
    "points_measured",
    "point_error_m",
    "pickets_lost",
    "observer_survived",
    "drift_percent_of_path",
    "simulated_s",
)
DIFFERENCES = (
    "success",
    "coverage",
    "information_bits",
    "bits_per_action_joule",
    "pickets_lost",
    "pickets_lost_per_mapped_m2",
    "simulated_s",
)


def results_tables(document: Document) -> Group:
    """A column a policy, a row a metric; below it the paired differences between policies."""
    policies = document["policies"]
    table = Table("per episode", *policies, caption="rate or interquartile mean (95 % interval)")
    table.add_row("episodes", *[str(len(entry["episodes"])) for entry in policies.values()])
    metrics = {metric.name: metric for metric in known_metrics()}
    for name in SHOWN:
        metric = metrics[name]
        estimates = [entry["summary"].get(name) for entry in policies.values()]
        if any(estimates):
            table.add_row(f"{metric.label} {metric.unit}".strip(), *(_cell(metric, estimate) for estimate in estimates))
    return Group(table, *_differences(document))


def _differences(document: Document) -> list[Table]:
    """A row for each metric and pair of policies."""
    by_metric: dict[str, list[dict[str, Any]]] = {}
    for entry in document["comparisons"]:
        by_metric.setdefault(entry["metric"], []).append(entry)
    table = Table("paired difference", "between", "", caption="of means or ratios of sums (95 % interval)")
    for metric in compared_metrics(name for name in DIFFERENCES if name in by_metric):
        captions = [f"{metric.label} {metric.unit}".strip(), *[""] * len(by_metric[metric.name])]
        for caption, entry in zip(captions, by_metric[metric.name], strict=False):
            table.add_row(caption, f"{entry['a']} - {entry['b']}", _cell(metric, entry))
        table.add_section()
    return [table] if by_metric else []


def _cell(metric: Metric, estimate: dict[str, Any] | None) -> str:
    if estimate is None:
        return "-"
    return f"{metric.text(estimate['value'])} ({metric.interval(estimate)})"

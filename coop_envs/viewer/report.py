"""The evaluation's report: one HTML file that needs nothing else, on a screen, a phone or paper."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from coop_envs.recording.whole_file import written_whole
from coop_envs.viewer import plots
from coop_envs.viewer.canvas import Picture
from coop_envs.viewer.curves import Episode, bands
from coop_envs.viewer.metrics import LEAST_PAIRS, Metric, compared_metrics, known_metrics
from coop_envs.viewer.plots import Interval
from coop_envs.viewer.relief import HEADROOM_M

TEMPLATE = "report.html.jinja"
BARS_PER_FIGURE = 8
PAIRS_PER_TABLE = 3
HOW_CURVES = "median and middle half of the episodes, broken ones left out; one that is over keeps its last value."
CURVES = (
    (
        "Information against energy, idle consumption included",
        "energy_j",
        "energy (J)",
        "information_bits",
        "bits",
        1.0,
    ),
    ("Information against action energy", "action_energy_j", "action energy (J)", "information_bits", "bits", 1.0),
    ("Coverage against simulated time", "time_s", "simulated time (s)", "coverage", "coverage (%)", 100.0),
    ("Coverage against energy, idle consumption included", "energy_j", "energy (J)", "coverage", "coverage (%)", 100.0),
    ("Coverage against action energy", "action_energy_j", "action energy (J)", "coverage", "coverage (%)", 100.0),
)
LIMITATIONS = (
    "Everything here was simulated: intervals tell how figures vary with the seed, not how far they are from reality.",
    "The truth (lost, drift, coverage) is known to the evaluation alone; the policies saw only what the team believes.",
    "Wall times depend on the machine and on what else it did.",
)


def write_report(
    path: str | Path,
    *,
    title: str,
    command: str,
    environment: Mapping[str, Any],
    results: Mapping[str, Sequence[Episode]],
    aggregates: Mapping[str, Mapping[str, Interval]],
    pictures: Mapping[str, Sequence[tuple[str, Sequence[Picture]]]],
    comparisons: Sequence[Mapping[str, Any]] = (),
    limitations: Sequence[str] = (),
) -> Path:
    """Write the report of an evaluation; the file exists whole or not at all.

    Args:
        path: the HTML file.
        title: heading.
        command: the command line that repeats the evaluation.
        environment: what it ran on and with, shown as it stands: machine, versions, seeds, scenario; may be nested.
        results: for each policy its episodes: ``seed``, the metrics by name, ``series`` of lists of equal length
            (``time_s``, ``coverage``, ``energy_j``, ``action_energy_j``, ``information_bits``) and, if it broke off,
            ``error``.
        aggregates: for each policy and metric ``iqm``, ``low``, ``high`` and ``n``.
        pictures: for each policy and some of its episodes a caption and pictures, uint8 (height, width, 3) RGB.
        comparisons: paired differences a - b between policies: ``a``, ``b``, ``metric``, ``value``, ``low``, ``high``.
        limitations: what else a reader should know, beside what holds for every simulated evaluation.
    """
    html = render(
        title=title,
        command=command,
        environment=environment,
        results=results,
        aggregates=aggregates,
        pictures=pictures,
        comparisons=comparisons,
        limitations=limitations,
    )
    with written_whole(path) as part:
        part.write_text(html, encoding="utf-8")
    return Path(path)


def render(
    *,
    title: str,
    command: str,
    environment: Mapping[str, Any],
    results: Mapping[str, Sequence[Episode]],
    aggregates: Mapping[str, Mapping[str, Interval]],
    pictures: Mapping[str, Sequence[tuple[str, Sequence[Picture]]]],
    comparisons: Sequence[Mapping[str, Any]] = (),
    limitations: Sequence[str] = (),
) -> str:
    """The report as HTML text; arguments as in `write_report`."""
    import jinja2

    source = resources.files("coop_envs.viewer").joinpath(TEMPLATE).read_text(encoding="utf-8")
    template = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).from_string(source)
    metrics = reported_metrics(aggregates)
    return template.render(
        title=title,
        command=command,
        environment=environment,
        policies=[(policy, plots.policy_colour(k)) for k, policy in enumerate(results)],
        outcomes={policy: _outcome(episodes) for policy, episodes in results.items()},
        metrics=metrics,
        aggregates=aggregates,
        results=results,
        figures=_figures(results, aggregates, metrics),
        pictures={
            policy: [(caption, [png_uri(encode_png(image)) for image in images]) for caption, images in entries]
            for policy, entries in pictures.items()
        },
        differences=_differences(comparisons),
        headroom_m=HEADROOM_M,
        least_pairs=LEAST_PAIRS,
        limitations=(*LIMITATIONS, *limitations),
    )


def reported_metrics(aggregates: Mapping[str, Mapping[str, Interval]]) -> list[Metric]:
    """The metrics that any policy has, known ones first; others appear under their plain names."""
    names = dict.fromkeys(name for entries in aggregates.values() for name in entries)
    known = {metric.name: metric for metric in known_metrics()}
    return [known[name] for name in known if name in names] + [
        Metric(name, name) for name in names if name not in known
    ]


def _differences(comparisons: Sequence[Mapping[str, Any]]) -> list[tuple[list[tuple[str, str]], list[Any]]]:
    """Tables of a few pairs of policies each: the pairs, and each metric with their differences, None where missing."""
    pairs = list(dict.fromkeys((entry["a"], entry["b"]) for entry in comparisons))
    found = {(entry["metric"], entry["a"], entry["b"]): entry for entry in comparisons}
    metrics = compared_metrics(dict.fromkeys(entry["metric"] for entry in comparisons))
    tables = [pairs[k : k + PAIRS_PER_TABLE] for k in range(0, len(pairs), PAIRS_PER_TABLE)]
    return [(some, [(m, [found.get((m.name, *pair)) for pair in some]) for m in metrics]) for some in tables]


def _outcome(episodes: Sequence[Episode]) -> dict[str, int]:
    broken = sum("error" in episode and bool(episode["error"]) for episode in episodes)
    failed = sum(not episode.get("success", False) for episode in episodes)
    return {"episodes": len(episodes), "failed": failed, "broken": broken}


def _figures(
    results: Mapping[str, Sequence[Episode]],
    aggregates: Mapping[str, Mapping[str, Interval]],
    metrics: Sequence[Metric],
) -> list[tuple[str, str]]:
    """Captions and images."""
    figures: list[tuple[str, str]] = []
    for caption, against, x_label, quantity, y_label, scale in CURVES:
        curves = bands(results, against, quantity)
        if curves:
            figure = plots.draw_bands(curves, x_label, y_label, scale)
            figures.append((f"{caption}: {HOW_CURVES}", png_uri(plots.png(figure))))
    judged = [metric for metric in metrics if metric.better is not None]
    for start in range(0, len(judged), BARS_PER_FIGURE):
        figure = plots.draw_intervals(aggregates, judged[start : start + BARS_PER_FIGURE])
        figures.append(("The table's values with their 95 % intervals.", png_uri(plots.png(figure))))
    return figures


def encode_png(image: Picture) -> bytes:
    """A PNG file's bytes of a picture, uint8 (height, width, 3) RGB."""
    return cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))[1].tobytes()


def png_uri(data: bytes) -> str:
    """A PNG as text that an HTML file can hold."""
    return "data:image/png;base64," + base64.b64encode(data).decode("ascii")

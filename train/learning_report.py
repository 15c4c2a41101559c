"""The training's report: one HTML file that needs nothing else, for colleagues who were not there."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from coop_envs.recording.whole_file import written_whole
from coop_envs.validation import validated
from coop_envs.viewer.metrics import Metric, known_metrics
from train.learning_curves import draw_curves, svg
from train.reporting import installed
from train.training_progress import Document
from train.training_settings import TrainingSettings

TEMPLATE = "learning_report.html.jinja"
RETURN = Metric("return", "Return", "Sum of rewards over an episode, as the scenario weighs them.", better="higher")
HELD_OUT = ("success", "coverage", "information_bits", "bits_per_action_joule", "pickets_lost", "simulated_s")
TRAINING = (
    ("Policy loss (clipped surrogate)", "policy_loss"),
    ("Value loss (squared error, scaled rewards)", "value_loss"),
    ("Entropy of the actions (nats)", "entropy"),
    ("Divergence from the policy before each update (nats)", "approx_kl"),
    ("Variance of returns that the value explains (1: all)", "explained_variance"),
    ("Steps per second, evaluations left out", "steps_per_s"),
)
LIMITATIONS = (
    "Everything here was simulated, at fidelity poses unless set otherwise; evaluate the policy at features too.",
    "Held-out worlds are kept from training, but who reads these curves to choose settings chooses by them.",
    "One seed shows one training: others may go differently. Figures of few episodes vary by chance.",
)


def reportable() -> bool:
    """Whether the viz extra is there."""
    return installed("jinja2") and installed("matplotlib")


def write_learning_report(document: Document, path: Path) -> None:
    """Write the report of a training that is over; the file exists whole or not at all."""
    html = render(document)
    with written_whole(path) as part:
        part.write_text(html, encoding="utf-8")


def render(document: Document) -> str:
    """The report as HTML text."""
    import jinja2

    source = resources.files("train").joinpath(TEMPLATE).read_text(encoding="utf-8")
    settings = dict(document["settings"])
    template = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).from_string(source)
    return template.render(
        document=document,
        settings=settings,
        task=Path(settings["world"] or settings["scenario"]).name,
        metrics=held_out_metrics(),
        held_out=_chosen(document["held_out"]),
        held_out_figures=_held_out_figures(document),
        training_figures=_training_figures(document),
        share=100.0 * document["evaluation_s"] / max(document["wall_s"], 1e-9),
        environment={name: document[name] for name in ("version", "started", "finished")} | document["machine"],
        compare=_comparison(settings),
        limitations=LIMITATIONS,
    )


def _comparison(settings: Mapping[str, Any]) -> str:
    """The command that puts the policy beside baselines that fit its team, in the scenario as it was trained in."""
    scenario = validated(TrainingSettings, settings).load_scenario()
    scans = any(member.laser is not None for member in scenario.team.members)
    words = ["coop evaluate --policy", settings["out"], "random_walk", "inchworm_scan" if scans else "goal_grid"]
    words += ["--scenario", settings["scenario"]]
    words += [word for name in ("world", "team") if settings[name] for word in (f"--{name}", settings[name])]
    words += [word for entry in settings["overrides"] for word in ("--set", entry)]
    return " ".join([*words, "--out out/evaluate"])


def held_out_metrics() -> list[Metric]:
    """What is reported of held-out worlds, in this order."""
    known = {metric.name: metric for metric in known_metrics()}
    return [RETURN, *(known[name] for name in HELD_OUT)]


def _chosen(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, Mapping[str, Any]]]:
    """The first evaluation, the one of the best return, and the last."""
    if len(rows) < 2:
        return [("After training", row) for row in rows]
    best = max(rows, key=lambda row: row["return"])
    return [("First", rows[0]), ("Best return", best), ("Last", rows[-1])]


def _held_out_figures(document: Document) -> list[tuple[str, str]]:
    """A curve for each metric; beside the return of held-out worlds the one in training."""
    rows, figures = document["held_out"], []
    for metric in held_out_metrics():
        curves = {"held-out worlds": [(row["steps"], metric.scale * row[metric.name]) for row in rows]}
        if metric.name == "return":
            trained = [(row["steps"], row["return"]) for row in document["training"]]
            curves = {"training worlds": trained, **curves}
        label = f"{metric.label} ({metric.unit})" if metric.unit else metric.label
        figures += _figure(label, curves)
    return figures


def _training_figures(document: Document) -> list[tuple[str, str]]:
    rows = document["training"]
    terms = list(rows[-1]["reward_per_s"]) if rows else []
    per_s = {term.replace("_", " "): [(row["steps"], row["reward_per_s"][term]) for row in rows] for term in terms}
    used = {term: points for term, points in per_s.items() if any(value for _, value in points)}
    figures = _figure("Reward by term, per team and simulated second", used)
    for caption, name in TRAINING:
        figures += _figure(caption, {name: [(row["steps"], row.get(name)) for row in rows]})
    return figures


def _figure(caption: str, curves: Mapping[str, Sequence[tuple[int, float | None]]]) -> list[tuple[str, str]]:
    """Caption and picture, nothing if no curve has two points."""
    known = {name: [(x, y) for x, y in points if y is not None] for name, points in curves.items()}
    shown = {name: points for name, points in known.items() if points}
    drawable = any(len(points) > 1 for points in shown.values())
    return [(caption, _uri(svg(draw_curves(shown))))] if drawable else []


def _uri(data: bytes) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(data).decode("ascii")

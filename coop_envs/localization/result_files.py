"""A result as files: TUM trajectories, events.csv, a picture, results.json. Each appears whole or not at all."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.events import Trajectory
from coop_envs.localization.logs.tum import write_tum
from coop_envs.localization.result import Result
from coop_envs.recording.whole_file import written_whole
from coop_envs.viewer.robots import ellipse_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLOURS = ("#3366aa", "#c8553d", "#2f8f5b", "#8a5fb0", "#b8860b", "#4a9aa5", "#9a4a6f", "#666666")
ELLIPSES = 10


def write_result(folder: Path, result: Result, truth: Mapping[str, Trajectory], document: Mapping[str, Any]) -> None:
    """Write all into a folder; ``truth`` in the result's frame goes into the picture.

    Raises:
        ConfigError: the folder cannot be made.
    """
    make_folder(folder)
    for name, path in result.paths.items():
        write_tum(folder / f"{file_name(name)}.tum", path)
    with written_whole(folder / "events.csv") as part, part.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(("time_s", "kind", "robot", "detail"))
        for one in result.happenings:
            writer.writerow((f"{one.time_s:.6f}", one.kind.value, one.robot, one.detail))
    if result.paths:
        with written_whole(folder / "trajectories.png") as part:
            draw_paths(result, truth).savefig(part, format="png")
    with written_whole(folder / "results.json") as part:
        part.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def make_folder(folder: Path) -> None:
    """Have a folder.

    Raises:
        ConfigError: there is something else in its place, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError("out", str(folder), f"a folder, or a place for one ({error.strerror})") from None


def file_name(robot: str) -> str:
    """A robot's name without what does not belong into a file's."""
    return re.sub(r"[^\w.-]+", "_", robot).strip(".") or "robot"


def draw_paths(result: Result, truth: Mapping[str, Trajectory]) -> Figure:
    """Paths in the ground plane (lines) with 2-sigma ellipses over true paths (broad, pale), in metres.

    ``truth`` is in the frame of the result.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.5), layout="constrained", dpi=144)
    axes = figure.subplots()
    for k, (name, path) in enumerate(result.paths.items()):
        colour = COLOURS[k % len(COLOURS)]
        if name in truth:
            axes.plot(*truth[name].position[:, :2].T, color=colour, linewidth=4.0, alpha=0.25, solid_capstyle="round")
        axes.plot(*path.position[:, :2].T, color=colour, linewidth=1.2, label=name)
        axes.plot(*path.position[-1, :2], color=colour, marker="o", markersize=4.0)
        for at in np.unique(np.linspace(0, len(path.time_s) - 1, ELLIPSES).round().astype(int)):
            points = ellipse_points(path.position[at, :2], path.covariance[at, 3:5, 3:5])
            axes.plot(*points.T, color=colour, linewidth=0.6, alpha=0.8)
    for name, (x, y) in result.landmarks.items():
        axes.plot(x, y, color="#444444", marker="^", markersize=4.0)
        axes.annotate(name, (x, y), fontsize=6, xytext=(3, 3), textcoords="offset points")
    axes.set(xlabel=f"x (m, {result.frame} frame)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    title = "lines: estimate and 2-sigma ellipses; pale: truth" if truth else "estimate and 2-sigma ellipses"
    axes.set_title(title, fontsize=9, loc="left")
    if len(result.paths) <= len(COLOURS):
        axes.legend(frameon=False, fontsize=8)
    return figure

"""Fig. 6.1: the region that two robots map as they inch along, for three fields of view.

Each robot sees a sector about its heading; a scan maps what both see. Robots do not hide anything from each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from baselines.inchworm_poses import Scan, ScanPose, scan_sequence
from coop_envs.errors import require
from experiments.comparison import Comparison, Tick, silent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

THESIS_M2 = {
    "pi/2": (2.993, 5.985, 8.808, 11.632),
    "pi/3": (1.770, 3.540, 5.295, 7.049),
    "4pi/3": (7.319, 10.282, 13.166, 16.029),
}
FIELDS_OF_VIEW_RAD = {"pi/2": math.pi / 2, "pi/3": math.pi / 3, "4pi/3": 4 * math.pi / 3}
ROBOT_RADIUS_M = 0.15
SLIVER_M = 0.005  # half the width below which what is new is the arcs' chords, and not drawn
ROBOT, SEEN, MAPPED, NEW, EDGE = "#ffd54a", "#5b8def", "#58b368", "#2e7d46", "#444444"


@dataclass(frozen=True)
class Config:
    """``range_m`` of the sensing, number of scans, and points on each sector's arc."""

    range_m: float = 2.5
    steps: int = 4
    arc_points: int = 1441

    def __post_init__(self) -> None:
        require(self.arc_points >= 3, "arc_points", self.arc_points, "3 or more")


@dataclass(frozen=True)
class Step:
    """One scan: the robots' poses, what each sees, and all that has been mapped before and after."""

    scan: Scan
    sectors: tuple[Polygon, Polygon]
    before: BaseGeometry
    after: BaseGeometry

    @property
    def area_m2(self) -> float:
        return self.after.area


@dataclass(frozen=True)
class Table:
    """The scans by field of view."""

    steps: dict[str, tuple[Step, ...]]
    title: str = "Fig. 6.1: mapped area of two robots that inch along"
    notes: Sequence[str] = ("Thesis: areas derived from the authors' poses and sectors, +/-0.01 m2.",)

    @property
    def comparisons(self) -> list[Comparison]:
        return [
            Comparison(f"fov {name}, {step.scan.label}", "m2", step.area_m2, thesis)
            for name, steps in self.steps.items()
            for step, thesis in zip(steps, THESIS_M2[name], strict=False)
        ]


def sector(pose: ScanPose, fov_rad: float, range_m: float, arc_points: int = 1441) -> Polygon:
    """What a robot sees from a pose: a sector of a disc, its arc a chain of chords."""
    angle = pose.heading_rad + np.linspace(-fov_rad / 2, fov_rad / 2, arc_points)
    arc = np.column_stack([pose.x_m + range_m * np.cos(angle), pose.y_m + range_m * np.sin(angle)])
    return Polygon(np.vstack([[pose.x_m, pose.y_m], arc]))


def mapping_steps(scans: Sequence[Scan], fov_rad: float, config: Config) -> tuple[Step, ...]:
    """The region mapped by scan after scan."""
    mapped: BaseGeometry = Polygon()
    steps = []
    for scan in scans:
        first, second = (sector(pose, fov_rad, config.range_m, config.arc_points) for pose in scan.robots)
        grown = shapely.union(mapped, shapely.intersection(first, second))
        steps.append(Step(scan, (first, second), mapped, grown))
        mapped = grown
    return tuple(steps)


def run(config: Config | None = None, tick: Tick = silent) -> Table:
    """Map with each field of view."""
    config = config or Config()
    scans = scan_sequence(config.steps, config.range_m)
    steps = {}
    for name, fov_rad in FIELDS_OF_VIEW_RAD.items():
        steps[name] = mapping_steps(scans, fov_rad, config)
        tick(len(steps) / len(FIELDS_OF_VIEW_RAD))
    return Table(steps)


def plot(table: Table) -> Figure:
    """A row for each field of view, a column for each scan."""
    from matplotlib.figure import Figure

    columns = max(len(steps) for steps in table.steps.values())
    figure = Figure(figsize=(2.9 * columns, 2.75 * len(table.steps)), layout="constrained", dpi=144)
    grid = figure.subplots(len(table.steps), columns, squeeze=False, sharex=True, sharey=True)
    for row, (name, steps) in zip(grid, table.steps.items(), strict=True):
        for axes, step in zip(row, steps, strict=True):
            _draw(axes, step)
        row[0].set_ylabel(f"field of view {name.replace('pi', 'π')}\ny (m)", fontsize=9)
    for axes in grid[-1]:
        axes.set_xlabel("x (m)", fontsize=9)
    return figure


def _draw(axes: Axes, step: Step) -> None:
    for seen in step.sectors:
        axes.fill(*_outline(seen), facecolor=SEEN, alpha=0.18, edgecolor=SEEN, linewidth=0.8)
    _fill(axes, step.before, MAPPED)
    _fill(axes, shapely.difference(step.after, step.before).buffer(-SLIVER_M), NEW)
    for k, pose in enumerate(step.scan.robots):
        turn = np.linspace(0, 2 * math.pi, 49)
        axes.fill(
            pose.x_m + ROBOT_RADIUS_M * np.cos(turn),
            pose.y_m + ROBOT_RADIUS_M * np.sin(turn),
            facecolor=ROBOT,
            edgecolor=EDGE,
            linewidth=0.8,
            zorder=3,
        )
        ahead = 0.45 * np.array([math.cos(pose.heading_rad), math.sin(pose.heading_rad)])
        axes.annotate(
            "",
            xy=(pose.x_m + ahead[0], pose.y_m + ahead[1]),
            xytext=(pose.x_m, pose.y_m),
            arrowprops={"arrowstyle": "->", "color": EDGE, "linewidth": 1.0},
            zorder=4,
        )
        axes.text(pose.x_m - 0.25, pose.y_m - 0.35, f"R{k}", fontsize=7, ha="center", va="center", zorder=5)
    axes.set_title(f"{step.scan.label}: {step.area_m2:.3f} m²", fontsize=9)
    axes.set(aspect="equal")
    axes.tick_params(labelsize=7)
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)


def _fill(axes: Axes, region: BaseGeometry, colour: str) -> None:
    for part in getattr(region, "geoms", [region]):
        if isinstance(part, Polygon) and not part.is_empty:
            axes.fill(*_outline(part), facecolor=colour, alpha=0.75, edgecolor=colour, linewidth=0.5)


def _outline(region: Polygon) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.asarray(region.exterior.coords).T
    return x, y

"""Figures of an evaluation, drawn from what was computed elsewhere.

Matplotlib is used without its global state, so nothing here needs a display or disturbs a caller's figures.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.viewer.canvas import View
from coop_envs.viewer.curves import Band
from coop_envs.viewer.metrics import Metric
from coop_envs.viewer.palette import INK, MUTED, POLICIES, RULE, TRUE_HAZARDS, Rgb, robot_colours
from coop_envs.viewer.robots import Trail, ellipse_points
from coop_envs.viewer.terrain import hazard_outline, shaded_ground
from coop_envs.viewer.window import episode_window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Interval = Mapping[str, float]
DPI = 144
BAR_COLUMNS = 2


def draw_bands(bands: Mapping[str, Band], x_label: str, y_label: str, scale: float = 1.0) -> Figure:
    """Medians as lines, quartiles as bands; ``scale`` multiplies the quantity."""
    figure, axes = _figure(6.2, 3.4)
    for k, (policy, values) in enumerate(bands.items()):
        colour = policy_colour(k)
        axes.fill_between(values.x, scale * values.low, scale * values.high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(values.x, scale * values.median, color=colour, linewidth=1.8, label=policy)
    axes.set_xlabel(x_label, fontsize=9)
    axes.set_ylabel(y_label, fontsize=9)
    axes.set(xlim=(0, None), ylim=(0, None))
    if bands:
        axes.legend(frameon=False, fontsize=9, loc="best")
    return figure


def draw_intervals(aggregates: Mapping[str, Mapping[str, Interval]], metrics: Sequence[Metric]) -> Figure:
    """A bar for each policy and metric that all have, with the interval of its estimate."""
    from matplotlib.figure import Figure

    shown = [m for m in metrics if all(m.name in entries for entries in aggregates.values())]
    rows = max(1, -(-len(shown) // BAR_COLUMNS))
    figure = Figure(figsize=(6.2, rows * (0.58 + 0.18 * len(aggregates))), layout="constrained", dpi=DPI)
    grid = figure.subplots(rows, BAR_COLUMNS, squeeze=False, sharey=True).ravel()
    for axes, metric in zip(grid, shown, strict=False):
        _bars(axes, metric, {policy: entries[metric.name] for policy, entries in aggregates.items()})
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    return figure


def _bars(axes: Axes, metric: Metric, intervals: Mapping[str, Interval]) -> None:
    values, low, high = (
        metric.scale * np.array([i[key] for i in intervals.values()]) for key in ("iqm", "low", "high")
    )
    place = np.arange(len(intervals))[::-1]
    axes.barh(place, values, height=0.66, color=[policy_colour(k) for k in range(len(intervals))], alpha=0.85)
    axes.hlines(place, low, high, color=_hex(INK), linewidth=1.4)
    axes.set_yticks(place, list(intervals), fontsize=8)
    axes.set_title(metric.label + (f" ({metric.unit})" if metric.unit else ""), fontsize=8.5, loc="left")
    if values.min() >= 0:
        axes.set_xlim(left=0)
    axes.locator_params(axis="x", nbins=4)
    _plain(axes, grid_axis="x")


def draw_trajectories(world: WorldPicture, frames: Sequence[Frame], ellipses: int = 12) -> Figure:
    """True paths (lines), believed paths (dashed) and some 2-sigma ellipses over the map of one episode, in metres."""
    window = episode_window(world, frames)
    x_min, y_min, x_max, y_max = window
    figure, axes = _figure(6.2, min(6.0, max(2.0, 5.6 * (y_max - y_min) / (x_max - x_min) + 0.6)))
    axes.imshow(shaded_ground(world, View.fit(window, 800, margin=0)), extent=(x_min, x_max, y_min, y_max))
    for hazard in world.hazards:
        axes.fill(*hazard_outline(hazard).T, fill=False, hatch="////", edgecolor=_hex(TRUE_HAZARDS[hazard.kind]))
    trail = Trail.from_frames(frames)
    for i, colour in enumerate(robot_colours(frames[0].role) if frames else ()):
        if np.isfinite(trail.true_xy[:, i]).any():
            axes.plot(*trail.true_xy[:, i].T, color=_hex(colour), linewidth=1.4, label=frames[0].names[i])
            axes.plot(*trail.belief_xy[:, i].T, color=_hex(colour), linewidth=0.9, linestyle=(0, (3, 2)))
        for k in np.unique(np.linspace(0, len(frames) - 1, ellipses).round().astype(int)):
            if np.isfinite(trail.belief_xy[k, i]).all():
                points = ellipse_points(trail.belief_xy[k, i], frames[k].belief_cov_xy[i])
                axes.fill(*points.T, facecolor="none", edgecolor=_hex(colour), linewidth=0.7, alpha=0.8)
    axes.set(xlabel="x (m)", ylabel="y (m)", xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal")
    axes.grid(visible=False)
    axes.legend(frameon=False, fontsize=8, ncols=4, loc="lower left", bbox_to_anchor=(0, 1))
    return figure


def png(figure: Figure) -> bytes:
    """The figure as a PNG file's bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def picture(figure: Figure) -> NDArray[np.uint8]:
    """The figure as pixels, uint8 (height, width, 3) RGB."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]


def policy_colour(k: int) -> str:
    """Colour of the k-th policy in every figure of a report."""
    return POLICIES[k % len(POLICIES)]


def _figure(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained", dpi=DPI)
    axes = figure.subplots()
    _plain(axes)
    return figure, axes


def _plain(axes: Axes, grid_axis: str = "both") -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_hex(MUTED))
    axes.tick_params(labelsize=8, color=_hex(MUTED))
    axes.grid(visible=True, axis=grid_axis, color=_hex(RULE), linewidth=0.7)  # pyright: ignore[reportArgumentType]
    axes.set_axisbelow(True)


def _hex(colour: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)

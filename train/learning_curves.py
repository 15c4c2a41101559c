"""Curves over the steps of a training, drawn without matplotlib's global state."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from coop_envs.viewer.palette import INK, MUTED, POLICIES, RULE, Rgb

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKED = 30
"""Curves of at most so many points show them."""


def draw_curves(curves: Mapping[str, Sequence[tuple[int, float]]]) -> Figure:
    """Lines through points (steps, value), each with its name where there are several."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter

    figure = Figure(figsize=(4.6, 2.5), layout="constrained")
    axes = figure.subplots()
    for k, (name, points) in enumerate(curves.items()):
        x, y = zip(*points, strict=True)
        marker = "o" if len(points) <= MARKED else None
        axes.plot(x, y, color=POLICIES[k % len(POLICIES)], linewidth=1.5, marker=marker, markersize=3, label=name)
    axes.set_xlim(left=0)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.set_xlabel("steps", fontsize=8.5, color=_hex(INK))
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_hex(MUTED))
    axes.tick_params(labelsize=8, color=_hex(MUTED))
    axes.grid(visible=True, color=_hex(RULE), linewidth=0.7)
    axes.set_axisbelow(True)
    if len(curves) > 1:
        figure.legend(frameon=False, fontsize=8, loc="outside lower center", ncols=3)
    return figure


def svg(figure: Figure) -> bytes:
    """The figure as an SVG file's bytes, letters as shapes, so that it looks the same everywhere."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "coop_envs", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def _hex(colour: Rgb) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)

"""The strip under the top view: the episode's figures, and what the marks mean."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from coop_envs.recording.frame import Frame
from coop_envs.viewer.canvas import Picture, Points, circle_points, dashed, hatch, polygon, polyline, star_points
from coop_envs.viewer.lettering import MEDIUM, text_width, write
from coop_envs.viewer.palette import (
    FLOOR,
    GOAL,
    HAZARD,
    HEIGHTS,
    INK,
    LASER,
    LOST,
    MUTED,
    OBSERVERS,
    OBSTACLE,
    PAPER,
    PICKETS,
    PROVEN,
    RULE,
    SEEN_FREE,
    TRUE_HAZARDS,
    Rgb,
    mixed,
)
from coop_envs.viewer.robots import draw_cross, draw_disc, draw_dock, draw_landmark, draw_outline

FIGURES_PX = 46
LEGEND_ROW_PX = 21
LEGEND_COLUMN_PX = 112
PAD_PX = 12


def figures(frame: Frame) -> tuple[tuple[str, str], ...]:
    """Caption and value of what the strip tells."""
    return (
        ("time", f"{frame.time_s:.1f} s"),
        ("coverage", f"{100 * frame.coverage:.0f} %"),
        ("information", f"{frame.information_bits:.0f} bits"),
        ("energy", f"{frame.energy_j:.0f} J"),
        ("of it, action", f"{frame.action_energy_j:.1f} J"),
    )


def write_figures(strip: Picture, frame: Frame) -> None:
    """Write the figures in even columns, in place."""
    entries = figures(frame)
    column = (strip.shape[1] - 2 * PAD_PX) / len(entries)
    size = 15 if column >= 84 else 12
    for k, (caption, value) in enumerate(entries):
        left = PAD_PX + k * column
        write(strip, caption, (left, 17), 10, MUTED)
        write(strip, value, (left, 36), size, INK, MEDIUM)


def legend_height(width: int) -> int:
    """Pixels that the legend takes at this width."""
    columns = max(1, (width - 2 * PAD_PX) // LEGEND_COLUMN_PX)
    return LEGEND_ROW_PX * -(-len(LEGEND) // columns) + 9


def draw_legend(area: Picture) -> None:
    """Draw every mark with its meaning, in place."""
    width = area.shape[1]
    columns = max(1, (width - 2 * PAD_PX) // LEGEND_COLUMN_PX)
    step = (width - 2 * PAD_PX) / columns
    polyline(area, np.array([(PAD_PX, 0.0), (width - PAD_PX - 1, 0.0)]), RULE)
    for k, (text, draw) in enumerate(LEGEND):
        row, column = divmod(k, columns)
        left, middle = PAD_PX + column * step, 15.0 + row * LEGEND_ROW_PX
        draw(area, np.array([left + 10.0, middle]))
        size = 11 if text_width(text, 11) <= step - 28 else 9
        write(area, text, (left + 25, middle + 4), size, INK)


def _square(reach: float) -> Points:
    return reach * np.array([(-1.3, -1.0), (1.3, -1.0), (1.3, 1.0), (-1.3, 1.0)])


def _swatch(colour: Rgb, opacity: float) -> Callable[[Picture, Points], None]:
    def draw(area: Picture, centre: Points) -> None:
        polygon(area, centre + _square(6.0), mixed(FLOOR, colour, opacity))

    return draw


def _robot(area: Picture, centre: Points) -> None:
    draw_disc(area, centre, 6.5, 0.0, OBSERVERS[0])


def _believed(area: Picture, centre: Points) -> None:
    oval = centre + circle_points((0.0, 0.0), 1.0) * (10.0, 7.5)
    polygon(area, oval, mixed(PAPER, OBSERVERS[0], 0.15))
    polyline(area, oval, OBSERVERS[0], closed=True)
    draw_outline(area, centre, 4.5, 0.0, OBSERVERS[0])


def _landmark(area: Picture, centre: Points) -> None:
    draw_disc(area, centre, 4.0, 0.0, OBSERVERS[0])
    draw_landmark(area, centre, 4.0, INK)


def _lost(area: Picture, centre: Points) -> None:
    draw_disc(area, centre, 6.5, 0.0, LOST)
    draw_cross(area, centre, 3.0, PAPER)


def _path(area: Picture, centre: Points) -> None:
    dashed(area, centre + np.array([(-10.0, 0.0), (10.0, 0.0)]), mixed(PICKETS[0], INK, 0.35), dash=4, gap=4)


def _dock(area: Picture, centre: Points) -> None:
    draw_dock(area, centre, "2", 7.0)


def _sight(area: Picture, centre: Points) -> None:
    dashed(area, centre + np.array([(-10.0, 0.0), (10.0, 0.0)]), OBSERVERS[0], dash=5, gap=3)


def _true_hazard(area: Picture, centre: Points) -> None:
    hatch(area, centre + _square(5.5), TRUE_HAZARDS["trap"], spacing=5)


def _goal(area: Picture, centre: Points) -> None:
    polygon(area, star_points(centre, 8.0), GOAL)
    polyline(area, star_points(centre, 8.0), INK, closed=True)


def _points(area: Picture, centre: Points) -> None:
    polygon(area, centre + _square(6.5), FLOOR)
    for k, colour in enumerate(HEIGHTS[:-1]):
        u, v = np.rint(centre + (5.0 * k - 8.0, (-3.0, 2.0, -1.0, 4.0)[k])).astype(int)
        area[v : v + 2, u : u + 2] = colour


def _ray(area: Picture, centre: Points) -> None:
    polyline(area, centre + np.array([(-10.0, 0.0), (10.0, 0.0)]), LASER)


LEGEND: tuple[tuple[str, Callable[[Picture, Points], None]], ...] = (
    ("robot", _robot),
    ("believed, 2σ", _believed),
    ("landmark", _landmark),
    ("lost robot", _lost),
    ("proven ground", _swatch(PROVEN, 0.42)),
    ("seen free", _swatch(SEEN_FREE, 0.26)),
    ("believed hazard", _swatch(HAZARD, 0.78)),
    ("believed wall", _swatch(OBSTACLE, 0.65)),
    ("hidden hazard", _true_hazard),
    ("measured point", _points),
    ("laser", _ray),
    ("believed path", _path),
    ("sees", _sight),
    ("in dock", _dock),
    ("goal", _goal),
)

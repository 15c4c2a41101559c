"""The top view of an episode: truth, belief and map in one picture."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.viewer.canvas import Picture, View, circle_points, dashed, hatch, polygon, polyline, star_points
from coop_envs.viewer.lettering import write
from coop_envs.viewer.palette import GOAL, INK, MUTED, PAPER, TRUE_HAZARDS, robot_colours
from coop_envs.viewer.panel import FIGURES_PX, draw_legend, legend_height, write_figures
from coop_envs.viewer.points import draw_points, draw_rays
from coop_envs.viewer.robots import Trail, draw_fields_of_view, draw_robots, draw_sight_lines, draw_trails
from coop_envs.viewer.terrain import hazard_outline, shaded_ground, tint_ground
from coop_envs.viewer.window import Bounds, episode_window

MIN_WIDTH_PX = 320


def draw(
    world: WorldPicture,
    frame: Frame,
    trail: Trail | None = None,
    size_px: int = 480,
    legend: bool = True,
    window: Bounds | None = None,
) -> Picture:
    """Picture of a frame, uint8 (height, width, 3) RGB, both even: the map over a strip of figures and a legend.

    The map shows ``window`` (x_min, y_min, x_max, y_max in metres) or the whole world; its longer side has ``size_px``
    pixels. Pictures of one world, size and size of window have one shape.
    """
    window = window or world.bounds
    view = View.fit(window, size_px)
    picture = _backdrop(world, window, size_px, legend).copy()
    area = picture[: view.height, : view.width]
    colours = robot_colours(frame.role)
    tint_ground(area, view, frame)
    if trail is not None:
        draw_points(area, view, world, trail.points_m)
    _draw_marks(area, view, world)
    draw_fields_of_view(area, view, world, frame)
    if trail is not None:
        draw_trails(area, view, trail, colours)
    draw_sight_lines(area, view, frame, colours)
    draw_rays(area, view, frame)
    draw_robots(area, view, frame)
    write_figures(picture[view.height : view.height + FIGURES_PX], frame)
    return picture


def draw_episode(
    world: WorldPicture, frames: Sequence[Frame], size_px: int = 480, legend: bool = True
) -> Iterator[Picture]:
    """The pictures of an episode one by one, with growing trails, as `write_video` takes them.

    All show the part of the world that the episode reaches.
    """
    trail, window = Trail.from_frames(frames), episode_window(world, frames)
    for k, frame in enumerate(frames):
        yield draw(world, frame, trail.until(k + 1), size_px, legend, window)


@functools.lru_cache(maxsize=8)
def _backdrop(world: WorldPicture, window: Bounds, size_px: int, legend: bool) -> Picture:
    """What does not change during an episode: shaded ground and legend."""
    view = View.fit(window, size_px)
    width = max(view.width, MIN_WIDTH_PX)
    width += width % 2
    height = view.height + FIGURES_PX + (legend_height(width) if legend else 0)
    picture = np.full((height + height % 2, width, 3), PAPER, np.uint8)
    picture[: view.height, : view.width] = shaded_ground(world, view)
    if legend:
        draw_legend(picture[view.height + FIGURES_PX :])
    return picture


def _draw_marks(area: Picture, view: View, world: WorldPicture) -> None:
    """Hidden hazards, start poses, goal and scale, in place."""
    for hazard in world.hazards:
        hatch(area, view.px(hazard_outline(hazard)), TRUE_HAZARDS[hazard.kind])
    for x, y, yaw in world.starts:
        chevron = np.array([(-0.5, 0.7), (0.5, 0.0), (-0.5, -0.7)]) * 6.0
        c, s = math.cos(yaw), math.sin(yaw)
        polyline(area, view.px((x, y)) + chevron @ np.array([[c, -s], [s, c]]).T * (1.0, -1.0), MUTED, 2)
    if world.goal is not None:
        x, y, radius = world.goal
        circle = circle_points((x, y), radius)
        dashed(area, view.px(np.concatenate([circle, circle[:1]])), INK)
        star = star_points(view.px((x, y)), max(7.0, min(11.0, 0.5 * radius * view.px_per_m)))
        polygon(area, star, GOAL)
        polyline(area, star, INK, closed=True)
    _draw_scale(area, view)


def _draw_scale(area: Picture, view: View) -> None:
    """A bar of a round length, about a sixth of the picture, in the lower left corner."""
    length_m = round_length(view.width / view.px_per_m / 6)
    left, base, right = 26.0, view.height - 24.0, 26.0 + length_m * view.px_per_m
    bar = np.array([(left, base - 4), (left, base), (right, base), (right, base - 4)])
    polyline(area, bar, PAPER, 4)
    polyline(area, bar, INK, 2)
    write(area, f"{length_m:g} m", (left + 3, base - 6), 11, INK, halo=PAPER)


def round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``length``."""
    decade = 10.0 ** math.floor(math.log10(length))
    return next(factor * decade for factor in (5, 2, 1) if factor * decade <= length)

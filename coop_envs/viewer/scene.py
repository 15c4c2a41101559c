"""A 3-D picture of an episode: the ground, what was measured of it, and where the robots went.

Matplotlib draws part upon part whatever lies in front, so points that the ground hides are found and left out here.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coop_envs.recording.frame import ACTIVE, DOCKED, Frame, WorldPicture
from coop_envs.viewer.canvas import Picture, circle_points
from coop_envs.viewer.palette import INK, LOST, MUTED, PAPER, Rgb, mixed, robot_colours
from coop_envs.viewer.plots import DPI, picture
from coop_envs.viewer.points import height_colours, height_span_m
from coop_envs.viewer.relief import (
    ELEVATION_DEG,
    Relief,
    belief_colours,
    hidden,
    lit_colours,
    towards_eye,
)
from coop_envs.viewer.robots import Trail, height_at, shown_poses
from coop_envs.viewer.window import Bounds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Axes3D = Any
"""Matplotlib's types of these are wrong where they exist."""
OVERSAMPLING = 2
SIZE_IN = (7.0, 5.6)
MARGIN_PX = 10
MOST_POINTS = 20_000
AZIMUTHS_DEG = (-60.0, -120.0, 120.0, 60.0)
"""From where the scene may be seen, in order of preference."""
LIGHT_FROM_EYE_DEG = 75.0
LIFT_M = 0.02
ROBOT_HEIGHT_M = 0.10
ROBOT_SIDES = 20


def scene(world: WorldPicture, frame: Frame, trail: Trail, window: Bounds) -> Picture:
    """`draw_scene` as a picture without empty margins."""
    fine = trimmed(picture(draw_scene(world, frame, trail, window)), OVERSAMPLING * MARGIN_PX)
    height, width = (length // OVERSAMPLING for length in fine.shape[:2])
    return cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)


def trimmed(image: Picture, margin_px: int) -> Picture:
    """The picture without the white around what is drawn, but for a margin."""
    darkest = image.min(axis=-1)
    rows, columns = (np.flatnonzero(darkest.min(axis=axis) < 255) for axis in (1, 0))
    if not len(rows):
        return image
    top, left = max(rows[0] - margin_px, 0), max(columns[0] - margin_px, 0)
    return image[top : rows[-1] + 1 + margin_px, left : columns[-1] + 1 + margin_px]


def draw_scene(world: WorldPicture, frame: Frame, trail: Trail, window: Bounds) -> Figure:
    """The part of the world in ``window`` (x_min, y_min, x_max, y_max), metres on all axes.

    It is seen from the side from which most of the points and paths show.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_IN, dpi=OVERSAMPLING * DPI)
    axes: Axes3D = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d", computed_zorder=False)
    relief = Relief.cut(world, window)
    points = _points(relief, trail)
    paths = _paths(world, trail)
    azimuth = best_azimuth_deg(relief, np.concatenate([points, paths[0].reshape(-1, 3)]))
    _frame_axes(axes, relief, azimuth)
    _draw_ground(axes, relief, frame, azimuth)
    _draw_points(axes, world, points[~hidden(relief, points, towards_eye(azimuth), 1.5 * relief.cell)])
    _draw_paths(axes, relief, frame, paths)
    _draw_robots(axes, world, relief, frame, azimuth)
    if len(points):
        _draw_height_scale(figure, height_span_m(world))
    return figure


def best_azimuth_deg(relief: Relief, points_m: NDArray[np.float64]) -> float:
    """The first of `AZIMUTHS_DEG` from which most of the points (k, 3) show, or nearly as many."""
    known = points_m[np.isfinite(points_m).all(axis=1)]
    some = known[:: max(1, len(known) // 2000)]
    shown = np.array([np.sum(~hidden(relief, some, towards_eye(a), 1.5 * relief.cell)) for a in AZIMUTHS_DEG])
    return AZIMUTHS_DEG[int(np.argmax(shown >= 0.95 * shown.max()))]


def _points(relief: Relief, trail: Trail) -> NDArray[np.float64]:
    """Measured points over the ground shown, every so many if there are very many."""
    points = trail.points_m[:: max(1, math.ceil(len(trail.points_m) / MOST_POINTS))]
    return points[np.isfinite(relief.height_at(points[:, :2]))]


def _paths(world: WorldPicture, trail: Trail) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """True and believed paths (t, n, 3) on the ground under the true robot, or under the believed one without truth."""
    known = np.isfinite(trail.true_xy).all(axis=-1, keepdims=True)
    z = height_at(world, np.where(known, trail.true_xy, trail.belief_xy)) + LIFT_M
    return np.dstack([trail.true_xy, z]).astype(float), np.dstack([trail.belief_xy, z]).astype(float)


def _frame_axes(axes: Axes3D, relief: Relief, azimuth_deg: float) -> None:
    """Limits, view, labels; a metre is as long on every axis."""
    low, high = relief.corner, relief.corner + relief.cell * (np.array(relief.z.shape) - 1)
    bottom, top = np.nanmin(relief.z, initial=relief.floor), np.nanmax(relief.z, initial=relief.floor)
    top = max(top, bottom + 0.3)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(bottom, top))
    axes.set_box_aspect((high[0] - low[0], high[1] - low[1], top - bottom), zoom=1.05)
    axes.set_proj_type("ortho")
    axes.view_init(ELEVATION_DEG, azimuth_deg)
    axes.set_xlabel("x (m)", fontsize=8)
    axes.set_ylabel("y (m)", fontsize=8)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set_visible(False)
        axis.line.set_color(_rgb(MUTED))
    axes.tick_params(labelsize=7, pad=0, color=_rgb(MUTED))
    axes.locator_params(axis="x", nbins=6)
    axes.locator_params(axis="y", nbins=6)
    ticks = _ticks(float(bottom), float(top), float(max(high - low)))
    axes.set_zticks(ticks, [f"{tick:g} m" for tick in ticks])
    axes.grid(visible=False)


def _ticks(low: float, high: float, length: float) -> list[float]:
    """A few round heights, none where a picture of this length (m) has no room for them."""
    step = next((step for step in (0.2, 0.5, 1.0) if step > 0.06 * length and step < high - low), math.inf)
    if not math.isfinite(step):
        return []
    return [round(step * k, 3) for k in range(math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6) + 1)]


def _draw_ground(axes: Axes3D, relief: Relief, frame: Frame, azimuth_deg: float) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    faces = relief.faces()
    if len(faces):
        light = towards_eye(azimuth_deg - LIGHT_FROM_EYE_DEG)
        colours = belief_colours(lit_colours(faces, light), faces, frame)
        ground = Poly3DCollection(faces, facecolors=colours, linewidths=0.0, antialiased=False, zorder=1)
        axes.add_collection3d(ground, autolim=False)


def _draw_points(axes: Axes3D, world: WorldPicture, points: NDArray[np.float64]) -> None:
    colours = height_colours(points[:, 2], height_span_m(world)) / 255
    axes.scatter(*points.T, c=colours, s=2.4, linewidths=0, depthshade=False, zorder=2)


def _draw_paths(
    axes: Axes3D, relief: Relief, frame: Frame, paths: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> None:
    """True paths as lines, believed paths dashed, within the relief."""
    for i, colour in enumerate(robot_colours(frame.role)[: paths[0].shape[1]]):
        for path, shade, width, style in (
            (paths[0][:, i], colour, 1.5, "solid"),
            (paths[1][:, i], mixed(colour, INK, 0.4), 0.9, (0, (3, 2))),
        ):
            shown = path[np.isfinite(path).all(axis=1)]
            shown = shown[np.isfinite(relief.height_at(shown[:, :2]))]
            axes.plot(*shown.T, color=_rgb(shade), linewidth=width, linestyle=style, zorder=3)


def _draw_robots(axes: Axes3D, world: WorldPicture, relief: Relief, frame: Frame, azimuth_deg: float) -> None:
    """Robots as drums with their names, the farthest first."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    poses, colours = shown_poses(frame), robot_colours(frame.role)
    z = height_at(world, poses[:, :2])
    inside = np.isfinite(relief.height_at(poses[:, :2])) & np.isfinite(z)
    out = np.flatnonzero(inside & (frame.status != DOCKED) & ~frame.collected)
    for i in out[np.argsort(poses[out, :2] @ towards_eye(azimuth_deg)[:2])]:
        colour = colours[i] if frame.status[i] == ACTIVE else LOST
        sides, top, nose = _drum(poses[i], float(z[i]), float(frame.body_radius_m[i]))
        shades = [_rgb(mixed(colour, INK, 0.25))] * len(sides) + [_rgb(mixed(colour, PAPER, 0.35)), _rgb(colour)]
        drum = Poly3DCollection([*sides, top, nose], facecolors=shades, linewidths=0.0, zsort="max", zorder=4)
        axes.add_collection3d(drum, autolim=False)
        name = frame.role[i][0].upper() + frame.names[i].rpartition("_")[2]
        place = (poses[i, 0], poses[i, 1], z[i] + ROBOT_HEIGHT_M + 0.08)
        axes.text(*place, name, fontsize=8, weight="bold", color=_rgb(mixed(colour, INK, 0.4)), ha="center", zorder=5)


def _drum(
    pose: NDArray[np.float64], z: float, radius: float
) -> tuple[list[NDArray[np.float64]], NDArray[np.float64], NDArray[np.float64]]:
    """Sides, top, and an arrowhead on the top, of a robot at a pose (x, y, yaw)."""
    rim = circle_points(pose[:2], radius, ROBOT_SIDES)
    low, high = (np.column_stack([rim, np.full(ROBOT_SIDES, z + h)]) for h in (0.0, ROBOT_HEIGHT_M))
    sides = [np.array([low[k - 1], low[k], high[k], high[k - 1]]) for k in range(ROBOT_SIDES)]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    arrow = np.array([(0.9, 0.0), (-0.4, 0.6), (-0.1, 0.0), (-0.4, -0.6)]) * radius @ np.array([[c, s], [-s, c]])
    return sides, high, np.column_stack([arrow + pose[:2], np.full(4, z + ROBOT_HEIGHT_M + 0.002)])


def _draw_height_scale(figure: Figure, span_m: tuple[float, float]) -> None:
    """What the points' colours mean."""
    axes = figure.add_axes((0.05, 0.93, 0.22, 0.016))
    colours = height_colours(np.linspace(*span_m, 128), span_m)
    axes.imshow(colours[None], aspect="auto", extent=(*span_m, 0.0, 1.0))
    axes.set_yticks([])
    axes.tick_params(labelsize=7, length=2, color=_rgb(MUTED))
    axes.set_title("height of measured points (m)", fontsize=7.5, loc="left", pad=3)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _rgb(colour: Rgb) -> tuple[float, float, float]:
    r, g, b = colour
    return r / 255, g / 255, b / 255

"""Robots in the top view: where they are, where they believe to be, what they see, where they have been."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.recording.frame import ACTIVE, DECLARED_LOST, DOCKED, Frame, WorldPicture
from coop_envs.viewer.canvas import (
    Picture,
    Points,
    View,
    blend,
    circle_points,
    dashed,
    disc,
    polygon,
    polyline,
)
from coop_envs.viewer.lettering import BOLD, text_width, write
from coop_envs.viewer.palette import INK, LOST, PAPER, Rgb, mixed, robot_colours
from coop_envs.viewer.terrain import LOWEST_M

SIGMAS = 2.0
SIGHT_BLOCK_M = 0.08
MIN_RADIUS_PX = 5.0
COLLECTED_PX = 5.0
MAX_TRAIL_POINTS = 500


@dataclass(frozen=True, eq=False)
class Trail:
    """What an episode left behind by each of t instants, world frame.

    true_xy, belief_xy
        (t, n, 2) true and believed positions of n robots; NaN where there is none.
    points_m, measured
        (k, 3) points measured, in the order of time; (t,) how many of them there were by each instant.
    """

    true_xy: NDArray[np.float64]
    belief_xy: NDArray[np.float64]
    points_m: NDArray[np.float64]
    measured: NDArray[np.int64]

    @classmethod
    def from_frames(cls, frames: Iterable[Frame]) -> Trail:
        """The trail over these frames of one episode; docked robots leave none."""
        true_xy, belief_xy, points = [], [], []
        for frame in frames:
            out = (frame.status != DOCKED)[:, None]
            true_xy.append(np.where(out, frame.true_xy_yaw[:, :2], np.nan))
            belief_xy.append(np.where(out, frame.belief_xy_yaw[:, :2], np.nan))
            points.append(frame.points_m)
        measured = np.cumsum([len(part) for part in points], dtype=np.int64)
        if not true_xy:
            return cls(np.empty((0, 0, 2)), np.empty((0, 0, 2)), np.empty((0, 3)), measured)
        return cls(np.array(true_xy), np.array(belief_xy), np.concatenate(points), measured)

    def until(self, count: int) -> Trail:
        """The trail over the first ``count`` instants."""
        measured = self.measured[:count]
        points_m = self.points_m[: measured[-1] if len(measured) else 0]
        return Trail(self.true_xy[:count], self.belief_xy[:count], points_m, measured)


def ellipse_points(mean_xy: NDArray[np.float64], cov_xy: NDArray[np.float64], count: int = 40) -> Points:
    """World points (count, 2) of the 2-sigma ellipse of a position with covariance (2, 2), m^2."""
    variance, axes = np.linalg.eigh(cov_xy)
    half_axes = SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    return mean_xy + (circle_points((0.0, 0.0), 1.0, count) * half_axes) @ axes.T


def sector_points(
    world: WorldPicture, pose: NDArray[np.float64], fov_rad: float, range_m: float, rays: int = 49
) -> Points:
    """World points (rays + 1, 2) around what a camera at ``pose`` (x, y, yaw) can see of the plan.

    A ray ends where the ground stands `SIGHT_BLOCK_M` higher than at the robot; this is for the picture alone.
    """
    x, y, yaw = pose
    angle = yaw + np.linspace(-fov_rad / 2, fov_rad / 2, rays)
    reach = min(range_m, math.hypot(world.bounds[2] - world.bounds[0], world.bounds[3] - world.bounds[1]))
    distance = np.arange(0.0, reach, max(0.5 * world.cell, reach / 500))
    points = pose[:2] + distance[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    heights = _height_or_deep(world, points)
    blocked = heights > _height_or_deep(world, pose[:2]) + SIGHT_BLOCK_M
    last = np.where(blocked.any(axis=0), blocked.argmax(axis=0), distance.size - 1)
    return np.concatenate([[(x, y)], points[last, np.arange(rays)]])


def height_at(world: WorldPicture, xy: NDArray[np.float64]) -> NDArray[np.float32]:
    """Height of the node nearest to points (..., 2), NaN where there is no ground."""
    away = np.nan_to_num((xy - np.asarray(world.origin)) / world.cell, nan=-1.0)
    i, j = np.moveaxis(np.rint(np.clip(away, -1.0, max(world.heights.shape))).astype(np.int64), -1, 0)
    nx, ny = world.heights.shape
    inside = (i >= 0) & (j >= 0) & (i < nx) & (j < ny)
    heights = world.heights[np.where(inside, i, 0), np.where(inside, j, 0)]
    return np.where(inside & (heights > LOWEST_M), heights, np.float32(np.nan))


def _height_or_deep(world: WorldPicture, xy: NDArray[np.float64]) -> NDArray[np.float32]:
    return np.nan_to_num(height_at(world, xy), nan=LOWEST_M)


def shown_poses(frame: Frame) -> NDArray[np.float64]:
    """Where robots are shown (n, 3): at their true poses, or at the believed ones where the truth is unknown."""
    known = np.isfinite(frame.true_xy_yaw).all(axis=-1, keepdims=True)
    return np.where(known, frame.true_xy_yaw, frame.belief_xy_yaw)


def draw_fields_of_view(picture: Picture, view: View, world: WorldPicture, frame: Frame) -> None:
    """Translucent sectors of the cameras that are out and working, in place."""
    layer = picture.copy()
    sectors: list[tuple[Points, Rgb]] = []
    poses = shown_poses(frame)
    for i, colour in enumerate(robot_colours(frame.role)):
        if frame.fov_rad[i] > 0 and frame.status[i] == ACTIVE and np.isfinite(poses[i]).all():
            points = view.px(sector_points(world, poses[i], frame.fov_rad[i], frame.range_m[i]))
            sectors.append((points, colour))
            polygon(layer, points, mixed(colour, PAPER, 0.25))
    blend(picture, layer, 0.16)
    for points, colour in sectors:
        polyline(picture, points, mixed(colour, PAPER, 0.55), closed=True)


def draw_trails(picture: Picture, view: View, trail: Trail, colours: list[Rgb]) -> None:
    """True paths as lines, believed paths dashed, in place."""
    stride = max(1, math.ceil(len(trail.true_xy) / MAX_TRAIL_POINTS))
    for i, colour in enumerate(colours[: trail.true_xy.shape[1]]):
        for xy, believed in ((trail.true_xy[:, i], False), (trail.belief_xy[:, i], True)):
            chosen = np.concatenate([xy[:-1:stride], xy[-1:]])
            points = view.px(chosen[np.isfinite(chosen).all(axis=-1)])
            if believed:
                dashed(picture, points, mixed(colour, INK, 0.35), dash=4, gap=4)
            else:
                polyline(picture, points, mixed(colour, PAPER, 0.45), width=2)


def draw_sight_lines(picture: Picture, view: View, frame: Frame, colours: list[Rgb]) -> None:
    """A dashed line from each camera to each hat it sees, in place."""
    for i, j in np.argwhere(frame.sees):
        ends = view.px(shown_poses(frame)[[i, j], :2])
        if np.isfinite(ends).all():
            dashed(picture, ends, colours[i], dash=6, gap=4)


def draw_robots(picture: Picture, view: View, frame: Frame) -> None:
    """True robots as discs with their heading, believed ones as outlines with 2-sigma ellipses, in place."""
    _draw_dock(picture, view, frame)
    colours = robot_colours(frame.role)
    placed = np.isfinite(shown_poses(frame)).all(axis=-1)
    for i in np.flatnonzero(placed & frame.collected).tolist():
        _draw_collected(picture, view, frame, i)
    out = np.flatnonzero(placed & (frame.status != DOCKED) & ~frame.collected).tolist()
    for i in sorted(out, key=lambda i: frame.status[i] == ACTIVE):
        _draw_true_robot(picture, view, frame, i, colours[i])
    for i in out:
        _draw_believed_robot(picture, view, frame, i, colours[i])
        _draw_ellipse(picture, view, frame, i, colours[i])
    for i in out:
        _label(picture, view, frame, i, colours[i])


def radius_px(view: View, body_radius_m: float) -> float:
    """Radius of a robot in the picture, never too small to be seen."""
    return max(MIN_RADIUS_PX, body_radius_m * view.px_per_m)


def _draw_ellipse(picture: Picture, view: View, frame: Frame, i: int, colour: Rgb) -> None:
    points = view.px(ellipse_points(frame.belief_xy_yaw[i, :2], frame.belief_cov_xy[i]))
    if frame.declared[i] != DECLARED_LOST and np.isfinite(points).all():
        polyline(picture, points, mixed(colour, INK, 0.6), 1, closed=True)


def _draw_true_robot(picture: Picture, view: View, frame: Frame, i: int, colour: Rgb) -> None:
    x, y, yaw = frame.true_xy_yaw[i]
    if not math.isfinite(x + y + yaw):
        return
    centre, radius = view.px((x, y)), radius_px(view, frame.body_radius_m[i])
    working = frame.status[i] == ACTIVE
    draw_disc(picture, centre, radius, yaw, colour if working else LOST)
    if working and frame.stationary[i]:
        draw_landmark(picture, centre, radius, INK)
    if not working:
        draw_cross(picture, centre, 0.45 * radius, PAPER, max(2, round(radius / 7)))


def _draw_collected(picture: Picture, view: View, frame: Frame, i: int) -> None:
    """A small cross where a robot was lost that has been taken away."""
    centre = view.px(frame.true_xy_yaw[i, :2])
    if np.isfinite(centre).all():
        draw_cross(picture, centre, COLLECTED_PX, PAPER, 4)
        draw_cross(picture, centre, COLLECTED_PX, mixed(LOST, INK, 0.5), 2)


def _draw_believed_robot(picture: Picture, view: View, frame: Frame, i: int, colour: Rgb) -> None:
    x, y, yaw = frame.belief_xy_yaw[i]
    if math.isfinite(x + y + yaw):
        lost = frame.declared[i] == DECLARED_LOST
        draw_outline(picture, view.px((x, y)), radius_px(view, frame.body_radius_m[i]), yaw, LOST if lost else colour)


def draw_disc(picture: Picture, centre: Points, radius: float, yaw: float, colour: Rgb) -> None:
    """A robot that is there: a disc with an arrowhead at its front."""
    disc(picture, centre, radius + 2.0, PAPER)
    disc(picture, centre, radius + 0.5, colour)
    disc(picture, centre, radius - 1.5, mixed(colour, PAPER, 0.5))
    arrow = np.array([(0.95, 0.0), (0.3, 0.5), (0.48, 0.0), (0.3, -0.5)]) * radius
    c, s = math.cos(yaw), math.sin(yaw)
    polygon(picture, centre + arrow @ np.array([[c, -s], [s, c]]).T * (1.0, -1.0), colour)


def draw_landmark(picture: Picture, centre: Points, radius: float, colour: Rgb) -> None:
    """The corners of a square around a robot that is declared stationary."""
    reach, arm = radius + 3.5, 0.45 * radius
    for side in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        bracket = centre + side * np.array([(reach - arm, reach), (reach, reach), (reach, reach - arm)])
        polyline(picture, bracket, PAPER, 4)
        polyline(picture, bracket, colour, 2)


def draw_cross(picture: Picture, centre: Points, reach: float, colour: Rgb, width: int = 2) -> None:
    """The cross on a robot that will not move again."""
    for direction in ((1.0, 1.0), (1.0, -1.0)):
        arm = reach * np.array(direction)
        polyline(picture, np.stack([centre - arm, centre + arm]), colour, width)


def draw_outline(picture: Picture, centre: Points, radius: float, yaw: float, colour: Rgb) -> None:
    """A robot that is believed to be there: a ring with a tick along its heading."""
    ring = mixed(colour, INK, 0.45)
    tick = np.stack([centre + length * radius * np.array([math.cos(yaw), -math.sin(yaw)]) for length in (1.0, 1.5)])
    for shade, width in ((PAPER, 3), (ring, 1)):
        disc(picture, centre, radius, shade, width)
        polyline(picture, tick, shade, width)


def draw_dock(picture: Picture, centre: Points, text: str, reach: float = 9.0) -> None:
    """The box that holds docked robots, and how many."""
    corners = centre + reach * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    polygon(picture, corners, PAPER)
    polyline(picture, corners, INK, 1, closed=True)
    size = round(1.35 * reach)
    write(picture, text, (centre[0] - text_width(text, size, BOLD) / 2, centre[1] + 0.5 * reach), size, INK, BOLD)


def _label(picture: Picture, view: View, frame: Frame, i: int, colour: Rgb) -> None:
    radius = radius_px(view, frame.body_radius_m[i])
    u, v = view.px(shown_poses(frame)[i, :2])
    name = frame.role[i][0].upper() + frame.names[i].rpartition("_")[2]
    shade = mixed(colour, INK, 0.3) if frame.status[i] == ACTIVE else mixed(LOST, INK, 0.5)
    offset = radius + 7 if frame.stationary[i] else 0.75 * radius + 3
    write(picture, name, (u + offset, v - 0.75 * radius - 2), 12, shade, BOLD, halo=PAPER)


def _draw_dock(picture: Picture, view: View, frame: Frame) -> None:
    docked = shown_poses(frame)[frame.status == DOCKED, :2]
    docked = docked[np.isfinite(docked).all(axis=-1)]
    if docked.size:
        draw_dock(picture, view.px(docked.mean(axis=0)), str(len(docked)))

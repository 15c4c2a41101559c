"""Measured points and the rays that measured them, coloured by height."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.viewer.canvas import Picture, View, blend, disc, polyline
from coop_envs.viewer.palette import HEIGHTS, LASER
from coop_envs.viewer.robots import radius_px, shown_poses
from coop_envs.viewer.terrain import floor_m, has_ground

LEAST_SPAN_M, MOST_SPAN_M = 0.2, 1.0
POINT_PX = 2
RING_PX = 7.0


def height_span_m(world: WorldPicture) -> tuple[float, float]:
    """Heights between which colours run: from the floor to the world's top, 0.2 m to 1 m above it."""
    ground = has_ground(world.heights)
    low = floor_m(world)
    top = float(world.heights[ground].max()) if ground.any() else low
    return low, low + min(max(top - low, LEAST_SPAN_M), MOST_SPAN_M)


def height_colours(heights_m: NDArray[np.float64], span_m: tuple[float, float]) -> NDArray[np.uint8]:
    """A colour (k, 3) for each height (k,), dark for low."""
    stops = np.linspace(*span_m, len(HEIGHTS))
    channels = [np.interp(heights_m, stops, channel) for channel in np.asarray(HEIGHTS, dtype=float).T]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


def draw_points(picture: Picture, view: View, world: WorldPicture, points_m: NDArray[np.float64]) -> None:
    """Points (k, 3) as small squares, the highest on top, in place."""
    points_m = points_m[np.argsort(points_m[:, 2])]
    corner = np.floor(view.px(points_m[:, :2]) - 0.5 * POINT_PX + 1.0).astype(int)
    inside = ((corner >= 0) & (corner + POINT_PX <= picture.shape[1::-1])).all(axis=1)
    colours = height_colours(points_m[inside, 2], height_span_m(world))
    u, v = corner[inside].T
    for across in range(POINT_PX):
        for down in range(POINT_PX):
            picture[v + down, u + across] = colours


def draw_rays(picture: Picture, view: View, frame: Frame) -> None:
    """Rays of lasers to the points that they lit since the frame before, and a ring round who scans, in place."""
    layer, places = picture.copy(), shown_poses(frame)[:, :2]
    for laser, point in zip(frame.point_robots[:, 0], frame.points_m, strict=True):
        if laser >= 0 and np.isfinite(places[laser]).all():
            polyline(layer, view.px(np.stack([places[laser], point[:2]])), LASER)
    blend(picture, layer, 0.6)
    for i in np.flatnonzero(frame.scanning & np.isfinite(places).all(axis=1)):
        disc(picture, view.px(places[i]), radius_px(view, frame.body_radius_m[i]) + RING_PX, LASER, width=2)

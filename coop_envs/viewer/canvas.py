"""Drawing in metres: where the world's points fall in a picture, and anti-aliased shapes at sub-pixel places.

Pictures are uint8 (height, width, 3), RGB. Pixel coordinates (u right, v down) have their integers at pixel centres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_envs.viewer.palette import Rgb

Picture = NDArray[np.uint8]
Points = NDArray[np.float64]
SUBPIXEL_BITS = 4
_SCALE = 1 << SUBPIXEL_BITS


@dataclass(frozen=True)
class View:
    """Top view of a rectangle of the world: x to the right, y up, the same scale on both axes."""

    x_min: float
    y_max: float
    px_per_m: float
    width: int
    height: int

    @classmethod
    def fit(cls, bounds: tuple[float, float, float, float], size_px: int, margin: float = 0.03) -> View:
        """The view of ``bounds`` (x_min, y_min, x_max, y_max) whose longer side has ``size_px`` pixels."""
        x_min, y_min, x_max, y_max = bounds
        pad = margin * max(x_max - x_min, y_max - y_min)
        width_m, height_m = x_max - x_min + 2 * pad, y_max - y_min + 2 * pad
        scale = size_px / max(width_m, height_m)
        return cls(x_min - pad, y_max + pad, scale, max(1, round(width_m * scale)), max(1, round(height_m * scale)))

    def px(self, xy: ArrayLike) -> Points:
        """Pixel coordinates (..., 2) of world points (..., 2) in metres."""
        xy = np.asarray(xy, dtype=np.float64)
        u = (xy[..., 0] - self.x_min) * self.px_per_m - 0.5
        v = (self.y_max - xy[..., 1]) * self.px_per_m - 0.5
        return np.stack([u, v], axis=-1)

    def world_from_px(self) -> NDArray[np.float64]:
        """(3, 3) matrix that maps homogeneous pixel coordinates to world coordinates: the inverse of `px`."""
        m = 1.0 / self.px_per_m
        return np.array([[m, 0.0, self.x_min + 0.5 * m], [0.0, -m, self.y_max - 0.5 * m], [0.0, 0.0, 1.0]])


def _fixed(points: Points) -> NDArray[np.int32]:
    return np.round(np.clip(points, -30000.0, 30000.0) * _SCALE).astype(np.int32)


def polyline(picture: Picture, points: Points, colour: Rgb, width: int = 1, closed: bool = False) -> None:
    """Line through pixel points (k, 2)."""
    if len(points) > 1:
        cv2.polylines(picture, [_fixed(points)], closed, colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def polygon(picture: Picture, points: Points, colour: Rgb) -> None:
    """Filled polygon of pixel points (k, 2)."""
    cv2.fillPoly(picture, [_fixed(points)], colour, cv2.LINE_AA, SUBPIXEL_BITS)


def disc(picture: Picture, centre: Points, radius: float, colour: Rgb, width: int = cv2.FILLED) -> None:
    """Filled disc, or circle of the given line width."""
    u, v = _fixed(centre)
    cv2.circle(picture, (int(u), int(v)), round(radius * _SCALE), colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def dashes(points: Points, dash: float, gap: float) -> list[Points]:
    """Pieces of the line through ``points``, ``dash`` pixels long and ``gap`` apart."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    starts = np.arange(0.0, along[-1], dash + gap)
    pieces: list[Points] = []
    for start in starts:
        end = min(start + dash, along[-1])
        inner = (along > start) & (along < end)
        stops = np.concatenate([[start], along[inner], [end]])
        pieces.append(np.stack([np.interp(stops, along, points[:, k]) for k in (0, 1)], axis=-1))
    return pieces


def dashed(picture: Picture, points: Points, colour: Rgb, width: int = 1, dash: float = 5.0, gap: float = 4.0) -> None:
    """Dashed line through pixel points (k, 2)."""
    pieces = [_fixed(piece) for piece in dashes(points, dash, gap)] if len(points) > 1 else []
    if pieces:
        cv2.polylines(picture, pieces, False, colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def circle_points(centre: ArrayLike, radius: float, count: int = 48) -> Points:
    """Points (count, 2) of a circle, counter-clockwise from +x."""
    angle = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def star_points(centre: Points, radius: float) -> Points:
    """Corners (10, 2) of a five-pointed star in pixels, one point up."""
    angle = -math.pi / 2 + np.arange(10) * math.pi / 5
    reach = np.where(np.arange(10) % 2 == 0, radius, 0.42 * radius)
    return centre + reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def blend(picture: Picture, layer: Picture, opacity: float) -> None:
    """Mix ``layer`` into the picture, in place; where they agree nothing changes."""
    cv2.addWeighted(layer, opacity, picture, 1.0 - opacity, 0.0, dst=picture)


def hatch(picture: Picture, outline: Points, colour: Rgb, spacing: float = 7.0, width: int = 1) -> None:
    """Fill a polygon of pixel points (k, 2) with diagonal lines and outline it."""
    low, high = np.floor(outline.min(axis=0)), np.ceil(outline.max(axis=0)) + 1
    low, high = np.maximum(low, 0).astype(int), np.minimum(high, picture.shape[1::-1]).astype(int)
    if (high <= low).any():
        return
    region = picture[low[1] : high[1], low[0] : high[0]]
    inside = np.zeros(region.shape[:2], np.uint8)
    cv2.fillPoly(inside, [_fixed(outline - low)], (255,), cv2.LINE_AA, SUBPIXEL_BITS)
    lined = region.copy()
    height, length = region.shape[0], sum(region.shape[:2])
    phase = -((low[0] + low[1]) % spacing)
    for start in np.arange(phase, length, spacing):
        polyline(lined, np.array([[start, 0.0], [start - height, height]]), colour, width)
    share = inside[..., None].astype(np.uint16)
    region[:] = ((lined * share + region * (255 - share)) // 255).astype(np.uint8)
    polyline(picture, outline, colour, width + 1, closed=True)

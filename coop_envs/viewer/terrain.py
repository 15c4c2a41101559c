"""The ground under the robots: shaded heights, hidden hazards, and what the team believes of it."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from coop_envs.recording.frame import Frame, HazardOutline, WorldPicture
from coop_envs.viewer.canvas import Picture, Points, View
from coop_envs.viewer.palette import FLOOR, HAZARD, HIGH_GROUND, LOW_GROUND, NO_GROUND, OBSTACLE, PROVEN, SEEN_FREE

LOWEST_M = -100.0
TALL_M = 0.25
RELIEF = 1.5
LIGHT = (-0.5025, 0.5025, 0.7035)
"""Unit vector towards the light, world axes: from the upper left of the picture."""
OVERSAMPLING = 2


def has_ground(heights: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Where there is ground: neither NaN nor a depth that stands for none."""
    return np.isfinite(heights) & (heights > LOWEST_M)


def shaded_ground(world: WorldPicture, view: View) -> Picture:
    """Picture of the terrain: pale floor, walls dark, lit from the upper left."""
    fine = View(
        view.x_min,
        view.y_max,
        view.px_per_m * OVERSAMPLING,
        view.width * OVERSAMPLING,
        view.height * OVERSAMPLING,
    )
    ground = has_ground(world.heights)
    floor = floor_m(world)
    node_from_world = np.diag([1 / world.cell, 1 / world.cell, 1.0])
    node_from_world[:2, 2] = -np.asarray(world.origin) / world.cell
    node_from_px = (node_from_world @ fine.world_from_px())[:2]
    filled = np.where(ground, world.heights, floor).astype(np.float32)
    heights_m = _resampled(filled - floor, node_from_px, fine, cv2.INTER_LINEAR, 0)
    present = _resampled(ground.astype(np.uint8), node_from_px, fine, cv2.INTER_NEAREST, 0)

    tall = np.clip(heights_m / max(TALL_M, float(heights_m.max())), 0, 1)[..., None] ** 0.6
    deep = np.clip(-heights_m / max(TALL_M, -float(heights_m.min())), 0, 1)[..., None] ** 0.6
    level, high, low = np.asarray((FLOOR, HIGH_GROUND, LOW_GROUND), dtype=np.float32)
    colour = level * (1 - tall - deep) + high * tall + low * deep
    colour = np.where(present[..., None] > 0, colour * _shade(heights_m, fine.px_per_m)[..., None], NO_GROUND)
    picture = np.clip(colour, 0, 255).astype(np.uint8)
    return cv2.resize(picture, (view.width, view.height), interpolation=cv2.INTER_AREA).astype(np.uint8)


def floor_m(world: WorldPicture) -> float:
    """Height from which tall and deep are told: where the first robot starts, else the middle of all."""
    ground = has_ground(world.heights)
    for start in world.starts[:1]:
        i, j = np.rint((np.array(start[:2]) - world.origin) / world.cell).astype(int)
        if 0 <= i < ground.shape[0] and 0 <= j < ground.shape[1] and ground[i, j]:
            return float(world.heights[i, j])
    return float(np.median(world.heights[ground])) if ground.any() else 0.0


def _shade(heights_m: NDArray[np.float32], px_per_m: float) -> NDArray[np.float32]:
    """Lambert shading relative to flat ground, 0.55..1.15."""
    down, right = np.gradient(RELIEF * px_per_m * heights_m)
    lit = (LIGHT[2] - LIGHT[0] * right + LIGHT[1] * down) / np.sqrt(1.0 + right**2 + down**2)
    return np.clip(1.0 + 0.45 * (lit - LIGHT[2]), 0.55, 1.15)


def _resampled(grid: NDArray, node_from_px: NDArray[np.float64], view: View, how: int, beyond: int) -> NDArray:
    """Values of a grid (nx, ny) at the view's pixels; ``node_from_px`` is (2, 3)."""
    return cv2.warpAffine(
        np.ascontiguousarray(grid),
        node_from_px[::-1].copy(),
        (view.width, view.height),
        flags=how | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(beyond,) * 4,
    )


def belief_tint(frame: Frame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Colour (nx, ny, 3) and opacity (nx, ny) of each map cell.

    Green is proven by bodies, blue seen free by scans, orange a hazard, slate an obstacle.
    """
    ground = frame.map_ground.astype(np.float64)
    obstacle = np.clip((frame.map_obstacle.astype(np.float64) - 128) / 127, 0, 1)
    free = np.clip((128 - frame.map_obstacle.astype(np.float64)) / 128, 0, 1)
    proven = np.clip((ground - 128) / 127, 0, 1)
    hazard = np.clip((128 - ground) / 128, 0, 1)
    opacities = np.stack([0.42 * proven, 0.78 * hazard, 0.65 * obstacle, 0.26 * free], axis=-1)
    chosen = opacities.argmax(axis=-1)
    return np.asarray((PROVEN, HAZARD, OBSTACLE, SEEN_FREE), dtype=np.float64)[chosen], opacities.max(axis=-1)


def tint_ground(picture: Picture, view: View, frame: Frame) -> None:
    """Lay the belief's map over the picture, in place."""
    if frame.map_ground.size == 0:
        return
    colour, opacity = belief_tint(frame)
    light = (colour * opacity[..., None]).astype(np.uint8)
    shadow = np.repeat(255 - (255 * opacity[..., None]).astype(np.uint8), 3, axis=-1)
    x, y, yaw = frame.T_world_map
    c, s = math.cos(yaw), math.sin(yaw)
    T_map_world = np.array([[c, s, -c * x - s * y], [-s, c, s * x - c * y], [0.0, 0.0, 1.0]])
    cell_from_map = np.array([[1 / frame.cell_m, 0.0, -0.5], [0.0, 1 / frame.cell_m, -0.5], [0.0, 0.0, 1.0]])
    cell_from_px = (cell_from_map @ T_map_world @ view.world_from_px())[:2]
    area = picture[: view.height, : view.width]
    light, shadow = (_resampled(x, cell_from_px, view, cv2.INTER_NEAREST, b) for x, b in ((light, 0), (shadow, 255)))
    cv2.add(cv2.multiply(area, shadow, scale=1 / 255), light, dst=area)


def hazard_outline(hazard: HazardOutline) -> Points:
    """World points (k, 2) around a hazard, counter-clockwise."""
    quarter = np.linspace(0.0, math.pi / 2, 9) if hazard.radius_m > 0 else np.array([math.pi / 4])
    angle = np.concatenate([quarter + k * math.pi / 2 for k in range(4)])
    corner = np.repeat([(1, 1), (-1, 1), (-1, -1), (1, -1)], quarter.size, axis=0) * np.asarray(hazard.half_size_m)
    local = corner + hazard.radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    c, s = math.cos(hazard.yaw_rad), math.sin(hazard.yaw_rad)
    return local @ np.array([[c, s], [-s, c]]) + np.asarray(hazard.centre_m)

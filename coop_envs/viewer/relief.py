"""The ground as faces in space, coarse enough to be drawn at once, and what it hides from the eye."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.viewer.terrain import belief_tint, floor_m, has_ground
from coop_envs.viewer.window import Bounds

ELEVATION_DEG = 50.0
LEVEL = 0.5
"""Least upward part of the unit normal of a face that shows what is believed of its cell."""
MOST_FACES = 14_000
HEADROOM_M = 0.6
DEPTH_M = 0.6
STONE = (226, 225, 221)


def towards_eye(azimuth_deg: float) -> NDArray[np.float64]:
    """Unit vector towards an eye far away, at an azimuth counter-clockwise from x."""
    up, turn = math.radians(ELEVATION_DEG), math.radians(azimuth_deg)
    return np.array([math.cos(up) * math.cos(turn), math.cos(up) * math.sin(turn), math.sin(up)])


@dataclass(frozen=True, eq=False)
class Relief:
    """Ground within a window: node ``[i, j]`` of ``z`` (m, NaN for no ground) stands at ``corner + cell * (i, j)``.

    It is cut off `HEADROOM_M` above the floor, so that high walls do not hide everything, and `DEPTH_M` under it.
    """

    corner: NDArray[np.float64]
    cell: float
    z: NDArray[np.float64]
    floor: float

    @classmethod
    def cut(cls, world: WorldPicture, window: Bounds, most_faces: int = MOST_FACES) -> Relief:
        """The ground within the window; of every square of so many nodes the highest, lest thin walls get lost."""
        last = np.array(world.heights.shape) - 1
        first = np.floor((np.array(window[:2]) - world.origin) / world.cell).astype(int).clip(0, last)
        end = np.ceil((np.array(window[2:]) - world.origin) / world.cell).astype(int).clip(first, last) + 1
        heights = world.heights[first[0] : end[0], first[1] : end[1]]
        stride = max(1, math.ceil(math.sqrt(heights.size / most_faces)))
        floor = floor_m(world)
        cut = np.clip(heights, floor - DEPTH_M, floor + HEADROOM_M)
        z = _block_max(np.where(has_ground(heights), cut, np.nan), stride)
        corner = np.array(world.origin) + world.cell * (first + 0.5 * (stride - 1))
        return cls(corner, stride * world.cell, z, floor)

    def height_at(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height (...) of the nearest node to points (..., 2); NaN where there is no ground."""
        at = np.rint((np.nan_to_num(xy, nan=1e6) - self.corner) / self.cell).astype(int)
        inside = np.asarray(((at >= 0) & (at < self.z.shape)).all(axis=-1))
        i, j = np.where(inside[..., None], at, 0).reshape(-1, 2).T
        return np.where(inside, self.z[i, j].reshape(inside.shape), np.nan)

    def faces(self) -> NDArray[np.float64]:
        """Quadrilaterals (f, 4, 3) between four nodes that there are."""
        x, y = (self.corner[k] + self.cell * np.arange(self.z.shape[k]) for k in (0, 1))
        nodes = np.stack([*np.meshgrid(x, y, indexing="ij"), self.z], axis=-1)
        quads = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2).reshape(-1, 4, 3)
        return quads[np.isfinite(quads).all(axis=(1, 2))]


def _block_max(z: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """The highest of every square block of nodes; NaN where all are."""
    pad = [(0, -length % side) for length in z.shape]
    blocks = np.pad(z, pad, constant_values=np.nan)
    blocks = blocks.reshape(blocks.shape[0] // side, side, blocks.shape[1] // side, side)
    return np.fmax.reduce(np.fmax.reduce(blocks, axis=3), axis=1)


def normals(faces: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit normals (f, 3) of faces (f, 4, 3)."""
    normal = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


def lit_colours(faces: NDArray[np.float64], light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Stone, (f, 3) in 0..1, for faces (f, 4, 3) under a light in the direction of a unit vector."""
    share = 0.60 + 0.40 * np.clip(normals(faces) @ light / light[2], 0.0, 1.1)
    return np.clip(np.array(STONE) / 255 * share[:, None], 0.0, 1.0)


def belief_colours(colours: NDArray[np.float64], faces: NDArray[np.float64], frame: Frame) -> NDArray[np.float64]:
    """The colours (f, 3) with the belief's map laid over the level faces, as in the top view."""
    if frame.map_ground.size == 0:
        return colours
    tint, opacity = belief_tint(frame)
    x, y, yaw = frame.T_world_map
    c, s = math.cos(yaw), math.sin(yaw)
    local = (faces[..., :2].mean(axis=1) - (x, y)) @ np.array([[c, -s], [s, c]])
    at = np.floor(local / frame.cell_m).astype(int)
    inside = ((at >= 0) & (at < opacity.shape)).all(axis=1)
    i, j = np.where(inside[:, None], at, 0).T
    share = np.where(inside & (normals(faces)[:, 2] > LEVEL), opacity[i, j], 0.0)[:, None]
    return colours * (1.0 - share) + tint[i, j] / 255 * share


def hidden(
    relief: Relief, points_m: NDArray[np.float64], eye: NDArray[np.float64], tolerance_m: float
) -> NDArray[np.bool_]:
    """Which points (k, 3) lie behind ground that stands more than ``tolerance_m`` above their line towards the eye."""
    highest = np.nanmax(relief.z, initial=relief.floor)
    steps = np.arange(1.0, max(2.0, (highest - relief.floor + DEPTH_M) / eye[2] / relief.cell))
    found = np.zeros(len(points_m), dtype=bool)
    for along in steps * relief.cell:
        ray = points_m + along * eye
        found |= relief.height_at(ray[:, :2]) > ray[:, 2] + tolerance_m
    return found

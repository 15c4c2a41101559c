"""The ground as a camera sees it: a homography between pixels and the plane the robot stands on.

Source: thesis 2.2.3 (homography from the VelociRoACH's four corners and their pixels).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coop_envs.agents.specification import Camera
from coop_envs.agents.team import Member
from coop_envs.errors import ConfigError

RECTANGLE_M = (0.14, 0.10)  # a VelociRoACH, Table 2.1
RECTANGLE_AHEAD_M = 0.5
NEAREST_M = 0.05


class GroundView:
    """Maps pixels (u, v) to the ground (forward, left) in metres from the robot's centre, and back.

    The ground is taken as level and lens distortion is left out; both matter little within a few robot lengths.
    """

    def __init__(self, member: Member) -> None:
        if member.camera is None:
            raise ConfigError(f"team.{member.name}.cameras", 0, "a camera on the robot that watches the others")
        import cv2

        self.camera = member.camera
        self._height_m = member.robot.body_height_m + member.camera.position_m[2]
        corners = np.array([(RECTANGLE_AHEAD_M + RECTANGLE_M[0] * i, RECTANGLE_M[1] * (j - 0.5)) for i, j in _CORNERS])
        pixels = np.array([self._project(forward, left) for forward, left in corners])
        self._ground_from_pixel = cv2.getPerspectiveTransform(pixels.astype(np.float32), corners.astype(np.float32))
        self._pixel_from_ground = np.linalg.inv(self._ground_from_pixel)

    def to_ground(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Ground points (..., 2), forward and left of the robot's centre, of pixels (..., 2) below the horizon."""
        p = np.asarray(pixels, dtype=np.float64)
        q = np.concatenate([p, np.ones((*p.shape[:-1], 1))], axis=-1) @ self._ground_from_pixel.T
        return q[..., :2] / q[..., 2:]

    def to_pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (k, 2) of ground points (k, 2) before the camera; not a number for those behind it."""
        homogeneous = np.column_stack([points, np.ones(len(points))]) @ self._pixel_from_ground.T
        pixels = homogeneous[:, :2] / homogeneous[:, 2:]
        pixels[points[:, 0] < self.camera.position_m[0] + NEAREST_M] = np.nan
        return pixels

    def row_of(self, range_m: float) -> float:
        """The image row in which the ground straight ahead of the camera is this far away."""
        return self._project(self.camera.position_m[0] + range_m, self.camera.position_m[1])[1]

    @property
    def half_width_rad(self) -> float:
        """Half the horizontal field of view."""
        return math.atan2(0.5 * self.camera.width_px, self.camera.fx_px)

    def _project(self, forward: float, left: float) -> tuple[float, float]:
        """Pixel of a ground point, by the pinhole model; the camera looks along body x, tilted down."""
        x, y, _ = self.camera.position_m
        c, s = math.cos(self.camera.pitch_down_rad), math.sin(self.camera.pitch_down_rad)
        ahead, below = forward - x, self._height_m
        depth, down = c * ahead + s * below, -s * ahead + c * below
        return _pixel(self.camera, (y - left) / depth, down / depth)


_CORNERS = ((0, 0), (0, 1), (1, 1), (1, 0))


def _pixel(camera: Camera, right: float, down: float) -> tuple[float, float]:
    return camera.cx_px + camera.fx_px * right, camera.cy_px + camera.fy_px * down

"""Systematic calibration error: the true camera and hat of a robot differ from those that its team believes in.

Errors are drawn once for each team key and robot and stay for the episode.
"""

from __future__ import annotations

import warp as wp

from coop_envs.geometry.keyed_random import draw_key, normal2, normal3
from coop_envs.sensing.camera import CameraModel

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FOCAL_CHANNEL, CENTRE_CHANNEL, HAT_CHANNEL = wp.constant(3072), wp.constant(3073), wp.constant(3074)


@wp.struct
class CalibrationError:
    """Standard deviations: focal length as a share, centre in pixels, each coordinate of an LED's place in m."""

    focal_share: float
    centre: float
    hat: float


@wp.func
def true_camera(camera: CameraModel, error: CalibrationError, key: wp.uint64, robot: int) -> CameraModel:
    """The camera that robot really carries, if it is believed to be ``camera``."""
    out = camera
    if error.focal_share > 0.0 or error.centre > 0.0:
        scale = 1.0 + error.focal_share * normal2(draw_key(key, 0, robot, FOCAL_CHANNEL))[0]
        out.focal = camera.focal * scale
        out.centre = camera.centre + normal2(draw_key(key, 0, robot, CENTRE_CHANNEL)) * error.centre
    return out


@wp.func
def true_led(position: wp.vec3, error: CalibrationError, key: wp.uint64, robot: int, led: int) -> wp.vec3:
    """Where an LED really is in the body, if it is believed at ``position``."""
    out = position
    if error.hat > 0.0:
        out = position + normal3(key, 0, robot, HAT_CHANNEL + 2 * led) * error.hat
    return out

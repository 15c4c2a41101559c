"""A pinhole camera with plumb-bob distortion, as OpenCV and ROS define it. Camera z forward, x right, y down."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FIXED_POINT_STEPS = wp.constant(3)
INVERSION_STEPS = wp.constant(12)
INVERTED = wp.constant(wp.float64(1.0e-22))


class Calibration(Protocol):
    """What a camera's description must hold: image size, intrinsics, distortion (k1, k2, p1, p2, k3), mounting."""

    @property
    def width_px(self) -> int: ...
    @property
    def height_px(self) -> int: ...
    @property
    def fx_px(self) -> float: ...
    @property
    def fy_px(self) -> float: ...
    @property
    def cx_px(self) -> float: ...
    @property
    def cy_px(self) -> float: ...
    @property
    def distortion(self) -> tuple[float, float, float, float, float]: ...
    @property
    def position_m(self) -> tuple[float, float, float]: ...
    @property
    def pitch_down_rad(self) -> float: ...
    @property
    def max_range_m(self) -> float: ...
    @property
    def shake_rad(self) -> float: ...


@wp.struct
class CameraModel:
    """``fitted`` is 0 on a robot without a camera. ``R_body_camera``, ``p_body_camera`` mount it; f and c in pixels.

    ``fold`` is where the distortion model ends, see `fold_tan2`; ``shake`` (rad, rms) how far the camera turns about
    each of its axes while its robot drives.
    """

    fitted: int
    R_body_camera: wp.mat33
    p_body_camera: wp.vec3
    focal: wp.vec2
    centre: wp.vec2
    size: wp.vec2
    radial: wp.vec3
    tangential: wp.vec2
    fold: float
    max_range: float
    shake: float


def body_from_camera(pitch_down_rad: float) -> NDArray[np.float64]:
    """R_body_camera (3, 3) of a camera looking along body x, tilted towards the ground."""
    s, c = np.sin(pitch_down_rad), np.cos(pitch_down_rad)
    return np.array([[0.0, -s, c], [-1.0, 0.0, 0.0], [0.0, -c, -s]])


def fold_tan2(k1: float, k2: float, k3: float) -> float:
    """Squared tangent of the angle off the axis at which radial distortion turns points back into the image.

    Infinite where it never does.
    """
    slope_is_zero = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
    tan2 = slope_is_zero.real[(np.abs(slope_is_zero.imag) < 1e-9) & (slope_is_zero.real > 0)]
    return float(np.min(tan2, initial=np.inf))


def camera_model(calibration: Calibration | None) -> CameraModel:
    """Pack a calibration for the device; None makes a camera that is not fitted."""
    model = CameraModel()
    if calibration is None:
        return model
    k1, k2, p1, p2, k3 = calibration.distortion
    model.fitted = 1
    model.R_body_camera = wp.mat33(*np.ravel(body_from_camera(calibration.pitch_down_rad)))
    model.p_body_camera = wp.vec3(*calibration.position_m)
    model.focal = wp.vec2(calibration.fx_px, calibration.fy_px)
    model.centre = wp.vec2(calibration.cx_px, calibration.cy_px)
    model.size = wp.vec2(float(calibration.width_px), float(calibration.height_px))
    model.radial, model.tangential = wp.vec3(k1, k2, k3), wp.vec2(p1, p2)
    model.fold, model.max_range = fold_tan2(k1, k2, k3), calibration.max_range_m
    model.shake = calibration.shake_rad
    return model


@wp.func
def project(camera: CameraModel, p_camera: wp.vec3) -> wp.vec2:
    """Pixel (u, v) of a point before the camera (z > 0).

    Source: OpenCV's camera model (k1, k2, p1, p2, k3).
    """
    x = p_camera[0] / p_camera[2]
    y = p_camera[1] / p_camera[2]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (camera.radial[0] + r2 * (camera.radial[1] + r2 * camera.radial[2]))
    p1 = camera.tangential[0]
    p2 = camera.tangential[1]
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return wp.vec2(camera.focal[0] * xd + camera.centre[0], camera.focal[1] * yd + camera.centre[1])


@wp.func
def bearing_d(camera: CameraModel, uv: wp.vec2d) -> wp.vec3d:
    """Unit direction in camera axes of the ray behind a pixel, in double precision; zero where there is none.

    Inverts `project` by a fixed point, then by Newton's method; a pixel has no answer beyond the model's fold.
    """
    k1 = wp.float64(camera.radial[0])
    k2 = wp.float64(camera.radial[1])
    k3 = wp.float64(camera.radial[2])
    p1 = wp.float64(camera.tangential[0])
    p2 = wp.float64(camera.tangential[1])
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    six = wp.float64(6.0)
    xd = (uv[0] - wp.float64(camera.centre[0])) / wp.float64(camera.focal[0])
    yd = (uv[1] - wp.float64(camera.centre[1])) / wp.float64(camera.focal[1])
    x = wp.float64(xd)
    y = wp.float64(yd)
    left = wp.float64(1.0)
    for step in range(INVERSION_STEPS):
        r2 = x * x + y * y
        radial = one + r2 * (k1 + r2 * (k2 + r2 * k3))
        dx = two * p1 * x * y + p2 * (r2 + two * x * x)
        dy = p1 * (r2 + two * y * y) + two * p2 * x * y
        ex = xd - x * radial - dx
        ey = yd - y * radial - dy
        left = ex * ex + ey * ey
        if left < INVERTED:
            break
        if step < FIXED_POINT_STEPS:
            x = (xd - dx) / radial
            y = (yd - dy) / radial
        else:
            slope = two * (k1 + r2 * (two * k2 + r2 * wp.float64(3.0) * k3))
            a = radial + x * x * slope + two * p1 * y + six * p2 * x
            b = x * y * slope + two * (p1 * x + p2 * y)
            d = radial + y * y * slope + two * p2 * x + six * p1 * y
            det = a * d - b * b
            if det <= wp.float64(0.0):
                break
            x = x + (d * ex - b * ey) / det
            y = y + (a * ey - b * ex) / det
    if not (left < INVERTED and x * x + y * y <= wp.float64(camera.fold)):
        return wp.vec3d()
    return wp.normalize(wp.vec3d(x, y, one))


@wp.func
def bearing(camera: CameraModel, uv: wp.vec2) -> wp.vec3:
    """Unit direction in camera axes of the ray behind a pixel; zero where there is none (see `bearing_d`)."""
    return wp.vec3(bearing_d(camera, wp.vec2d(uv)))


@wp.func
def in_view(camera: CameraModel, p_camera: wp.vec3) -> bool:
    """Whether a point lies before the camera, in range and inside the image."""
    if p_camera[2] < 0.03 or wp.length(p_camera) > camera.max_range:
        return False
    if p_camera[0] * p_camera[0] + p_camera[1] * p_camera[1] > camera.fold * p_camera[2] * p_camera[2]:
        return False
    uv = project(camera, p_camera)
    return uv[0] >= 0.0 and uv[1] >= 0.0 and uv[0] <= camera.size[0] - 1.0 and uv[1] <= camera.size[1] - 1.0

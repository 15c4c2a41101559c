from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_camera
from coop_envs.agents.specification import Camera
from coop_envs.sensing.camera import body_from_camera, camera_model
from tests.geometry.kernels import on_device
from tests.sensing.kernels import bearings, exact_bearings, pixels, views

CAMERAS = {name: load_camera(name) for name in ("lifecam", "ch6")}


def matrix(camera: Camera) -> np.ndarray:
    return np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])


def opencv_pixels(camera: Camera, points, distorted=True):
    """What OpenCV projects the points (n, 3) to."""
    distortion = np.array(camera.distortion) * distorted
    return cv2.projectPoints(np.asarray(points), np.zeros(3), np.zeros(3), matrix(camera), distortion)[0].reshape(-1, 2)


def before_the_lens(camera: Camera, pixels_px):
    """Points a metre ahead that OpenCV says appear at the pixels."""
    rays = cv2.undistortPoints(pixels_px[:, None], matrix(camera), np.array(camera.distortion))
    return np.column_stack([rays.reshape(-1, 2), np.ones(len(rays))])


@pytest.mark.parametrize("name", CAMERAS)
def test_projection_equals_opencvs(name):
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (2000, 2)), np.ones(2000)]) * rng.uniform(0.1, 3.0, (2000, 1))
    points = points.astype(np.float32)
    found = on_device(pixels, camera_model(CAMERAS[name]), points)
    np.testing.assert_allclose(found, opencv_pixels(CAMERAS[name], points), atol=1e-3)


@pytest.mark.parametrize("name", CAMERAS)
def test_the_image_is_in_view_up_to_its_edges(name):
    camera = CAMERAS[name]
    u, v = np.meshgrid(np.linspace(0, camera.width_px - 1, 9), np.linspace(0, camera.height_px - 1, 7))
    border = (u == u.min()) | (u == u.max()) | (v == v.min()) | (v == v.max())
    centre = np.array([(camera.width_px - 1) / 2, (camera.height_px - 1) / 2])
    edge = np.column_stack([u[border], v[border]])
    inside, outside = centre + 0.999 * (edge - centre), centre + 1.001 * (edge - centre)
    seen = [on_device(views, camera_model(camera), before_the_lens(camera, p)) for p in (inside, outside)]
    assert np.all(seen[0] == 1) and np.all(seen[1] == 0)


def test_range_and_depth_bound_the_view():
    camera = CAMERAS["ch6"]
    axis = np.array([[0.0, 0.0, z] for z in (-1.0, 0.0, 0.02, 0.04, 2.999, 3.001)])
    np.testing.assert_array_equal(on_device(views, camera_model(camera), axis), [0, 0, 0, 1, 1, 0])


@pytest.mark.parametrize("name", CAMERAS)
def test_nothing_far_off_the_axis_is_in_view(name):
    """Distortion polynomials fold back: far outside the image they would bring points into it again."""
    camera = CAMERAS[name]
    off_axis, around = np.meshgrid(np.linspace(0.5, 1.55, 211), np.linspace(-np.pi, np.pi, 73))
    off_axis, around = off_axis.ravel(), around.ravel()
    point = np.stack([np.sin(off_axis) * np.cos(around), np.sin(off_axis) * np.sin(around), np.cos(off_axis)], -1)
    ideal, size = opencv_pixels(camera, point, distorted=False), np.array([camera.width_px, camera.height_px])
    far = np.any((ideal < -50) | (ideal > size + 50), axis=1)
    assert not np.any(on_device(views, camera_model(camera), point[far]))


def image_grid(camera: Camera, count=41):
    """Pixels (count^2, 2) from corner to corner."""
    u, v = np.meshgrid(np.linspace(0, camera.width_px - 1, count), np.linspace(0, camera.height_px - 1, count))
    return np.column_stack([u.ravel(), v.ravel()])


WARPED = replace(CAMERAS["ch6"], distortion=(-0.28, 0.09, 0.001, -0.002, -0.01))


@pytest.mark.parametrize("camera", [*CAMERAS.values(), WARPED], ids=[*CAMERAS, "warped"])
def test_bearings_are_the_rays_behind_the_pixels(camera):
    uv = image_grid(camera)
    found = on_device(exact_bearings, camera_model(camera), uv)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    stored = replace(camera, **{n: float(np.float32(getattr(camera, n))) for n in ("fx_px", "fy_px", "cx_px", "cy_px")})
    stored = replace(stored, distortion=tuple(float(np.float32(k)) for k in camera.distortion))
    assert np.abs(opencv_pixels(stored, found) - uv).max() < 1e-6
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    K, distortion = matrix(stored), np.array(stored.distortion)
    theirs = cv2.undistortPoints(uv[:, None], K, distortion, criteria=criteria).reshape(-1, 2)
    np.testing.assert_allclose(found[:, :2] / found[:, 2:], theirs, atol=1e-8)
    single = on_device(bearings, camera_model(camera), uv)
    np.testing.assert_allclose(single, found, atol=2e-7)


def test_beyond_the_fold_there_is_no_bearing():
    folded = replace(CAMERAS["ch6"], distortion=(-0.8, 0.0, 0.0, 0.0, 0.0))
    uv = np.array([[319.5, 239.5], [639.0, 479.0], [1e6, 0.0], [np.nan, 0.0]])
    found = on_device(bearings, camera_model(folded), uv)
    np.testing.assert_array_equal(found, [[0, 0, 1], [0, 0, 0], [0, 0, 0], [0, 0, 0]])


@settings(deadline=None)
@given(st.floats(-1.4, 1.4))
def test_a_camera_is_mounted_by_its_pitch(pitch_down):
    R = body_from_camera(pitch_down)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    right, down, forward = R.T
    np.testing.assert_allclose(forward, [np.cos(pitch_down), 0.0, -np.sin(pitch_down)], atol=1e-15)
    np.testing.assert_allclose(right, [0.0, -1.0, 0.0], atol=1e-15)
    assert down[2] < 0


def test_a_robot_without_a_camera_has_none_fitted():
    assert camera_model(None).fitted == 0
    assert camera_model(CAMERAS["ch6"]).fitted == 1

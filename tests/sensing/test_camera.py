from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_camera
from coop_envs.agents.specification import Camera
from coop_envs.sensing.camera import body_from_camera, camera_model
from tests.geometry.kernels import on_device
from tests.sensing.kernels import pixels, views

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

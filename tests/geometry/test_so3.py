from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from tests.geometry.kernels import exponentials, headings, logarithms, nearest_rotations, on_device, standing, wrapped

TINY_TO_PI = [0.0, 1e-12, 1e-9, 0.9e-4, 1.1e-4, 1e-3, 0.1, 1.0, 2.0, 3.0, np.pi - 1e-3]
"""Angles on both sides of the branches at 1e-9 and 1e-4 rad."""

angles = st.floats(-3.0, 3.0, width=32)
vectors = arrays(np.float64, 3, elements=st.floats(-1.8, 1.8))


def axes(count):
    v = np.random.default_rng(1).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def exp(w):
    return on_device(exponentials, np.atleast_2d(w))


def log(r):
    return on_device(logarithms, np.reshape(r, (-1, 3, 3)))


@pytest.mark.parametrize("angle", TINY_TO_PI)
def test_exponential_equals_scipys(angle):
    w = axes(50) * angle
    np.testing.assert_allclose(exp(w), Rotation.from_rotvec(w).as_matrix(), rtol=0, atol=4e-15)


@pytest.mark.parametrize("angle", TINY_TO_PI)
def test_logarithm_equals_scipys(angle):
    w = axes(50) * angle
    r = Rotation.from_rotvec(w).as_matrix()
    np.testing.assert_allclose(log(r), w, rtol=1e-6, atol=1e-12)


@settings(deadline=None)
@given(vectors, vectors, vectors)
def test_rotations_are_a_group(a, b, c):
    A, B, C = exp(np.stack([a, b, c]))
    for R in (A, B, A @ B):
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-14)
    np.testing.assert_allclose(A @ exp(-a)[0], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(exp(A @ b)[0], A @ B @ A.T, atol=1e-13)


@settings(deadline=None)
@given(vectors)
def test_turning_twice_is_turning_by_twice_the_angle(w):
    np.testing.assert_allclose(exp(2 * w)[0], exp(w)[0] @ exp(w)[0], atol=1e-13)


@settings(deadline=None)
@given(vectors)
def test_logarithm_undoes_the_exponential(w):
    if np.linalg.norm(w) < 3.1:
        np.testing.assert_allclose(log(exp(w))[0], w, rtol=1e-9, atol=1e-12)


def test_orthonormal_leaves_second_order_errors():
    rng = np.random.default_rng(2)
    for size in (1e-2, 1e-4, 1e-6):
        near = Rotation.random(30, rng=rng).as_matrix() + size * rng.normal(size=(30, 3, 3))
        nearest = np.array([polar(m)[0] for m in near])
        error = on_device(nearest_rotations, near) - nearest
        assert np.max(np.abs(error)) < 30 * size**2 + 1e-15


@settings(deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-1.4, 1.4), st.floats(-3.1, 3.1))
def test_heading_is_the_yaw_of_roll_pitch_yaw(yaw, pitch, roll):
    r = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    assert on_device(headings, r[None])[0] == pytest.approx(yaw, abs=1e-12)


@settings(deadline=None)
@given(st.floats(-100.0, 100.0, width=32))
def test_wrap_keeps_the_angle_and_stays_in_range(angle):
    (found,) = on_device(wrapped, np.array([angle], dtype=np.float32))
    assert -np.pi - 1e-5 <= found <= np.pi + 1e-5
    assert np.exp(1j * found) == pytest.approx(np.exp(1j * angle), abs=3e-5)


@settings(deadline=None)
@given(angles, st.floats(0.0, 1.375, width=32), angles)
def test_a_body_stands_upright_on_its_plane_and_keeps_its_heading(yaw, slope, downhill):
    normal = np.array([np.sin(slope) * np.cos(downhill), np.sin(slope) * np.sin(downhill), np.cos(slope)])
    (R,) = on_device(standing, normal[None].astype(np.float32), np.array([yaw], dtype=np.float32)).astype(float)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-6)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(R[:, 2], normal, atol=1e-6)
    level = np.hypot(R[0, 0], R[1, 0])
    np.testing.assert_allclose(R[:2, 0] / level, [np.cos(yaw), np.sin(yaw)], atol=1e-5)


@settings(deadline=None)
@given(angles)
def test_a_body_upside_down_keeps_its_heading(yaw):
    (R,) = on_device(standing, np.array([[0.1, 0.2, -1.0]]) / np.sqrt(1.05), np.array([yaw], dtype=np.float32))
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-6)
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(yaw, abs=1e-5)

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_camera
from coop_envs.sensing.camera import camera_model
from tests.geometry.kernels import on_device
from tests.sensing.kernels import factors, informations, inverses, solutions
from tests.sensing.scenes import matrix

CAMERA = replace(load_camera("lifecam"), distortion=(-0.25, 0.08, 0.003, -0.002, -0.01))


def random_poses(count):
    """(rotation, LED in the body, position) of bodies before a camera."""
    rng = np.random.default_rng(3)
    position = np.column_stack([rng.uniform(-0.4, 0.4, (count, 2)), np.ones(count)]) * rng.uniform(0.3, 3.0, (count, 1))
    return Rotation.random(count, rng=rng).as_matrix(), rng.uniform(-0.12, 0.12, (count, 3)), position


def pixel(R, led, position):
    distortion = np.array(CAMERA.distortion)
    return cv2.projectPoints(led[None], cv2.Rodrigues(R)[0], position, matrix(CAMERA), distortion)[0].ravel()


def numeric_jacobian(R, led, position, h=1e-5):
    """d pixel / d (theta, delta) for R = Exp(theta) R_true, p = p_true + delta."""

    def moved(error):
        turn = Rotation.from_rotvec(error[:3]).as_matrix()
        return pixel(turn @ R, led, position + error[3:])

    return np.column_stack([(moved(h * e) - moved(-h * e)) / (2 * h) for e in np.eye(6)])


def test_information_is_that_of_opencvs_projection():
    rotations, leds, positions = random_poses(50)
    noise = np.linspace(0.2, 2.0, 50)
    arms = np.einsum("nij,nj->ni", rotations, leds)
    found = on_device(informations, camera_model(CAMERA), arms, positions, noise)
    for R, led, position, sigma, information in zip(rotations, leds, positions, noise, found, strict=True):
        J = numeric_jacobian(R, led, position)
        np.testing.assert_allclose(information, J.T @ J / sigma**2, rtol=1e-4, atol=1e-4 * np.abs(information).max())


def positive_definite(seed):
    factor = np.random.default_rng(seed).normal(size=(6, 6))
    return factor @ factor.T + 0.1 * np.eye(6)


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_factor_and_inverse_equal_numpys(seed):
    a = positive_definite(seed)
    np.testing.assert_allclose(on_device(factors, a[None])[0], np.linalg.cholesky(a), atol=1e-11)
    np.testing.assert_allclose(on_device(inverses, a[None])[0], np.linalg.inv(a), rtol=1e-8, atol=1e-9)
    right = np.random.default_rng(seed).normal(size=6)
    np.testing.assert_allclose(on_device(solutions, a[None], right[None])[0], np.linalg.solve(a, right), rtol=1e-8)


@pytest.mark.parametrize("broken", [np.zeros((6, 6)), -np.eye(6), np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])])
def test_a_matrix_that_is_not_positive_definite_is_told_by_a_zero(broken):
    assert on_device(factors, broken[None])[0][0, 0] == 0.0


def test_what_few_leds_say_has_no_inverse():
    rotations, leds, positions = random_poses(2)
    for rows in (1, 2):
        arms = (rotations[:rows] @ leds[:rows, :, None])[..., 0]
        total = on_device(informations, camera_model(CAMERA), arms, positions[:rows], np.ones(rows)).sum(axis=0)
        assert np.linalg.matrix_rank(total) == 2 * rows

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from coop_envs.localization.planar import se2

TURNS = [0.7, -2.5, 2e-4, 5e-5, 0.0]


def matrix(pose):
    T = np.eye(3)
    T[:2, :2], T[:2, 2] = se2.rotation(pose[2]), pose[:2]
    return T


@pytest.mark.parametrize("turn", TURNS)
def test_exp_is_the_matrix_exponential_and_log_undoes_it(turn):
    twist = np.array([turn, 0.6, -0.3])
    generator = np.array([[0, -turn, 0.6], [turn, 0, -0.3], [0, 0, 0]])
    np.testing.assert_allclose(matrix(se2.exp(twist)), expm(generator), atol=1e-14)
    np.testing.assert_allclose(se2.log(se2.exp(twist)), twist, atol=1e-14)


@pytest.mark.parametrize("turn", TURNS)
def test_right_jacobian_against_finite_differences(turn):
    twist, step = np.array([turn, 0.6, -0.3]), 1e-6
    base = se2.inverse(se2.exp(twist))

    def moved(e):
        return se2.log(se2.composed(base, se2.exp(twist + e)))

    numeric = np.stack([(moved(step * e) - moved(-step * e)) / (2 * step) for e in np.eye(3)], 1)
    np.testing.assert_allclose(se2.right_jacobian(twist), numeric, atol=1e-9)


def test_adjoint_moves_a_step_across_a_pose():
    pose, step = np.array([1.0, -2.0, 2.5]), np.array([0.3, 0.2, -0.1])
    after, before = se2.exp(step), se2.exp(se2.adjoint(pose) @ step)
    np.testing.assert_allclose(se2.composed(pose, after), se2.composed(before, pose), atol=1e-14)


def test_composition_is_matrix_multiplication():
    a, b = np.array([[1.0, -2.0, 2.5], [0.1, 0.2, -3.0]]), np.array([[0.5, 0.4, 1.5], [3.0, 1.0, -2.0]])
    for x, y, z in zip(a, b, se2.composed(a, b), strict=True):
        np.testing.assert_allclose(matrix(z), matrix(x) @ matrix(y), atol=1e-14)
    np.testing.assert_allclose(se2.composed(a, se2.inverse(a)), 0.0, atol=1e-14)
    points = np.array([[0.3, 0.4], [2.0, -1.0]])
    np.testing.assert_allclose(se2.seen_from(a, se2.acted(a, points)), points, atol=1e-14)

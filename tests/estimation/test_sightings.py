from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from coop_envs.estimation.kalman import GATE_SIX
from coop_envs.sensing.poses import mat66d, vec6d
from tests.estimation.bench import (
    SIZE,
    Bench,
    camera_view,
    difference,
    numeric_jacobian,
    perturbed,
    run_compare,
    run_pose,
)

CAMERA_ROBOT, SEEN = 0, 2
NOISE = np.diag([4e-4, 3e-4, 5e-4, 1e-5, 2e-5, 3e-5])


@pytest.fixture
def bench():
    return Bench(seed=5)


def seen(bench, theta=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0), noise=NOISE):
    """Put a sighting that departs from the belief by theta and shift, in camera axes."""
    R, p = camera_view(bench.state(), CAMERA_ROBOT, SEEN)
    bench.sighting(CAMERA_ROBOT, SEEN, Rotation.from_rotvec(theta).as_matrix() @ R, p + shift, noise)


def model(bench):
    """The sighting's Jacobian (6, 15 n) by finite differences of homogeneous transforms."""
    nominal = bench.state()
    R_hat, p_hat = camera_view(nominal, CAMERA_ROBOT, SEEN)

    def moved(error):
        R, p = camera_view(perturbed(nominal, error), CAMERA_ROBOT, SEEN)
        return np.concatenate([Rotation.from_matrix(R @ R_hat.T).as_rotvec(), p - p_hat])

    return numeric_jacobian(moved, SIZE * bench.n)


def compared(bench):
    residual, S = wp.zeros(1, dtype=vec6d), wp.zeros(1, dtype=mat66d)
    bench.run(run_compare, bench.belief, bench.measured, bench.members, bench.rows, CAMERA_ROBOT, SEEN, residual, S)
    return residual.numpy()[0], S.numpy()[0], bench.rows.entries.numpy()[0, :, : SIZE * bench.n]


def updated(bench, update=True):
    done = wp.zeros(1, dtype=int)
    bench.run(
        run_pose,
        bench.belief,
        bench.measured,
        bench.members,
        bench.optics,
        bench.rows,
        CAMERA_ROBOT,
        SEEN,
        int(update),
        done,
    )
    return bool(done.numpy()[0])


def test_residual_is_the_departure_in_camera_axes(bench):
    seen(bench, theta=(0.02, -0.01, 0.03), shift=(0.01, 0.02, -0.03))
    np.testing.assert_allclose(compared(bench)[0], [0.02, -0.01, 0.03, 0.01, 0.02, -0.03], atol=1e-6)


def test_jacobian_with_lever_arm_and_pitched_camera(bench):
    seen(bench)
    H, P = model(bench), bench.P
    _, S, rows = compared(bench)
    scale = np.sqrt(np.diag(H @ P @ H.T))
    np.testing.assert_allclose(rows / scale[:, None], (H @ P) / scale[:, None], atol=1e-6 * np.abs(P).max() ** 0.5)
    np.testing.assert_allclose(S / np.outer(scale, scale), (H @ P @ H.T + NOISE) / np.outer(scale, scale), atol=1e-6)


def second_order(shift: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Spread of the camera's error of axes times the shift that a sighting shows."""
    axes = np.mean(np.diag(P)[15 * CAMERA_ROBOT : 15 * CAMERA_ROBOT + 3])
    out = np.zeros((6, 6))
    out[3:, 3:] = axes * (shift @ shift * np.eye(3) - np.outer(shift, shift))
    return out


def test_update_is_the_textbook_one(bench):
    seen(bench, theta=(0.01, -0.02, 0.015), shift=(0.005, 0.01, -0.008))
    H, P, nominal = model(bench), bench.P, bench.state()
    residual, _, _ = compared(bench)
    noise = NOISE + second_order(residual[3:], P)
    S = H @ P @ H.T + noise
    K = P @ H.T @ np.linalg.inv(S)
    joseph = (np.eye(len(P)) - K @ H) @ P @ (np.eye(len(P)) - K @ H).T + K @ noise @ K.T
    assert updated(bench)
    sigma = np.sqrt(np.diag(P))
    np.testing.assert_allclose(difference(bench.state(), nominal) / sigma, K @ residual / sigma, atol=1e-5)
    np.testing.assert_allclose(bench.P / np.outer(sigma, sigma), joseph / np.outer(sigma, sigma), atol=1e-6)
    np.testing.assert_array_equal(bench.P, bench.P.T)


def test_gate_is_that_of_one_in_a_thousand():
    assert float(GATE_SIX) == pytest.approx(chi2.ppf(0.999, 6), abs=0.01)


@pytest.mark.parametrize(("factor", "passes"), [(0.99, True), (1.01, False)])
def test_gate_refuses_and_leaves_everything_as_it_was(bench, factor, passes):
    seen(bench, shift=(1.0, 0.0, 0.0))
    residual, S, _ = compared(bench)
    length = np.sqrt(chi2.ppf(0.999, 6) / (residual @ np.linalg.solve(S, residual)))
    seen(bench, shift=(factor * length, 0.0, 0.0))
    P, nominal = bench.P, bench.state()
    assert updated(bench, update=False) is passes
    np.testing.assert_array_equal(bench.P, P)
    assert updated(bench) is passes
    if not passes:
        np.testing.assert_array_equal(bench.P, P)
        np.testing.assert_array_equal(difference(bench.state(), nominal), 0.0)


def test_covariance_stays_positive_definite_over_many_updates(bench):
    for k in range(300):
        seen(bench, theta=bench.rng.normal(size=3) * 0.02, shift=bench.rng.normal(size=3) * 0.004)
        assert updated(bench), k
    P = bench.P
    sigma = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(sigma, sigma)).min() > 1e-9
    np.testing.assert_array_equal(P, P.T)

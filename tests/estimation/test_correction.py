from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.bench import (
    SIZE,
    TEAM,
    TICK_S,
    TICKS,
    Bench,
    difference,
    numeric_jacobian,
    perturbed,
    run_odometry,
    run_rest,
)

R_INDEX = 1
ROBOT = TEAM.members[R_INDEX].robot


@pytest.fixture
def bench():
    return Bench(seed=7)


def kalman(P, H, noise, residual):
    """Textbook update: the error's mean and covariance (Joseph's form)."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + noise)
    A = np.eye(len(P)) - K @ H
    return K @ residual, A @ P @ A.T + K @ noise @ K.T


def jacobian(bench, function):
    """Of a function of robot 1's state, by finite differences, (k, 15 n)."""
    nominal = bench.state()
    return numeric_jacobian(lambda error: function(perturbed(nominal, error)), SIZE * bench.n)


def odometry_update(bench, speed):
    """Let both wheels roll at a speed (m/s) for a decision."""
    bench.measured.wheels.fill_(speed / ROBOT.wheel_radius_m)
    bench.run(run_odometry, bench.belief, bench.measured, bench.members, bench.model, bench.rows, R_INDEX)


def body_velocity(state):
    return state["rotation"][R_INDEX].T @ state["velocity"][R_INDEX]


def test_odometry_is_a_velocity_in_the_body(bench):
    nominal, P = bench.state(), bench.P
    lag = np.array([0.01, -0.02, 0.005])
    bench.set("lag", np.tile(lag, (bench.n, 1)))
    mean = body_velocity(nominal) - lag
    H = jacobian(bench, body_velocity)
    speed = 0.15
    odometry_update(bench, speed)
    shift = difference(bench.state(), nominal)
    residual = np.array([speed, 0.0, 0.0]) - mean
    noise = odometry_sigma(speed) ** 2 * np.eye(3)
    expected, covariance = kalman(P, H, noise, residual)
    sigma = np.sqrt(np.diag(P))
    np.testing.assert_allclose(shift / sigma, expected / sigma, atol=1e-4)
    np.testing.assert_allclose(bench.P / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=1e-5)


def odometry_sigma(speed):
    """Of the mean forward speed: two sides whose slip is a first-order process, as white noise of the same spectrum
    at zero; encoder noise; a floor of 4 mm/s."""
    slip_psd = 2.0 * ROBOT.slip**2 * ROBOT.slip_time_s
    side = np.sqrt(slip_psd / (TICK_S * TICKS) + ROBOT.odometry_noise**2) * abs(speed)
    return 0.004 + side / np.sqrt(2.0)


def test_wheels_that_turn_while_the_imu_tells_of_standing_are_not_believed(bench):
    bench.P = np.eye(SIZE * bench.n) * 1e-6
    bench.set("velocity", np.zeros((bench.n, 3)))
    odometry_update(bench, 0.3)
    assert bench.get("spinning").tolist() == [0, 1, 0]
    np.testing.assert_allclose(bench.get("velocity"), 0.0, atol=1e-12)


def test_they_are_believed_again_once_the_imu_tells_of_going(bench):
    bench.P = np.eye(SIZE * bench.n) * 1e-4
    bench.set("spinning", np.ones(bench.n))
    bench.set("velocity", 0.27 * bench.get("rotation")[:, :, 0])
    odometry_update(bench, 0.3)
    assert bench.get("spinning").tolist() == [1, 0, 1]
    assert 0.27 < body_velocity(bench.state())[0] < 0.3


def test_between_standing_and_going_wheels_do_not_count(bench):
    bench.P = np.eye(SIZE * bench.n) * 1e-6
    bench.set("velocity", 0.2 * bench.get("rotation")[:, :, 0])
    nominal = bench.state()
    odometry_update(bench, 0.3)
    np.testing.assert_array_equal(bench.get("spinning"), 0)
    np.testing.assert_array_equal(difference(bench.state(), nominal), 0.0)


def test_a_robot_at_rest_shows_bias_and_gravity(bench):
    bench.set("velocity", bench.rng.normal(size=(bench.n, 3)) * 1e-3)
    nominal, P = bench.state(), bench.P

    def readings(state):
        up = state["rotation"][R_INDEX].T @ [0.0, 0.0, 9.81]
        parts = [state["velocity"], state["gyro_bias"], state["accel_bias"] + up]
        return np.concatenate([np.atleast_2d(part)[R_INDEX] for part in parts])

    gyro, accel = readings(nominal)[3:].reshape(2, 3) + [[0.001, -0.0005, 0.0008], [0.05, -0.03, 0.02]]
    bench.imu(np.tile(gyro, (TICKS, 1)), np.tile(accel, (TICKS, 1)))
    H = jacobian(bench, readings)
    imu, span = ROBOT.imu, TICK_S * TICKS
    variances = [1e-6, imu.gyro_noise_rad_s_rthz**2 / span, imu.accel_noise_m_s2_rthz**2 / span]
    residual = np.concatenate([np.zeros(3), gyro, accel]) - readings(nominal)
    expected, covariance = kalman(P, H, np.diag(np.repeat(variances, 3)), residual)
    bench.run(run_rest, bench.belief, bench.measured, bench.members, bench.model, bench.rows, R_INDEX)
    sigma = np.sqrt(np.diag(P))
    shift = difference(bench.state(), nominal) / sigma
    # three updates in turn linearise anew where one would not: second order in the residual
    np.testing.assert_allclose(shift, expected / sigma, atol=0.02 * np.abs(expected / sigma).max())
    np.testing.assert_allclose(bench.P / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=5e-3)


def test_gravity_bounds_tilt_and_never_heading(bench):
    P = bench.P
    up = bench.get("rotation")[R_INDEX].T @ [0.0, 0.0, 9.81] + bench.get("accel_bias")[R_INDEX]
    bench.imu(np.zeros((TICKS, 3)), np.tile(up, (TICKS, 1)))
    for _ in range(50):
        bench.run(run_rest, bench.belief, bench.measured, bench.members, bench.model, bench.rows, R_INDEX)
    theta = np.s_[SIZE * R_INDEX : SIZE * R_INDEX + 3]
    before, after = P[theta, theta], bench.P[theta, theta]
    assert after[0, 0] < 0.05 * before[0, 0] and after[1, 1] < 0.05 * before[1, 1]
    free = np.linalg.inv(np.linalg.inv(before)[2:, 2:])[0, 0]
    assert after[2, 2] > 0.3 * free

"""The IMU against strapdown integration, and its noise against what white noise and random walks do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coop_envs.agents.specification import Imu
from tests.simulation.builders import (
    SILENT,
    ZUMY,
    calm,
    command,
    ground_of,
    physics_of,
    run,
    team_of,
    world_of,
)

TICK_S = 1.0 / 30.0
G = np.array([0.0, 0.0, 9.81])


def samples(physics):
    """(gyro, accel) of every team's robot 0 over the decision just taken (B, T, 3)."""
    measured = physics.measurements
    return measured.gyro.numpy()[:, 0].astype(float), measured.accel.numpy()[:, 0].astype(float)


def record(physics, seconds):
    """Gyro and accel (B, ticks, 3) over some time."""
    seen = run(physics, seconds, lambda: samples(physics))
    return (np.concatenate(part, axis=1) for part in zip(*seen, strict=True))


def noisy(**imu) -> Imu:
    return replace(SILENT, **imu)


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_at_rest_the_imu_feels_gravity_alone(heading):
    physics = physics_of(team_of(calm(ZUMY)), world_of(ground_of(lambda x, y: 0.3 * x), [(0.0, 0.0, heading)]))
    gyro, accel = record(physics, 0.4)
    R = physics.state.rotation.numpy()[0, 0].astype(float)
    np.testing.assert_allclose(gyro, 0.0, atol=1e-6)
    np.testing.assert_allclose(accel[0], np.tile(R.T @ G, (12, 1)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(accel, axis=-1), 9.81, rtol=1e-6)


def test_a_steady_circle_is_felt_as_centripetal_force():
    robot = calm(ZUMY)
    physics = physics_of(team_of(robot))
    command(physics, robot, 0.4, 1.5)
    run(physics, 3.0)
    gyro, accel = record(physics, 1.0)
    np.testing.assert_allclose(gyro[0], np.tile([0.0, 0.0, 1.5], (30, 1)), atol=1e-4)
    np.testing.assert_allclose(accel[0].mean(axis=0), [0.0, 0.4 * 1.5, 9.81], atol=0.02)


def hills(x, y):
    return 0.06 * np.sin(3.0 * x) * np.cos(2.5 * y) + 0.05 * x


def test_integrated_samples_follow_the_truth_over_hills():
    robot = calm(ZUMY)
    physics = physics_of(team_of(robot), world_of(ground_of(hills), [(-0.5, -0.3, 0.4)]))
    state = physics.state
    R = Rotation.from_matrix(state.rotation.numpy()[0, 0])
    p, v = state.position.numpy()[0, 0].astype(float), np.zeros(3)
    for speed, yaw_rate in [(0.3, 0.0), (0.2, 1.0), (0.0, -1.5), (-0.25, -0.6), (0.3, 0.9), (0.0, 0.0)]:
        command(physics, robot, speed, yaw_rate)
        gyro, accel = record(physics, 2.0)
        for rate, force in zip(gyro[0], accel[0], strict=True):
            a = R.apply(force) - G
            p = p + v * TICK_S + 0.5 * a * TICK_S**2
            v = v + a * TICK_S
            R = R * Rotation.from_rotvec(rate * TICK_S)
        assert np.linalg.norm(p - state.position.numpy()[0, 0]) < 0.003
        assert (R.inv() * Rotation.from_matrix(state.rotation.numpy()[0, 0])).magnitude() < 1e-4
        np.testing.assert_allclose(v, state.velocity.numpy()[0, 0], atol=1e-3)
    assert np.linalg.norm(v) < 1e-3
    assert state.path.numpy()[0, 0] > 1.5


def test_momentum_changes_by_the_force_on_the_robot():
    """Over a start and a stop the felt force, in the world, adds up to gravity's and to the momentum gained."""
    robot = calm(ZUMY)
    physics = physics_of(team_of(robot))
    command(physics, robot, 0.5)
    _, accel = record(physics, 2.0)
    np.testing.assert_allclose(accel[0].sum(axis=0) * TICK_S, 2.0 * G + [0.5, 0.0, 0.0], atol=1e-3)
    command(physics, robot, 0.0)
    _, accel = record(physics, 2.0)
    np.testing.assert_allclose(accel[0].sum(axis=0) * TICK_S, 2.0 * G - [0.5, 0.0, 0.0], atol=1e-3)


@pytest.mark.parametrize(("moving", "gyro_density", "accel_density"), [(False, 0.01, 0.05), (True, 0.03, 0.12)])
def test_white_noise_has_its_density(moving, gyro_density, accel_density):
    imu = noisy(
        gyro_noise_rad_s_rthz=0.01,
        accel_noise_m_s2_rthz=0.05,
        moving_gyro_noise_rad_s_rthz=0.02,
        moving_accel_noise_m_s2_rthz=0.07,
    )
    robot = replace(calm(ZUMY), imu=imu)
    physics = physics_of(team_of(robot), teams=400)
    command(physics, robot, 0.2 if moving else 0.0)
    run(physics, 2.0)
    gyro, accel = record(physics, 2.0)
    for signal, density in ((gyro, gyro_density), (accel - G, accel_density)):
        angle = signal.sum(axis=1) * TICK_S
        np.testing.assert_allclose(signal.std(axis=(0, 1)), density / np.sqrt(TICK_S), rtol=0.02)
        np.testing.assert_allclose(angle.std(axis=0), density * np.sqrt(2.0), rtol=4 / np.sqrt(800))
        np.testing.assert_allclose(angle.mean(axis=0), 0.0, atol=5 * density * np.sqrt(2.0 / 400))


def test_biases_start_with_their_spread_and_walk_like_brownian_motion():
    imu = noisy(gyro_bias_rad_s=0.01, accel_bias_m_s2=0.1, gyro_walk_rad_s2_rthz=0.002, accel_walk_m_s3_rthz=0.03)
    robot = replace(calm(ZUMY), imu=imu)
    physics = physics_of(team_of(robot), teams=600)
    gyro, accel = record(physics, 6.0)
    for signal, spread, walk in ((gyro, 0.01, 0.002), (accel - G, 0.1, 0.03)):
        np.testing.assert_allclose(signal[:, 0].std(axis=0), spread, rtol=4 / np.sqrt(1200))
        for ticks in (30, 120):
            gone = signal[:, ticks] - signal[:, 0]
            np.testing.assert_allclose(gone.std(axis=0), walk * np.sqrt(ticks * TICK_S), rtol=4 / np.sqrt(1200))


def test_an_imu_without_noise_repeats_itself():
    physics = physics_of(team_of(calm(ZUMY)), teams=2)
    gyro, accel = record(physics, 0.4)
    assert np.ptp(gyro) == 0.0 and np.all(accel == accel[0, 0])


def test_a_robot_without_imu_on_its_radio_seems_to_turn_as_its_wheels_do():
    robot = replace(calm(ZUMY), slip=0.3, slip_time_s=1e6, radio_imu=False)
    physics = physics_of(team_of(robot))
    command(physics, robot, 0.2, 1.0)
    run(physics, 2.0)
    before = float(physics.state.yaw.numpy()[0, 0])
    gyro, accel = record(physics, 1.0)
    np.testing.assert_allclose(gyro[0], np.tile([0.0, 0.0, 1.0], (30, 1)), atol=1e-4)
    np.testing.assert_allclose(accel[0], np.tile(G, (30, 1)))
    turned = float(physics.state.yaw.numpy()[0, 0]) - before
    assert abs(turned - 1.0) > 0.02, "tracks that slip turn the robot otherwise"

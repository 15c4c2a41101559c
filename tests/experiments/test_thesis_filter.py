"""The thesis's filter: its Jacobians against finite differences, its covariances against drawn noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_team
from coop_envs.sensing.camera import body_from_camera
from coop_envs.sensing.measurements import allocate_measurements
from experiments.thesis_filter import (
    ACCEL,
    GRAVITY,
    GYRO,
    POSITION,
    SIZE,
    THETA,
    VELOCITY,
    ThesisFilter,
    ThesisSettings,
)

TEAM = load_team("inchworm")
DT = 1.0 / 30.0
STEP = 1e-6


def made(settings=None, seed=0):
    """A filter over one team with robots anywhere, turned and moving."""
    rng = np.random.default_rng(seed)
    filter_ = ThesisFilter(TEAM, np.array([[[0.0, 0.0, 0.1], [0.8, 0.1, 0.4], [0.9, -0.2, -0.3]]]), settings)
    turn = Rotation.from_rotvec(rng.normal(0.0, 0.1, (3, 3))).as_matrix()
    filter_.rotation = turn @ filter_.rotation
    filter_.position = filter_.position + rng.normal(0.0, 0.05, (1, 3, 3))
    filter_.velocity = rng.normal(0.0, 0.1, (1, 3, 3))
    filter_.gyro_bias, filter_.accel_bias = rng.normal(0.0, 0.01, (1, 3, 3)), rng.normal(0.0, 0.1, (1, 3, 3))
    return filter_


def disturb(filter_, robot, error):
    """Apply an error (15,) to a robot: R = Exp(theta) R_hat, the rest by addition."""
    filter_.rotation[0, robot] = Rotation.from_rotvec(error[THETA]).as_matrix() @ filter_.rotation[0, robot]
    states = (filter_.position, POSITION), (filter_.velocity, VELOCITY), (filter_.gyro_bias, GYRO)
    for state, part in (*states, (filter_.accel_bias, ACCEL)):
        state[0, robot] += error[part]


def difference(a, b, robot):
    """The error (15,) of a against b."""
    theta = Rotation.from_matrix(a.rotation[0, robot] @ b.rotation[0, robot].T).as_rotvec()
    parts = (a.position - b.position, a.velocity - b.velocity, a.gyro_bias - b.gyro_bias, a.accel_bias - b.accel_bias)
    return np.concatenate([theta, *(part[0, robot] for part in parts)])


def told(gyro, accel):
    """Measurements of one tick in which no camera sees anybody."""
    measured = allocate_measurements(1, 3, 1, "cpu")
    measured.gyro.assign(np.broadcast_to(np.float32(gyro), (1, 3, 1, 3)))
    measured.accel.assign(np.broadcast_to(np.float32(accel), (1, 3, 1, 3)))
    return measured


def seen(filter_, j, p, R):
    measured = told([0.0, 0.0, 0.0], -GRAVITY)
    measured.seen.numpy()[0, 0, j] = 1
    measured.p_camera_body.numpy()[0, 0, j] = p
    measured.R_camera_body.numpy()[0, 0, j] = R
    return measured


def test_the_transition_is_the_derivative_of_the_propagation():
    settings = ThesisSettings(gyro_variance=0.0, accel_variance=0.0, gyro_walk=0.0, accel_walk=0.0)
    measured, moving = told([0.03, -0.02, 0.05], [0.4, 0.1, 9.7]), np.array([[False, True, False]])
    root = np.diag(np.linspace(0.5, 2.0, SIZE))
    base = made(settings)
    own = slice(SIZE, 2 * SIZE)
    base.covariance[0, own, own] = root @ root
    phi = np.zeros((SIZE, SIZE))
    for k in range(SIZE):
        ends = []
        for sign in (1.0, -1.0):
            moved = made(settings)
            disturb(moved, 1, sign * STEP * np.eye(SIZE)[k])
            moved.step(measured, moving, DT)
            ends.append(moved)
        phi[:, k] = difference(ends[0], ends[1], 1) / (2 * STEP)
    base.step(measured, moving, DT)
    np.testing.assert_allclose(base.covariance[0, own, own], phi @ root @ root @ phi.T, atol=2e-4)


def test_the_measurement_jacobian_is_the_derivative_of_the_prediction():
    base, who = made(seed=3), np.array([0])
    rng = np.random.default_rng(1)
    R_z = Rotation.from_rotvec(rng.normal(0.0, 1.0, 3)).as_matrix()[None]
    residual, H = base._compare(who, 2, *matching(base, 2))
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)
    for robot in (0, 2):
        for k in range(SIZE):
            rows = []
            for sign in (1.0, -1.0):
                moved = made(seed=3)
                disturb(moved, robot, sign * STEP * np.eye(SIZE)[k])
                rows.append(moved._compare(who, 2, *matching(base, 2))[0][0])
            slope = -(rows[0] - rows[1]) / (2 * STEP)
            np.testing.assert_allclose(H[0, :, SIZE * robot + k], slope, atol=1e-6)
    assert np.linalg.norm(base._compare(who, 2, R_z, matching(base, 2)[1])[0]) > 0.1


def matching(filter_, j):
    """The pose of picket j in the camera that the filter expects, by composing transforms."""
    camera = TEAM.members[0].cameras[0]
    T_body_camera, T_world_body, T_world_picket = (np.eye(4) for _ in range(3))
    T_body_camera[:3, :3], T_body_camera[:3, 3] = body_from_camera(camera.pitch_down_rad), camera.position_m
    T_world_body[:3, :3], T_world_body[:3, 3] = filter_.rotation[0, 0], filter_.position[0, 0]
    T_world_picket[:3, :3], T_world_picket[:3, 3] = filter_.rotation[0, j], filter_.position[0, j]
    T = np.linalg.inv(T_world_body @ T_body_camera) @ T_world_picket
    return T[None, :3, :3], T[None, :3, 3]


def test_the_covariance_of_a_pose_is_that_of_poses_fitted_to_noisy_pixels():
    from scipy.optimize import least_squares

    filter_, rng = made(), np.random.default_rng(5)
    hat, R = filter_.hats[1], Rotation.from_euler("y", 0.3).as_matrix() @ body_from_camera(0.0).T
    p, sigma_px = np.array([0.1, 0.0, 0.9]), 0.05

    def pixels(x):
        at = Rotation.from_rotvec(x[:3]).as_matrix() @ R @ hat.T + (p + x[3:])[:, None]
        return (at[:2] / at[2] * filter_.focal_px[:, None]).ravel()

    exact = pixels(np.zeros(6))
    noisy = exact + rng.normal(0.0, sigma_px, (400, exact.size))
    fits = [least_squares(lambda x, z=z: pixels(x) - z, np.zeros(6)).x for z in noisy]
    expected = filter_._pose_covariance(1, R[None], p[None])[0] * sigma_px**2
    found = np.cov(np.array(fits).T)
    np.testing.assert_allclose(np.diag(found), np.diag(expected), rtol=0.3)


def test_who_stands_is_not_propagated_and_has_no_velocity():
    filter_ = made()
    before = filter_.position.copy(), filter_.rotation.copy(), filter_.covariance.copy()
    filter_.step(told([0.5, 0.5, 0.5], [1.0, 2.0, 3.0]), np.zeros((1, 3), dtype=bool), DT)
    for now, then in zip((filter_.position, filter_.rotation, filter_.covariance), before, strict=True):
        np.testing.assert_array_equal(now, then)
    assert not filter_.velocity.any()


def test_a_first_sighting_places_a_picket_and_a_far_one_counts_for_nothing():
    truth, filter_ = made(seed=3), made(seed=3)
    filter_.position[0, 1] += [0.03, -0.02, 0.04]
    R, p = (a[0] for a in matching(truth, 1))
    far = replace(filter_.settings, range_m=0.1)
    blind = made(far, seed=3)
    blind.position = filter_.position.copy()
    for one in (filter_, blind):
        one.step(seen(one, 1, p, R), np.zeros((1, 3), dtype=bool), DT)
    np.testing.assert_allclose(filter_.position[0, 1], truth.position[0, 1], atol=1e-5)
    assert np.linalg.norm(blind.position[0, 1] - truth.position[0, 1]) > 0.05


def test_a_picket_left_out_is_not_heard_of():
    truth, filter_ = made(seed=3), made(seed=3)
    filter_.position[0, 1] += [0.03, 0.0, 0.0]
    R, p = (a[0] for a in matching(truth, 1))
    filter_.step(seen(filter_, 1, p, R), np.zeros((1, 3), dtype=bool), DT, np.array([True, False, True]))
    assert filter_.position[0, 1, 0] == pytest.approx(truth.position[0, 1, 0] + 0.03)


def test_without_a_motion_model_a_robot_stays_but_grows_unsure():
    filter_ = made(ThesisSettings(motion_model=False))
    before, sure = filter_.position.copy(), filter_.covariance[0, POSITION, POSITION].copy()
    moving = np.array([[True, False, False]])
    for _ in range(30):
        filter_.step(told([0.0, 0.0, 1.0], [5.0, 0.0, 9.81]), moving, DT)
    np.testing.assert_array_equal(filter_.position, before)
    grown = filter_.covariance[0, POSITION, POSITION] - sure
    np.testing.assert_allclose(np.diag(grown), filter_.settings.walk_m2_s, rtol=1e-6)

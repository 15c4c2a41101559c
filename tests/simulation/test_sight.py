"""Poses of hats: their errors against the covariance that comes with them, and what hides a hat."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from scipy import stats
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_camera, load_hat
from coop_envs.agents.specification import Battery
from coop_envs.sensing.camera import body_from_camera
from coop_envs.worlds.world import Hazard, Mesh
from tests.simulation.builders import (
    ROACH,
    ZUMY,
    calm,
    clock_of,
    ground_of,
    led_model,
    physics_of,
    run,
    team_of,
    world_of,
)

FRAME = clock_of(ticks=1)
ROBOT = calm(ZUMY)
CAMERA = load_camera("ch6")
HAT = load_hat("hat0")
TALL = calm(ROACH, height_m=0.16)


def face(*places, team=None, brightness=1.0, teams=1, **changes):
    """An observer at the origin looking along x, and others at these poses; one look of its camera."""
    leds = led_model(**{k: v for k, v in changes.items() if k in ("dropout", "outlier", "absorption", "noise_px")})
    rest = {k: v for k, v in changes.items() if k in ("ground", "mesh", "hazards")}
    team = team or team_of(ROBOT, *[ROBOT for _ in places])
    world = world_of(starts=[(0.0, 0.0, 0.0), *places], **rest)
    physics = physics_of(team, world, teams=teams, clock=FRAME, leds=leds)
    physics.command.brightness.numpy()[:] = brightness
    physics.step()
    return physics


def seen(physics, j=1):
    return physics.measurements.seen.numpy()[:, 0, j].astype(bool)


def truth(physics, j=1):
    """Rotation and position of robot j in robot 0's camera, by SciPy."""
    rotation = physics.state.rotation.numpy()[0].astype(float)
    position = physics.state.position.numpy()[0].astype(float)
    R_world_camera = rotation[0] @ body_from_camera(CAMERA.pitch_down_rad)
    eye = position[0] + rotation[0] @ CAMERA.position_m
    return R_world_camera.T @ rotation[j], R_world_camera.T @ (position[j] - eye)


def errors(physics, j=1):
    """(theta, delta) of every sighting (n, 6) and the reported covariances (n, 6, 6)."""
    found, out = seen(physics, j), physics.measurements
    R, p = truth(physics, j)
    turns = Rotation.from_matrix(out.R_camera_body.numpy()[found, 0, j].astype(float) @ R.T)
    shift = out.p_camera_body.numpy()[found, 0, j].astype(float) - p
    return np.concatenate([turns.as_rotvec(), shift], axis=1), out.covariance.numpy()[found, 0, j]


def sigma(physics, j=1):
    """Reported standard deviations (6,)."""
    return np.sqrt(np.diagonal(errors(physics, j)[1][0]))


@pytest.mark.parametrize("place", [(0.6, 0.1, 0.5), (1.5, -0.4, 2.0), (1.8, 0.6, -1.0)])
def test_errors_have_the_covariance_they_come_with(place):
    teams = 3000
    error, covariance = errors(face(place, teams=teams))
    assert len(error) == teams
    np.testing.assert_array_equal(covariance, np.broadcast_to(covariance[0], covariance.shape))
    white = np.linalg.solve(np.linalg.cholesky(covariance[0]), error.T).T
    assert np.all(np.abs(white.mean(axis=0)) < 4.5 / np.sqrt(teams))
    low, high = stats.chi2(6 * teams).ppf([1e-4, 1 - 1e-4])
    assert low < np.sum(white**2) < high
    for column in white.T:
        assert stats.kstest(column, "norm").pvalue > 1e-4
    np.testing.assert_allclose(np.cov(white, rowvar=False), np.eye(6), atol=7 / np.sqrt(teams))


def test_reported_deviations_are_those_of_a_pose_solver():
    """Pixels with noise, solved by OpenCV, scatter as `see` says; so close that every LED is at full signal."""
    physics = face((0.8, 0.1, 0.7), noise_px=0.3)
    R, p = truth(physics)
    shown = physics.labels.led.numpy()[0, 0, : physics.features.count.numpy()[0, 0]]
    leds = np.array([led.position_m for led in HAT.leds])[shown]
    K = np.array([[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1]])
    start = cv2.Rodrigues(R)[0], p.reshape(3, 1)
    pixels = cv2.projectPoints(leds, *start, K, None)[0].reshape(-1, 2)
    rng = np.random.default_rng(0)
    found = []
    for _ in range(1500):
        noisy = pixels + rng.normal(size=pixels.shape) * 0.3
        _, turn, shift = cv2.solvePnP(
            leds, noisy, K, None, start[0].copy(), start[1].copy(), useExtrinsicGuess=True, flags=cv2.SOLVEPNP_ITERATIVE
        )
        theta = Rotation.from_matrix(cv2.Rodrigues(turn)[0] @ R.T).as_rotvec()
        found.append(np.append(theta, shift.ravel() - p))
    np.testing.assert_allclose(np.std(found, axis=0), sigma(physics), rtol=0.08)


def test_the_pose_without_noise_is_the_true_one():
    error, _ = errors(face((1.0, 0.1, 0.5), noise_px=1e-6))
    np.testing.assert_allclose(error, 0.0, atol=2e-6)


def test_noise_follows_distance_and_brightness():
    near, far = sigma(face((0.8, 0.0, 0.0))), sigma(face((1.6, 0.0, 0.0)))
    assert far[5] / near[5] > 4.0 and np.all(far > near)
    dim = sigma(face((0.8, 0.0, 0.0), brightness=0.2))
    assert np.all(dim > 1.1 * near)
    np.testing.assert_allclose(dim[:5] / near[:5], dim[5] / near[5], rtol=0.2)


def test_dark_hats_and_murky_water_give_no_pose():
    assert seen(face((0.8, 0.0, 0.0)))[0]
    assert not seen(face((0.8, 0.0, 0.0), brightness=0.0))[0]
    assert not seen(face((0.8, 0.0, 0.0), absorption=8.0))[0]


def test_range_and_image_bound_the_sight():
    camera_edge = np.arctan2(CAMERA.width_px / 2, CAMERA.fx_px)
    for bearing, visible in ((camera_edge - 0.15, True), (camera_edge + 0.15, False), (np.pi, False)):
        assert seen(face((1.0 * np.cos(bearing), 1.0 * np.sin(bearing), 0.0)))[0] == visible
    broad = ground_of(lambda x, y: 0.0 * x, (-1.0, -1.0, 5.0, 1.0))
    assert seen(face((2.8, 0.0, 0.0), ground=broad))[0]
    assert not seen(face((3.2, 0.0, 0.0), ground=broad))[0]


def wall(height_m):
    return ground_of(lambda x, y: np.where(np.abs(x - 0.5) < 0.021, height_m, 0.0), cell_m=0.02)


@pytest.mark.parametrize(("height_m", "visible"), [(0.04, True), (0.3, False)])
def test_a_wall_hides_a_hat_and_a_kerb_does_not(height_m, visible):
    assert seen(face((1.0, 0.0, 0.0), ground=wall(height_m)))[0] == visible
    box = trimesh.creation.box(bounds=[[0.48, -2.0, 0.0], [0.52, 2.0, height_m]])
    mesh = Mesh(box.vertices.astype(np.float32), box.faces.astype(np.int32))
    assert seen(face((1.0, 0.0, 0.0), mesh=mesh))[0] == visible


def test_a_third_robot_hides_a_hat_behind_it():
    team = team_of(ROBOT, ROBOT, TALL)
    assert seen(face((1.5, 0.0, 0.0), (0.75, 0.4, 0.0), team=team))[0]
    blocked = face((1.0, 0.0, 0.0), (0.4, 0.0, 0.0), team=team)
    assert not seen(blocked, 1)[0]
    assert seen(face((0.4, 0.0, 0.0), (1.0, 0.0, 0.0), team=team), 1)[0]


def test_bodies_hide_leds_as_cylinders_do():
    """Of a hat half behind a third robot those LEDs count that trimesh sees past a cylinder of that robot's size."""
    hidden = []
    for y in np.linspace(-0.3, 0.3, 61):
        third = (0.5, y, 0.0)
        physics = face((1.0, 0.0, 0.3), third, team=team_of(ROBOT, ROBOT, TALL))
        R, position = physics.state.rotation.numpy()[0, 1], physics.state.position.numpy()[0]
        lamps = position[1] + np.array([led.position_m for led in HAT.leds]) @ R.T
        eye = position[0] + CAMERA.position_m
        body = trimesh.creation.cylinder(TALL.body_radius_m, TALL.height_m, sections=720)
        body.apply_translation([0.5, y, TALL.height_m / 2])
        rays = lamps - eye
        free = int(np.sum(~body.ray.intersects_any(np.tile(eye, (len(rays), 1)), rays)))
        hidden.append(free < 4)
        assert seen(physics, 1)[0] == (free >= 4), (y, free)
    assert 3 < sum(hidden) < 58


def test_sightings_drop_out_and_jump_at_their_rates():
    teams = 4000
    physics = face((1.0, 0.0, 0.0), teams=teams, dropout=0.1, outlier=0.05)
    lost = teams - seen(physics).sum()
    assert stats.binomtest(int(lost), teams, 0.1).pvalue > 1e-4
    error, covariance = errors(physics)
    surprise = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    assert stats.binomtest(int(np.sum(surprise > 40.0)), len(error), 0.05).pvalue > 1e-4


def test_the_swallowed_the_docked_the_dark_and_the_blind_are_not_seen():
    assert not seen(face((1.0, 0.0, 0.0), team=team_of(ROBOT, ROBOT, reserves=1)))[0]
    assert not run_and_see(hazards=[Hazard("hole", (1.0, 0.0), radius_m=0.1)])
    assert run_and_see(hazards=[Hazard("trap", (1.0, 0.0), radius_m=0.1)])
    flat = replace(ROBOT, battery=Battery(1.0, 0.5))
    assert not run_and_see(team=team_of(ROBOT, flat))
    assert not run_and_see(team=team_of(flat, ROBOT))


def run_and_see(**changes):
    physics = face((1.0, 0.0, 0.0), **changes)
    run(physics, 2.0)
    return seen(physics)[0]


def test_only_cameras_see_and_nobody_sees_himself():
    physics = face((1.0, 0.0, np.pi))
    np.testing.assert_array_equal(physics.measurements.seen.numpy()[0], [[0, 1], [0, 0]])


def test_tilted_observers_see_in_their_own_frame():
    slope = ground_of(lambda x, y: 0.2 * x + 0.1 * y)
    error, _ = errors(face((1.0, 0.2, 0.5), ground=slope, noise_px=1e-6))
    np.testing.assert_allclose(error, 0.0, atol=5e-6)


def test_the_ground_itself_hides_what_lies_behind_a_crest():
    crest = ground_of(lambda x, y: 0.15 * np.exp(-((x - 0.6) ** 2) / 0.02))
    assert not seen(face((1.2, 0.0, 0.0), ground=crest))[0]
    assert seen(face((1.2, 0.0, 0.0)))[0]

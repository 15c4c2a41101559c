"""Blobs of hats in true cameras: where they are, what hides them, what noise and loss do, what else shines."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from scipy import stats
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_camera, load_hat
from coop_envs.agents.team import Member, Team
from coop_envs.sensing.camera import body_from_camera
from coop_envs.sensing.solver import Answer
from coop_envs.simulation.calibration import CalibrationError
from tests.simulation.builders import ROACH, ZUMY, calm, clock_of, led_model, physics_of, world_of

LIFECAM = replace(load_camera("lifecam"), distortion=(-0.25, 0.08, 0.003, -0.002, -0.01))
FRAME = clock_of(ticks=1)
HAT = load_hat("hat0")
AHEAD = (0.9, 0.1, 0.6)


def team_of(camera=LIFECAM, hat=HAT, robot=ZUMY, pickets=1):
    seen = [Member(f"picket_{k}", "picket", calm(robot), hat=hat) for k in range(pickets)]
    return Team("team", (Member("observer_0", "observer", calm(ZUMY), (camera,)), *seen))


def shot(*places, teams=1, team=None, fidelity="poses", calibration=None, seed=0, **leds):
    """One frame of an observer at the origin that looks along x at robots in these poses."""
    team = team or team_of(pickets=len(places))
    world = world_of(starts=[(0.0, 0.0, 0.0), *places])
    settings = {"leds": led_model(**leds), "fidelity": fidelity, "calibration": calibration, "seed": seed}
    physics = physics_of(team, world, teams=teams, clock=FRAME, **settings)
    physics.command.brightness.numpy()[:] = 1.0
    physics.step()
    return physics


def blobs(physics, b=0):
    """LED (-1: none), pixel, hue of each blob in robot 0's frame."""
    n = physics.features.count.numpy()[b, 0]
    made = physics.labels.led, physics.features.pixel, physics.features.hue
    return [a.numpy()[b, 0, :n] for a in made]


def expected(physics, camera, hat=HAT, j=1):
    """Pixels of all LEDs of robot j by OpenCV."""
    rotation = physics.state.rotation.numpy()[0].astype(float)
    position = physics.state.position.numpy()[0].astype(float)
    R_world_camera = rotation[0] @ body_from_camera(camera.pitch_down_rad)
    eye = position[0] + rotation[0] @ camera.position_m
    lamps = position[j] + np.array([led.position_m for led in hat.leds]) @ rotation[j].T
    R = R_world_camera.T
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    return cv2.projectPoints(lamps, cv2.Rodrigues(R)[0], -R @ eye, K, np.array(camera.distortion))[0].reshape(-1, 2)


def test_pixels_are_those_of_opencvs_lens():
    physics = shot(AHEAD, noise_px=1e-6)
    led, uv, hue = blobs(physics)
    assert len(led) >= 4
    np.testing.assert_allclose(uv, expected(physics, LIFECAM)[led], atol=2e-3)
    np.testing.assert_allclose(hue, [HAT.leds[k].hue_deg for k in led], atol=1e-3)


@pytest.mark.parametrize(("robot", "hat"), [(ZUMY, "hat0"), (ZUMY, "zumy"), (ROACH, "hat1")])
@pytest.mark.parametrize("height_m", [0.02, 0.1, 0.3])
def test_the_carriers_body_hides_what_trimeshs_cylinder_hides(robot, hat, height_m):
    """Of every LED outside the body, from every side."""
    camera = replace(load_camera("ch6"), position_m=(0.0, 0.0, height_m), cy_px=140.0)
    worn = load_hat(hat)
    team = team_of(camera, worn, robot)
    body = trimesh.creation.cylinder(robot.body_radius_m, robot.height_m, sections=2000)
    body.apply_translation([0.7, 0.0, robot.height_m / 2])
    hidden = doubtful = 0
    for yaw in np.linspace(-np.pi, np.pi, 40):
        physics = shot((0.7, 0.0, yaw), team=team)
        seen = set(blobs(physics)[0].tolist())
        rotation, position = physics.state.rotation.numpy()[0, 1], physics.state.position.numpy()[0]
        lamps = position[1] + np.array([led.position_m for led in worn.leds]) @ rotation.T
        eye = position[0] + camera.position_m
        free = ~body.ray.intersects_any(lamps, eye - lamps)
        grazing = np.abs(np.hypot(*(lamps - [0.7, 0.0, 0.0])[:, :2].T) - robot.body_radius_m) < 1e-3
        for k in range(len(worn.leds)):
            if grazing[k]:
                doubtful += 1
            else:
                assert (k in seen) == free[k], (yaw, k)
                hidden += not free[k]
    assert hidden > 0 or robot is ROACH or height_m > 0.2
    assert doubtful < 40


def test_an_led_on_the_skin_is_seen_from_its_own_side_only():
    worn = replace(
        HAT, leds=tuple(replace(led, position_m=(0.04, 0.0, 0.05 - 0.01 * k)) for k, led in enumerate(HAT.leds))
    )
    team = team_of(load_camera("ch6"), worn)
    assert len(blobs(shot((0.7, 0.0, np.pi), team=team, merge=0.0))[0]) == 6
    assert len(blobs(shot((0.7, 0.0, 0.0), team=team, merge=0.0))[0]) == 0


def test_both_rungs_look_at_the_same_blobs():
    frames = [shot(AHEAD, (0.7, -0.2, 2.0), teams=50, fidelity=f, false_lights=1.0) for f in ("poses", "features")]
    for name in ("count", "pixel", "hue", "signal"):
        np.testing.assert_array_equal(*(getattr(frame.features, name).numpy() for frame in frames))


def test_pixels_and_hues_scatter_as_the_model_says():
    teams = 3000
    physics = shot(AHEAD, teams=teams, noise_px=0.5, hue_noise=5.0, hue_tolerance=90.0)
    n = physics.features.count.numpy()[0, 0]
    led = physics.labels.led.numpy()[:, 0, :n]
    assert np.all(led == led[0])
    off = physics.features.pixel.numpy()[:, 0, :n] - expected(physics, LIFECAM)[led[0]]
    signal = physics.features.signal.numpy()[0, 0, :n]
    growth = np.sqrt((1 + 0.25 / np.minimum(signal, 1.0)) / 1.25)
    np.testing.assert_allclose(off.std(axis=0), 0.5 * np.stack([growth, growth], -1), rtol=0.06)
    assert np.all(np.abs(off.mean(axis=0)) < 4.5 * 0.5 * growth[:, None] / np.sqrt(teams))
    hue = physics.features.hue.numpy()[:, 0, :n] - np.array([HAT.leds[k].hue_deg for k in led[0]])
    np.testing.assert_allclose(((hue + 180) % 360 - 180).std(axis=0), 5.0 * growth, rtol=0.06)


def test_single_leds_whole_hats_and_other_lights_come_at_their_rates():
    teams = 3000
    physics = shot(AHEAD, teams=teams, blob_dropout=0.1, dropout=0.05, false_lights=0.8)
    labels = physics.labels.robot.numpy()[:, 0]
    labels = np.where(np.arange(labels.shape[1]) < physics.features.count.numpy()[:, :1], labels, -2)
    shown, false = np.sum(labels == 1, axis=1), np.sum(labels == -1, axis=1)
    most = shown.max()
    assert stats.binomtest(int(np.sum(shown == 0)), teams, 0.05).pvalue > 1e-4
    there = shown[shown > 0]
    assert stats.binomtest(int(there.sum()), int(most * len(there)), 0.9).pvalue > 1e-4
    assert stats.binomtest(int(false.sum()), 4 * teams, 0.2).pvalue > 1e-3


def test_blobs_that_touch_are_one_the_brighter():
    pair = (1.2, 0.0, 0.0), (1.5, 0.22, 0.0)
    merged, apart = (shot(*pair, merge=merge) for merge in (20.0, 0.0))
    (_, uv, _), (_, every, _) = blobs(merged), blobs(apart)
    assert len(uv) < len(every)
    distance = np.linalg.norm(uv[:, None] - uv[None], axis=-1) + 1e3 * np.eye(len(uv))
    assert distance.min() >= 20.0
    brightness = dict(zip(map(tuple, every), apart.features.signal.numpy()[0, 0], strict=False))
    for at in every:
        near = [k for k in uv if np.linalg.norm(k - at) < 20.0]
        assert max(brightness[tuple(k)] for k in near) >= brightness[tuple(at)]


def test_true_cameras_and_hats_differ_once_an_episode():
    error = CalibrationError()
    error.focal_share, error.centre = 0.02, 4.0
    frames = [shot(AHEAD, teams=300, noise_px=1e-6, calibration=error) for _ in range(2)]
    led = blobs(frames[0])[0]
    uv = frames[0].features.pixel.numpy()[:, 0, : len(led)]
    np.testing.assert_array_equal(uv, frames[1].features.pixel.numpy()[:, 0, : len(led)])
    believed = expected(frames[0], LIFECAM)[led]
    axis = np.array([LIFECAM.cx_px, LIFECAM.cy_px])
    scale, shift = [], []
    for seen in uv:
        rows = np.concatenate([np.column_stack([believed[:, k] - axis[k], np.eye(2)[[k] * len(led)]]) for k in (0, 1)])
        solution = np.linalg.lstsq(rows, (seen - axis).T.ravel(), rcond=None)[0]
        scale.append(solution[0] - 1.0)
        shift.append(solution[1:])
    np.testing.assert_allclose(np.std(scale), 0.02, rtol=0.15)
    np.testing.assert_allclose(np.std(shift, axis=0), 4.0, rtol=0.15)


def test_hats_are_off_by_what_is_told():
    error = CalibrationError()
    error.hat = 0.004
    physics = shot(AHEAD, teams=1500, noise_px=1e-6, calibration=error)
    led = blobs(physics)[0]
    alike = np.all(physics.labels.led.numpy()[:, 0, : len(led)] == led, axis=1)
    assert alike.mean() > 0.5
    off = physics.features.pixel.numpy()[alike, 0, : len(led)] - expected(physics, LIFECAM)[led]
    assert np.all(np.abs(off.mean(axis=0)) < 0.5)
    pixels_a_metre = LIFECAM.fx_px / 0.9
    assert np.all(np.abs(off.std(axis=0) / (0.004 * pixels_a_metre) - 1.0) < 0.25)


def test_both_rungs_suffer_alike_from_bad_calibration():
    error = CalibrationError()
    error.focal_share, error.centre, error.hat = 0.01, 3.0, 0.0003
    rungs = [shot(AHEAD, teams=200, noise_px=0.5, calibration=error, fidelity=f) for f in ("poses", "features")]
    both = np.all([r.answer.numpy()[:, 0, 1] == Answer.POSE for r in rungs], axis=0)
    assert both.mean() > 0.95
    p = [r.measurements.p_camera_body.numpy()[both, 0, 1] for r in rungs]
    spread = np.linalg.norm(p[0] - p[0].mean(axis=0), axis=1).mean()
    assert spread > 0.005
    assert np.linalg.norm(p[0] - p[1], axis=1).mean() < 0.15 * spread


def test_a_reflection_shows_the_hat_elsewhere_on_both_rungs():
    rungs = [shot(AHEAD, teams=400, noise_px=0.2, outlier=0.3, fidelity=f) for f in ("poses", "features")]
    both = np.all([r.answer.numpy()[:, 0, 1] == Answer.POSE for r in rungs], axis=0)
    assert both.mean() > 0.8
    p = [r.measurements.p_camera_body.numpy()[both, 0, 1] for r in rungs]
    moved = np.linalg.norm(p[0] - np.median(p[0], axis=0), axis=1) > 0.1
    assert 0.1 < moved.mean() < 0.3
    assert np.median(np.linalg.norm(p[0] - p[1], axis=1)) < 1e-3


def driven(shake_rad, teams=1, fidelity="poses", wheels=5.0):
    """Frames of observers that drive at a robot ahead, on mounts that shake."""
    team = team_of(camera=replace(LIFECAM, shake_rad=shake_rad))
    world = world_of(starts=[(0.0, 0.0, 0.0), AHEAD])
    physics = physics_of(team, world, teams=teams, clock=FRAME, leds=led_model(noise_px=1e-4), fidelity=fidelity)
    physics.command.brightness.numpy()[:] = 1.0
    physics.command.wheels.numpy()[:, 0] = wheels
    physics.step()
    return physics


def turned(physics):
    """By how much each team's camera stood turned in its frame (teams, 3), from the poses it gave."""
    rotation = physics.state.rotation.numpy().astype(float)
    believed = rotation[:, 0] @ body_from_camera(LIFECAM.pitch_down_rad)
    R = physics.measurements.R_camera_body.numpy()[:, 0, 1].astype(float)
    return Rotation.from_matrix(np.swapaxes(believed, 1, 2) @ rotation[:, 1] @ np.swapaxes(R, 1, 2)).as_rotvec()


@pytest.mark.parametrize("fidelity", ["poses", "features"])
def test_a_camera_on_a_driving_robot_shakes_about_each_axis(fidelity):
    turns = turned(driven(0.01, teams=400, fidelity=fidelity))
    assert np.allclose(turns.std(axis=0), 0.01, rtol=0.15)
    assert np.all(np.abs(turns.mean(axis=0)) < 0.002)
    assert np.abs(np.corrcoef(turns.T) - np.eye(3)).max() < 0.2


def test_a_camera_on_a_standing_robot_does_not_shake():
    assert np.abs(turned(driven(0.01, teams=50, wheels=0.0))).max() < 1e-4


def test_shake_is_drawn_anew_for_each_frame():
    physics = driven(0.01)
    first = turned(physics)
    physics.step()
    assert np.linalg.norm(turned(physics) - first) > 1e-3


def test_a_mount_without_shake_leaves_every_bit_as_it_was():
    still, firm = driven(0.01, wheels=0.0), driven(0.0, wheels=0.0)
    moving, shaken = driven(0.0), driven(1e-12)
    for name in ("pixel", "hue", "signal"):
        np.testing.assert_array_equal(*(getattr(p.features, name).numpy() for p in (still, firm)))
        np.testing.assert_allclose(*(getattr(p.features, name).numpy() for p in (moving, shaken)), atol=1e-3)

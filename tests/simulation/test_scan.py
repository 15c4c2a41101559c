"""Mirrors and laser spots in truth, against OpenCV's projection, trimesh's rays and Lambert's law."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from coop_envs.agents.catalog import load_camera
from coop_envs.agents.specification import Laser
from coop_envs.sensing.camera import body_from_camera
from coop_envs.worlds.world import Mesh
from tests.simulation.builders import ZUMY, calm, led_model, physics_of, run, spot_model, team_of, world_of

CAMERA = load_camera("lifecam")
LASER = Laser(move_noise=0.0)
TICK_S = 1 / 30
WALL = trimesh.creation.box((0.1, 3.0, 2.0), trimesh.transformations.translation_matrix((1.55, 0.0, 0.5)))


def bench(*, starts=((0.0, 0.0, 0.0), (0.2, 0.8, -0.5)), laser=LASER, robots=2, mesh=WALL, **models):
    """Two robots with cameras before a wall whose face is at x = 1.5, the first with a laser; no pixel noise."""
    team = team_of(*[calm(ZUMY)] * robots)
    members = [
        replace(member, cameras=(CAMERA,), laser=laser if k == 0 else None) for k, member in enumerate(team.members)
    ]
    floor = trimesh.creation.box((8.0, 8.0, 0.02), trimesh.transformations.translation_matrix((0.0, 0.0, -0.01)))
    scene: Any = trimesh.util.concatenate([floor, mesh])
    world = world_of(starts=starts, mesh=Mesh(scene.vertices.astype(np.float32), scene.faces.astype(np.int32)))
    leds = led_model(noise_px=models.pop("noise_px", 1e-6))
    return physics_of(replace(team, members=tuple(members)), world, leds=leds, spots=spot_model(**models)), scene


def aim(physics, left: int, up: int, duty: float = 1.0) -> None:
    """Send the first robot's mirror some counts, and light its laser in every frame of the next decision."""
    physics.command.galvo.numpy()[:] = 0
    physics.command.galvo.numpy()[0, 0, 0] = left, up
    physics.command.laser.numpy()[:] = 0.0
    physics.step()
    physics.command.galvo.numpy()[:] = 0
    physics.command.laser.numpy()[0, 0] = duty
    physics.step()


def landed(physics, scene, laser=LASER) -> np.ndarray:
    """Where trimesh says that the ray lands."""
    az, el = physics.state.mirror.numpy()[0, 0, -1].astype(float)
    R, p = (a.numpy()[0, 0].astype(float) for a in (physics.state.rotation, physics.state.position))
    ray = R @ [np.cos(az) * np.cos(el), np.sin(az) * np.cos(el), np.sin(el)]
    hits, _, _ = scene.ray.intersects_location([p + R @ laser.position_m], [ray])
    return hits[np.argmin(np.linalg.norm(hits - p, axis=1))]


def projected(physics, robot: int, point: np.ndarray) -> np.ndarray:
    """Where OpenCV says that a camera sees a point."""
    R, p = (a.numpy()[0, robot].astype(float) for a in (physics.state.rotation, physics.state.position))
    R_camera = (R @ body_from_camera(CAMERA.pitch_down_rad)).T
    eye = p + R @ CAMERA.position_m
    K = np.array([[CAMERA.fx_px, 0, CAMERA.cx_px], [0, CAMERA.fy_px, CAMERA.cy_px], [0, 0, 1]])
    turn = cv2.Rodrigues(R_camera)[0]
    return cv2.projectPoints(point[None], turn, -R_camera @ eye, K, np.array(CAMERA.distortion))[0].ravel()


def spots(physics, robot: int, tick: int = -1) -> np.ndarray | None:
    sigma = physics.measurements.spot_sigma.numpy()[0, robot, tick]
    return physics.measurements.spot.numpy()[0, robot, tick] if sigma > 0 else None


@pytest.mark.parametrize(("left", "up"), [(0, 0), (10, 5), (-12, -6), (8, -8)])
def test_spots_lie_where_opencv_projects_what_trimesh_hits(left, up):
    physics, scene = bench(beam=0.0)
    aim(physics, left, up)
    point = landed(physics, scene)
    for robot in (0, 1):
        seen = spots(physics, robot)
        assert seen is not None
        np.testing.assert_allclose(seen, projected(physics, robot, point), atol=2e-2)


def test_the_mirror_turns_by_its_counts_and_stops_at_its_stops():
    physics, _ = bench()
    aim(physics, 20, -7)
    np.testing.assert_allclose(physics.state.mirror.numpy()[0, 0, -1], [0.2, -0.07], atol=1e-6)
    for _ in range(10):
        aim(physics, 50, 0)
    assert physics.state.mirror.numpy()[0, 0, -1, 0] == pytest.approx(LASER.max_deflection_rad)


def test_a_move_takes_its_time_and_another_is_not_heeded_meanwhile():
    physics, _ = bench()
    galvo = physics.command.galvo.numpy()
    galvo[0, 0, 0], galvo[0, 0, 2] = (10, 0), (-10, 0)  # 100 ms are three frames
    physics.step()
    turned = physics.state.mirror.numpy()[0, 0, :, 0]
    np.testing.assert_allclose(turned, np.minimum(np.arange(1, 7) / 30, 0.1), atol=1e-6)


def test_a_noisy_mirror_errs_by_a_share_of_its_moves():
    ends = []
    for seed in range(200):
        team = team_of(calm(ZUMY))
        team = replace(team, members=(replace(team.members[0], laser=Laser(move_noise=0.05)),))
        physics = physics_of(team, seed=seed)
        aim(physics, 3, 0)
        ends.append(physics.state.mirror.numpy()[0, 0, -1, 0])
    assert np.mean(ends) == pytest.approx(0.03, abs=3e-4)
    assert np.std(ends) == pytest.approx(0.05 * 0.03, rel=0.2)


def test_dark_lasers_and_rays_into_the_sky_give_no_spot():
    physics, _ = bench()
    aim(physics, 0, 0, duty=0.0)
    assert spots(physics, 0) is None
    aim(physics, 0, 70)
    assert spots(physics, 0) is None


def test_a_robot_in_the_ray_takes_the_spot_and_one_in_view_hides_it():
    physics, _ = bench(robots=3, starts=[(0.0, 0.0, 0.0), (0.2, 0.8, -0.5), (0.6, 0.0, 0.0)])
    aim(physics, 0, -3)
    assert spots(physics, 0) is None and spots(physics, 1) is None
    physics, _ = bench(robots=3, starts=[(0.0, 0.0, 0.0), (0.2, 0.8, -0.5), (0.75, 0.45, 0.0)])
    aim(physics, 0, -2)
    assert spots(physics, 0) is not None and spots(physics, 1) is None


def test_a_robot_on_a_deck_above_the_ray_is_not_in_its_way():
    physics, _ = bench(robots=3, starts=[(0.0, 0.0, 0.0), (0.2, 0.8, -0.5), (0.6, 0.0, 0.0)])
    physics.state.position.numpy()[0, 2, 2] += 1.0
    aim(physics, 0, -3)
    assert spots(physics, 0) is not None and spots(physics, 1) is not None


def test_the_dimmest_duty_that_shows_falls_with_the_square_of_the_distance():
    """Lambert: signal = gain duty albedo cos / d^2, so the least visible duty is the threshold over the rest."""
    for x in (0.0, 0.5):
        physics, scene = bench(starts=((x, 0.0, 0.0), (-1.0, -1.0, 0.0)), gain=2.0)
        eye = np.array([x + CAMERA.position_m[0], 0.0, 0.05 + CAMERA.position_m[2]])
        aim(physics, 0, 0)
        to_eye = eye - landed(physics, scene)
        d = np.linalg.norm(to_eye)
        least = 0.05 / (2.0 * 0.6 * (-to_eye[0] / d) / d**2)
        for duty, shows in ((1.02 * least, True), (0.98 * least, False)):
            physics.command.laser.numpy()[0, 0] = duty
            physics.step()
            assert (spots(physics, 0) is not None) == shows


def test_missed_and_false_spots_come_as_often_as_said():
    physics, _ = bench(missed=0.3)
    aim(physics, 0, 0)
    seen = []
    for _ in range(200):
        physics.step()
        seen += (physics.measurements.spot_sigma.numpy()[0, 0] > 0).tolist()
    assert np.mean(seen) == pytest.approx(0.7, abs=0.05)
    physics, _ = bench(false_spot=0.1)
    lit = []
    for _ in range(200):
        run(physics, 0.2)
        lit += (physics.measurements.spot_sigma.numpy()[0, 0] > 0).tolist()
    assert np.mean(lit) == pytest.approx(0.1, abs=0.03)


def test_an_oblique_beam_makes_a_streak_that_is_harder_to_place():
    physics, _ = bench(noise_px=0.5)
    aim(physics, 0, 0)
    square = physics.measurements.spot_sigma.numpy()[0, 0, -1]
    aim(physics, 0, -10)  # on the floor, 1.3 m ahead
    assert physics.measurements.spot_sigma.numpy()[0, 0, -1] > 1.2 * square

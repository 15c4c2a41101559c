"""The pieces of the baselines: atlas, homography, goal grid, random walk."""

from __future__ import annotations

import math

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.atlas import Atlas
from baselines.goal_grid import CameraGrid, assign_goal
from baselines.ground_view import GroundView
from baselines.random_walk import Walk
from coop_envs.agents.team import Member
from coop_envs.scenario import load_scenario

OBSERVER, PICKET = load_scenario("arena", team="scouts").team.members[:2]


def project(member: Member, points: np.ndarray) -> np.ndarray:
    """Pixels (k, 2), by OpenCV, of ground points (k, 2) forward and left of a robot on level ground."""
    camera = member.camera
    assert camera is not None
    s, c = math.sin(camera.pitch_down_rad), math.cos(camera.pitch_down_rad)
    R_camera_body = np.array([[0.0, -1.0, 0.0], [-s, 0.0, -c], [c, 0.0, -s]])
    eye = np.array([*camera.position_m[:2], member.robot.body_height_m + camera.position_m[2]])
    matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    world = np.column_stack([points, np.zeros(len(points))])
    rotation, _ = cv2.Rodrigues(R_camera_body)
    pixels, _ = cv2.projectPoints(world, rotation, -R_camera_body @ eye, matrix, np.zeros(5))
    return pixels[:, 0]


def test_the_homography_is_the_cameras_projection() -> None:
    view, rng = GroundView(OBSERVER), np.random.default_rng(0)
    points = np.column_stack([rng.uniform(0.3, 1.5, 200), rng.uniform(-0.5, 0.5, 200)])
    pixels = project(OBSERVER, points)
    np.testing.assert_allclose(view.to_pixels(points), pixels, atol=0.02)
    np.testing.assert_allclose(view.to_ground(pixels), points, atol=1e-4)


def test_every_goal_is_in_the_cameras_view() -> None:
    grid, rng = CameraGrid(GroundView(OBSERVER)), np.random.default_rng(1)
    cells = rng.integers(len(grid.probability), size=500)
    pixels = project(OBSERVER, grid.ground_of(cells, rng.random((500, 2))))
    camera = OBSERVER.camera
    assert camera is not None
    assert np.all(pixels >= 0.0)
    assert np.all(pixels <= (camera.width_px, camera.height_px))
    np.testing.assert_array_equal(grid.cells_of(grid.ground_of(cells, np.full((500, 2), 0.5))), cells)


def test_failures_make_a_cell_rarer_and_never_impossible() -> None:
    grid = CameraGrid(GroundView(OBSERVER))
    before = grid.probability[7]
    for _ in range(3):
        grid.failed(7)
        np.testing.assert_allclose(grid.probability.sum(), 1.0)
    assert 0.0 < grid.probability[7] < before / 7.0


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30).filter(lambda w: sum(w) > 1e-3), st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_goals_are_drawn_by_their_weights(weights: list[float], seed: int) -> None:
    draws = np.random.default_rng(seed).random(4000)
    counts = np.bincount([assign_goal(np.array(weights), u) for u in draws], minlength=len(weights))
    p = np.array(weights) / sum(weights)
    assert np.all(np.abs(counts - 4000 * p) <= 6.0 * np.sqrt(4000 * p * (1 - p)) + 1.0)
    assert np.all(counts[p == 0.0] == 0)


def test_a_random_walk_goes_round_its_four_phases() -> None:
    walk = Walk(PICKET, 0.2, np.random.default_rng(0))
    drives = [walk.step() for _ in range(5000)]
    kinds = [(np.sign(d.turn_rad_s), np.sign(d.forward_m_s)) for d in drives]
    phases = [kind for k, kind in enumerate(kinds) if k == 0 or kind != kinds[k - 1]]
    assert phases[:4] == [(-1.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.0, -1.0)]
    assert all(phase == phases[k % 4] for k, phase in enumerate(phases))
    lengths = np.diff([k for k, kind in enumerate(kinds) if k == 0 or kind != kinds[k - 1]])
    assert len(set(lengths.tolist())) > 2


def test_equal_seeds_walk_alike() -> None:
    first, second, other = (Walk(PICKET, 0.2, np.random.default_rng(seed)) for seed in (5, 5, 6))
    a, b, c = ([walk.step() for _ in range(200)] for walk in (first, second, other))
    assert a == b
    assert a != c


@given(st.lists(st.tuples(st.integers(-40, 40), st.integers(-40, 40)), min_size=1, max_size=8), st.integers(0, 2**32))
@settings(max_examples=30, deadline=None)
def test_the_atlas_loses_nothing_of_any_window(corners: list[tuple[int, int]], seed: int) -> None:
    rng, cell = np.random.default_rng(seed), 0.05
    atlas, truth = Atlas(cell), {}
    for i, j in corners:
        window = rng.integers(0, 256, (3, 16, 16), dtype=np.uint8)
        atlas.add((i * cell, j * cell), window)
        for (a, b), value in np.ndenumerate(window[0]):
            truth[i + a, j + b] = (int(value), int(window[1, a, b]))
    places = (np.array(list(truth)) + 0.5) * cell
    ground, obstacle, *_ = atlas.at(places)
    np.testing.assert_array_equal(np.column_stack([ground, obstacle]), np.array(list(truth.values())))

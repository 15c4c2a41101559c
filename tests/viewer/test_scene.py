import dataclasses
from typing import Any

import cv2
import numpy as np
import pytest

from coop_envs.recording import Frame, WorldPicture
from coop_envs.viewer.relief import Relief, belief_colours, hidden, lit_colours, normals, towards_eye
from coop_envs.viewer.robots import Trail
from coop_envs.viewer.scene import AZIMUTHS_DEG, best_azimuth_deg, draw_scene, scene, trimmed

pytestmark = pytest.mark.render


def walled(wall_y_m: float) -> WorldPicture:
    """A floor 2 m square with a wall 0.5 m high and 0.1 m thick along x."""
    heights = np.zeros((101, 101), np.float32)
    row = round(wall_y_m / 0.02)
    heights[:, row : row + 5] = 0.5
    return WorldPicture(heights, (0.0, 0.0), 0.02, (), None, ((0.1, 0.1, 0.0),), (0.0, 0.0, 2.0, 2.0))


def test_a_relief_stands_where_the_ground_is(world: WorldPicture) -> None:
    relief = Relief.cut(world, world.bounds)
    faces = relief.faces()
    assert faces[..., :2].min(axis=(0, 1)) == pytest.approx((-0.5, -0.05))
    assert faces[..., :2].max(axis=(0, 1)) == pytest.approx((0.8, 0.65))
    assert len(faces) == 130 * 70
    assert relief.height_at(np.array([[0.1, 0.2], [0.79, 0.3], [5.0, 0.0], [np.nan, 0.0]])) == pytest.approx(
        [float(world.heights[60, 25]), 0.3, np.nan, np.nan], nan_ok=True
    )


def test_a_coarse_relief_keeps_thin_walls_and_leaves_holes_out() -> None:
    thin = np.zeros((800, 600), np.float32)
    thin[:, 301] = 0.4
    thin[:200, :200] = np.nan
    world = WorldPicture(thin, (0.0, 0.0), 0.05, (), None, ((30.0, 20.0, 0.0),), (0.0, 0.0, 39.95, 29.95))
    relief = Relief.cut(world, world.bounds)
    assert relief.z.size < 15_000
    assert (np.nanmax(relief.z, axis=1) > 0.3).all()
    assert np.isnan(relief.height_at(np.array([[4.0, 4.0]]))).all()
    assert np.isfinite(relief.faces()).all()


def test_high_walls_are_cut_off() -> None:
    tall = walled(1.0)
    tall = dataclasses.replace(tall, heights=8.0 * tall.heights)
    assert Relief.cut(tall, tall.bounds).z.max() == pytest.approx(0.6)


def test_a_wall_hides_what_lies_behind_it_as_far_as_its_shadow() -> None:
    world = walled(1.0)
    relief = Relief.cut(world, world.bounds)
    eye = towards_eye(-90.0)
    shadow_m = 0.5 * -eye[1] / eye[2]
    behind = np.array([[1.0, 1.08 + share * shadow_m, 0.0] for share in (0.5, 0.8, 1.2)])
    before = np.array([[1.0, 0.5, 0.0], [1.0, 0.98, 0.2]])
    assert hidden(relief, np.concatenate([behind, before]), eye, 0.03).tolist() == [True, True, False, False, False]


def test_the_scene_is_seen_from_where_the_points_show() -> None:
    points = np.column_stack([np.linspace(0.2, 1.8, 50), np.full(50, 1.2), np.full(50, 0.05)])
    world = walled(1.0)
    relief = Relief.cut(world, world.bounds)
    assert best_azimuth_deg(relief, points) > 0.0
    assert best_azimuth_deg(relief, points - (0.0, 0.4, 0.0)) == AZIMUTHS_DEG[0]
    assert best_azimuth_deg(relief, np.empty((0, 3))) == AZIMUTHS_DEG[0]


def test_faces_look_up_and_show_the_belief_only_where_they_are_level(frames: list[Frame]) -> None:
    world = walled(0.3)
    faces = Relief.cut(world, world.bounds).faces()
    normal = normals(faces)
    assert (normal[:, 2] > 0).all()
    stone = lit_colours(faces, towards_eye(0.0))
    frame = dataclasses.replace(frames[0], map_ground=np.full((26, 14), 255, np.uint8), T_world_map=np.zeros(3))
    change = np.abs(belief_colours(stone, faces, frame) - stone).max(axis=1)
    middle = faces[..., :2].mean(axis=1)
    mapped = (middle[:, 0] < 26 * 0.05) & (middle[:, 1] < 14 * 0.05)
    assert (change[mapped & (normal[:, 2] > 0.9)] > 0.05).all()
    assert (change[mapped & (normal[:, 2] < 0.3)] == 0.0).all()
    assert (change[~mapped] == 0.0).all()
    assert (belief_colours(stone, faces, frames[0].without_maps()) == stone).all()


def test_a_scene_has_equal_axes_in_metres_and_all_points(world: WorldPicture, frames: list[Frame]) -> None:
    trail = Trail.from_frames(frames)
    axes: Any = draw_scene(world, frames[-1], trail, world.bounds).axes[0]
    spans = np.array([np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())])
    assert axes._box_aspect / axes._box_aspect[0] == pytest.approx(spans / spans[0])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "y (m)")
    shown = max(len(getattr(part, "_offsets3d", ((),))[0]) for part in axes.collections)
    assert 0.8 * len(trail.points_m) < shown <= len(trail.points_m)


def test_a_scene_fits_its_picture_and_shows_every_robot(world: WorldPicture, frames: list[Frame]) -> None:
    image = scene(world, frames[-1], Trail.from_frames(frames), world.bounds)
    assert image.dtype == np.uint8
    edge = np.concatenate([image[:3].ravel(), image[-3:].ravel(), image[:, :3].ravel(), image[:, -3:].ravel()])
    assert (edge > 250).all()
    hue = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)
    assert ((hue[..., 1] > 120) & (hue[..., 2] > 100)).mean() > 0.005


def test_unusual_episodes_are_drawn(world: WorldPicture, frames: list[Frame]) -> None:
    nothing = dataclasses.replace(world, heights=np.full_like(world.heights, np.nan))
    nowhere = dataclasses.replace(frames[0], true_xy_yaw=np.full((5, 3), np.nan), belief_xy_yaw=np.full((5, 3), np.nan))
    empty = Trail.from_frames([nowhere.with_scan(frames[0].scan)])
    for ground, frame, trail in (
        (world, nowhere, empty),
        (nothing, frames[-1], Trail.from_frames(frames)),
        (world, frames[-1], Trail.from_frames([])),
        (world, dataclasses.replace(frames[-1], status=np.zeros(5)).without_maps(), Trail.from_frames(frames[:1])),
    ):
        assert scene(ground, frame, trail, world.bounds).size > 0


def test_white_margins_are_trimmed() -> None:
    image = np.full((40, 50, 3), 255, np.uint8)
    assert trimmed(image, 2).shape == (40, 50, 3)
    image[10:20, 30:35] = 0
    assert trimmed(image, 2).shape == (14, 9, 3)
    assert trimmed(image, 100).shape == (40, 50, 3)

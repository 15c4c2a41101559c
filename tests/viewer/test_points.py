import dataclasses

import numpy as np
import pytest

from coop_envs.recording import Frame, WorldPicture
from coop_envs.viewer.canvas import View
from coop_envs.viewer.palette import HEIGHTS, LASER
from coop_envs.viewer.points import draw_points, draw_rays, height_colours, height_span_m
from coop_envs.viewer.robots import Trail
from coop_envs.viewer.topview import draw
from coop_envs.viewer.window import episode_window

pytestmark = pytest.mark.render


def blank(view: View) -> np.ndarray:
    return np.full((view.height, view.width, 3), 255, np.uint8)


def test_a_point_is_drawn_where_it_is_in_its_colour(world: WorldPicture) -> None:
    view = View.fit(world.bounds, 480)
    picture = blank(view)
    draw_points(picture, view, world, np.array([[0.2, 0.4, 0.15]]))
    rows, columns = np.nonzero((picture != 255).any(axis=-1))
    assert np.column_stack([columns, rows]).mean(axis=0) == pytest.approx(view.px((0.2, 0.4)), abs=0.51)
    colour = height_colours(np.array([0.15]), height_span_m(world))[0]
    assert (picture[rows, columns] == colour).all()


def test_the_highest_of_two_points_is_seen_and_those_beyond_the_picture_are_not(world: WorldPicture) -> None:
    view = View.fit(world.bounds, 480)
    picture = blank(view)
    draw_points(picture, view, world, np.array([[0.2, 0.4, 9.0], [0.2, 0.4, 0.0], [50.0, 0.0, 0.0], [-9.0, 9.0, 0.0]]))
    assert {tuple(colour) for colour in picture.reshape(-1, 3)} == {(255, 255, 255), HEIGHTS[-1]}


def test_colours_run_from_the_floor_to_the_top(world: WorldPicture) -> None:
    low, high = height_span_m(world)
    assert low == pytest.approx(world.heights[25, 35])
    assert high == pytest.approx(0.30, abs=0.005)
    colours = height_colours(np.array([low - 1.0, low, (low + high) / 2, high, high + 1.0]), (low, high))
    assert [tuple(colour) for colour in colours] == [HEIGHTS[0], HEIGHTS[0], HEIGHTS[2], HEIGHTS[-1], HEIGHTS[-1]]


def test_a_ray_runs_from_the_laser_to_its_point(world: WorldPicture, frames: list[Frame]) -> None:
    frame = dataclasses.replace(
        frames[0],
        points_m=np.array([[0.3, 0.3, 0.0], [0.5, 0.1, 0.0]]),
        point_sigma_m=np.zeros(2),
        point_robots=np.array([[0, 0, 1], [-1, 0, 1]]),
        point_eyes_m=np.zeros((2, 2, 3)),
        scanning=np.array([False, False, True, False, False]),
    )
    view = View.fit(world.bounds, 480)
    picture = blank(view)
    draw_rays(picture, view, frame)
    start = frame.true_xy_yaw[0, :2]
    for share in (0.1, 0.5, 0.9):
        u, v = view.px(start + share * (np.array([0.3, 0.3]) - start)).round().astype(int)
        patch = picture[v - 1 : v + 2, u - 1 : u + 2].reshape(-1, 3).astype(int)
        assert np.abs(patch - LASER).sum(axis=1).min() < 300
    u, v = view.px(frame.true_xy_yaw[2, :2]).round().astype(int)
    ringed = (picture[v, u - 40 : u + 40] == LASER).all(axis=-1)
    assert ringed[:30].any()
    assert ringed[50:].any()
    assert not ringed[35:45].any()
    u, v = view.px((0.5, 0.1)).round().astype(int)
    assert (picture[v - 2 : v + 3, u - 2 : u + 3] == 255).all()


def test_a_trail_holds_the_points_of_all_frames_so_far(frames: list[Frame]) -> None:
    trail = Trail.from_frames(frames[:7])
    assert trail.points_m == pytest.approx(np.concatenate([frame.points_m for frame in frames[:7]]))
    assert len(trail.until(3).points_m) == sum(len(frame.scan) for frame in frames[:3])
    assert len(trail.until(0).points_m) == len(Trail.from_frames([]).points_m) == 0


def test_the_top_view_shows_points_and_free_ground(world: WorldPicture, frames: list[Frame]) -> None:
    without = Trail.from_frames([frame.without_maps().with_scan(frames[0].scan) for frame in frames[:1]])
    changed = (draw(world, frames[60], Trail.from_frames(frames[:60])) != draw(world, frames[60], without)).any(axis=-1)
    assert changed.sum() > 300
    blind = dataclasses.replace(frames[60], map_obstacle=np.full_like(frames[60].map_obstacle, 128))
    u, v = View.fit(world.bounds, 480).px((0.35, 0.12)).round().astype(int)
    seen, unseen = draw(world, frames[60])[v, u].astype(int), draw(world, blind)[v, u].astype(int)
    assert seen[2] - seen[0] > 10 + unseen[2] - unseen[0]


def test_the_window_holds_the_points_but_not_the_false_ones(frames: list[Frame]) -> None:
    heights = np.zeros((401, 401), np.float32)
    wide = WorldPicture(heights, (-20.0, -20.0), 0.1, (), None, ((0.0, 0.0, 0.0),), (-20.0, -20.0, 20.0, 20.0))
    points = np.column_stack([np.linspace(0.0, 5.0, 1000), np.zeros(1000), np.zeros(1000)])
    points[7] = (19.0, 19.0, 0.0)
    many = dataclasses.replace(
        frames[0],
        points_m=points,
        point_sigma_m=np.zeros(1000),
        point_robots=np.zeros((1000, 3)),
        point_eyes_m=np.zeros((1000, 2, 3)),
    )
    x_min, _, x_max, y_max = episode_window(wide, [many])
    assert x_min < 0.0
    assert 4.9 < x_max < 6.0
    assert y_max < 3.0

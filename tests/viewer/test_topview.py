import dataclasses
import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.recording import Frame, WorldPicture
from coop_envs.viewer import lettering
from coop_envs.viewer.canvas import View
from coop_envs.viewer.palette import LOST, PAPER, mixed, robot_colours
from coop_envs.viewer.robots import Trail
from coop_envs.viewer.topview import draw, draw_episode, round_length

pytestmark = pytest.mark.render


def alone(frame: Frame, robot: int, x: float, y: float) -> Frame:
    """The frame with one robot moved, every other robot and every belief out of the way."""
    poses = np.full((5, 3), np.nan)
    poses[robot] = (x, y, 0.0)
    return dataclasses.replace(frame, true_xy_yaw=poses, belief_xy_yaw=np.full_like(poses, np.nan))


@settings(max_examples=25, deadline=None)
@given(x=st.floats(-0.4, 0.7), y=st.floats(0.0, 0.6), robot=st.sampled_from([1, 2]))
def test_a_robot_is_drawn_where_it_is(world: WorldPicture, frames: list[Frame], x: float, y: float, robot: int) -> None:
    frame = alone(frames[0], robot, x, y)
    u, v = View.fit(world.bounds, 480).px((x, y)).round().astype(int)
    assert tuple(draw(world, frame)[v, u]) == mixed(robot_colours(frame.role)[robot], PAPER, 0.5)


def test_a_lost_robot_is_grey(world: WorldPicture, frames: list[Frame]) -> None:
    frame = alone(frames[-1], 2, 0.1, 0.2)
    view = View.fit(world.bounds, 480)
    u, v = (view.px((0.1, 0.2)) + (0.75 * 0.05 * view.px_per_m, 0)).round().astype(int)
    assert tuple(draw(world, frame)[v, u]) in {LOST, mixed(LOST, PAPER, 0.5)}


def test_what_moves_changes_and_the_rest_does_not(world: WorldPicture, frames: list[Frame]) -> None:
    before, after = (draw(world, alone(frames[0], 1, x, 0.5)).astype(int) for x in (-0.2, 0.6))
    changed = np.abs(before - after).max(axis=-1) > 0
    view = View.fit(world.bounds, 480)
    columns = np.nonzero(changed.any(axis=0))[0]
    places = np.array([view.px((x, 0.5))[0] for x in (-0.2, 0.6)])
    assert (np.abs(columns[:, None] - places).min(axis=1) < 45).all()
    assert not changed[view.height :].any()


@pytest.mark.parametrize("size", [120, 333, 480, 800])
def test_pictures_of_one_size_have_one_even_shape(world: WorldPicture, frames: list[Frame], size: int) -> None:
    shapes = {draw(world, frame, size_px=size).shape for frame in frames[::40]}
    assert len(shapes) == 1
    height, width, channels = shapes.pop()
    assert height % 2 == width % 2 == 0
    assert channels == 3
    assert width >= size


def test_a_drawing_leaves_the_next_one_alone(world: WorldPicture, frames: list[Frame]) -> None:
    first = draw(world, frames[50]).copy()
    draw(world, frames[-1], Trail.from_frames(frames))
    assert (draw(world, frames[50]) == first).all()


def test_unusual_frames_are_drawn(world: WorldPicture, frames: list[Frame]) -> None:
    frame = frames[-1]
    nowhere = np.full((5, 3), np.nan)
    empty = np.zeros((0, 0), np.uint8)
    for changes in (
        {"true_xy_yaw": nowhere},
        {"true_xy_yaw": nowhere, "belief_xy_yaw": nowhere},
        {"belief_cov_xy": np.full((5, 2, 2), np.nan)},
        {"map_ground": empty, "map_obstacle": empty, "map_volume": empty[None][:0]},
        {"fov_rad": np.zeros(5)},
        {"range_m": np.full(5, math.inf)},
        *({"status": np.full(5, status)} for status in range(6)),
    ):
        assert draw(world, dataclasses.replace(frame, **changes)).any()
    bare = dataclasses.replace(world, hazards=(), goal=None, starts=())
    assert draw(bare, frame).any()


def test_an_episode_is_drawn_picture_by_picture(world: WorldPicture, frames: list[Frame]) -> None:
    pictures = list(draw_episode(world, frames[:3]))
    assert len(pictures) == 3
    assert (pictures[2] == draw(world, frames[2], Trail.from_frames(frames[:3]))).all()


@pytest.mark.parametrize("outline", [True, False])
def test_text_is_written_with_either_font(monkeypatch: pytest.MonkeyPatch, outline: bool) -> None:
    if not outline:
        monkeypatch.setattr(lettering, "_outline_font", lambda: None)
    elif not hasattr(cv2, "FontFace"):
        pytest.skip("OpenCV 4 has no outline font")
    picture = np.full((40, 200, 3), 255, np.uint8)
    lettering.write(picture, "coverage, 2σ", (10, 25), 12, (0, 0, 0), halo=(255, 0, 0))
    columns = np.nonzero((picture < 128).all(axis=-1).any(axis=0))[0]
    assert 9 <= columns.min() < 20
    assert columns.max() < 200 - 5
    assert lettering.text_width("coverage", 12) == pytest.approx(52, abs=16)


@pytest.mark.parametrize(("length", "expected"), [(0.21, 0.2), (0.99, 0.5), (7.3, 5.0), (10.0, 10.0), (0.011, 0.01)])
def test_the_scale_bar_has_a_round_length(length: float, expected: float) -> None:
    assert round_length(length) == pytest.approx(expected)

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.recording import Frame, WorldPicture
from coop_envs.viewer.window import episode_window, window_around

CORRIDOR = WorldPicture(np.zeros((2, 2), np.float32), (0.0, 0.0), 30.0, (), None, (), (-8.0, -2.0, 31.0, 5.0))


@given(x=st.floats(-8, 31), y=st.floats(-2, 5), side=st.floats(0.5, 50))
def test_a_window_keeps_its_size_lies_in_the_world_and_holds_its_point(x: float, y: float, side: float) -> None:
    x_min, y_min, x_max, y_max = window_around(CORRIDOR, (x, y), side)
    assert (x_max - x_min, y_max - y_min) == pytest.approx((min(side, 39), min(side, 7)))
    assert x_min >= -8 - 1e-9
    assert x_max <= 31 + 1e-9
    assert y_min >= -2 - 1e-9
    assert y_max <= 5 + 1e-9
    assert x_min - 1e-9 <= x <= x_max + 1e-9
    assert y_min - 1e-9 <= y <= y_max + 1e-9


def test_all_of_a_small_world_is_shown(world: WorldPicture, frames: list[Frame]) -> None:
    assert window_around(world, (0.1, 0.2)) == pytest.approx(world.bounds)
    assert episode_window(world, frames) == pytest.approx(world.bounds)
    assert episode_window(world, []) == world.bounds


def test_of_a_large_world_what_the_episode_reached_is_shown(frames: list[Frame]) -> None:
    far = [
        dataclasses.replace(
            frame, **{name: getattr(frame, name) + (20, 1, 0) for name in ("true_xy_yaw", "belief_xy_yaw", "points_m")}
        )
        for frame in frames
    ]
    x_min, y_min, x_max, y_max = episode_window(CORRIDOR, far)
    assert (x_max - x_min, y_max - y_min) == pytest.approx((2.5, 2.5), abs=0.2)
    for frame in far:
        x, y = frame.true_xy_yaw[:3, :2].T
        assert ((x_min < x) & (x < x_max) & (y_min < y) & (y < y_max)).all()

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.recording import Frame, WorldPicture
from coop_envs.recording.frame import HazardPicture
from coop_envs.viewer.canvas import View
from coop_envs.viewer.palette import HAZARD, NO_GROUND
from coop_envs.viewer.terrain import hazard_outline, shaded_ground, tint_ground
from coop_envs.worlds.world import Hazard

pytestmark = pytest.mark.render
VIEW = View.fit((-1.0, -1.0, 1.0, 1.0), 400)


def area(points: np.ndarray) -> float:
    x, y = points.T
    return 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


@given(a=st.floats(0, 1), b=st.floats(0, 1), radius=st.floats(0.01, 0.5), yaw=st.floats(-4, 4))
def test_the_outline_of_a_hazard_is_where_its_signed_distance_is_zero(
    a: float, b: float, radius: float, yaw: float
) -> None:
    points = hazard_outline(HazardPicture("trap", (0.3, -0.2), (a, b), radius, yaw))
    distance = Hazard("trap", (0.3, -0.2), (a, b), radius, yaw).signed_distance_m(points)
    assert distance == pytest.approx(0.0, abs=1e-12)
    exact = 4 * a * b + 4 * (a + b) * radius + math.pi * radius**2
    assert area(points) == pytest.approx(exact, rel=0.02)


def test_a_sharp_hazard_has_four_corners() -> None:
    points = hazard_outline(HazardPicture("trap", (1.0, 2.0), (0.3, 0.1)))
    assert sorted(map(tuple, points.round(9))) == [(0.7, 1.9), (0.7, 2.1), (1.3, 1.9), (1.3, 2.1)]


@given(x=st.floats(-0.4, 0.4), y=st.floats(-0.4, 0.4), yaw=st.floats(-math.pi, math.pi))
def test_a_cell_of_the_map_lies_where_its_frame_puts_it(x: float, y: float, yaw: float) -> None:
    frame = one_hazard_cell((x, y, yaw))
    picture = np.full((400, 400, 3), 255, np.uint8)
    tint_ground(picture, VIEW, frame)
    tinted = (picture != 255).any(axis=-1)
    c, s = math.cos(yaw), math.sin(yaw)
    centre = np.array([x, y]) + np.array([[c, -s], [s, c]]) @ (0.25, 0.15)
    rows, columns = np.nonzero(tinted)
    assert (columns.mean(), rows.mean()) == pytest.approx(tuple(VIEW.px(centre)), abs=0.6)
    assert tinted.sum() == pytest.approx((0.1 * VIEW.px_per_m) ** 2, rel=0.12)
    assert np.abs(picture[tinted].mean(axis=0) - np.asarray(HAZARD)).max() < 80


def one_hazard_cell(T_world_map: tuple[float, float, float]) -> Frame:
    ground = np.full((4, 3), 128, np.uint8)
    ground[2, 1] = 0
    nobody = np.zeros(0)
    return Frame(
        time_s=0.0,
        names=(),
        role=(),
        status=nobody.astype(np.int8),
        declared=nobody.astype(np.int8),
        true_xy_yaw=nobody.reshape(0, 3),
        belief_xy_yaw=nobody.reshape(0, 3),
        belief_cov_xy=nobody.reshape(0, 2, 2),
        stationary=nobody.astype(bool),
        collected=nobody.astype(bool),
        fov_rad=nobody,
        range_m=nobody,
        body_radius_m=nobody,
        sees=nobody.reshape(0, 0).astype(bool),
        scanning=nobody.astype(np.bool_),
        points_m=np.empty((0, 3)),
        point_sigma_m=nobody,
        point_robots=np.empty((0, 3), np.int16),
        point_eyes_m=np.empty((0, 2, 3)),
        map_ground=ground,
        map_obstacle=np.full((4, 3), 128, np.uint8),
        map_volume=np.empty((0, *ground.shape), np.uint8),
        volume_floor_m=0.0,
        T_world_map=np.array(T_world_map),
        cell_m=0.1,
        energy_j=0.0,
        action_energy_j=0.0,
        information_bits=0.0,
        coverage=0.0,
    )


def test_unknown_ground_is_left_alone(frames: list[Frame]) -> None:
    picture = np.full((400, 400, 3), 77, np.uint8)
    unknown = np.full((5, 5), 128, np.uint8)
    tint_ground(
        picture,
        VIEW,
        dataclasses.replace(
            frames[0].without_maps(), map_ground=unknown, map_obstacle=unknown, map_volume=unknown[None][:0]
        ),
    )
    assert (picture == 77).all()


def test_walls_are_darker_and_what_is_no_ground_is_blank() -> None:
    heights = np.zeros((201, 201), np.float32)
    heights[150:, :] = 0.3
    heights[:50, :] = np.nan
    world = WorldPicture(heights, (-1.0, -1.0), 0.01, (), None, (), (-1.0, -1.0, 1.0, 1.0))
    picture = shaded_ground(world, View.fit(world.bounds, 200, margin=0))
    none, floor, wall = (picture[100, u].astype(float) for u in (20, 100, 190))
    assert none == pytest.approx(NO_GROUND)
    assert (wall < floor - 60).all()


def test_light_comes_from_the_upper_left() -> None:
    x = np.linspace(-1, 1, 201)
    hill = 0.2 * np.exp(-8 * (x[:, None] ** 2 + x[None] ** 2)).astype(np.float32)
    world = WorldPicture(hill.astype(np.float32), (-1.0, -1.0), 0.01, (), None, (), (-1.0, -1.0, 1.0, 1.0))
    picture = shaded_ground(world, View.fit(world.bounds, 200, margin=0)).astype(float)
    assert picture[80, 80].mean() > picture[120, 120].mean() + 10
    assert picture[80, 120].mean() == pytest.approx(picture[120, 80].mean(), abs=3)

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.recording import Frame, WorldPicture
from coop_envs.viewer.palette import robot_colours
from coop_envs.viewer.robots import Trail, ellipse_points, sector_points

pytestmark = pytest.mark.render


def flat(wall_from_x: float = math.inf) -> WorldPicture:
    heights = np.zeros((401, 401), np.float32)
    heights[np.linspace(-2, 2, 401) >= wall_from_x] = 0.3
    return WorldPicture(heights, (-2.0, -2.0), 0.01, (), None, (), (-2.0, -2.0, 2.0, 2.0))


@given(sigma_x=st.floats(1e-4, 1), sigma_y=st.floats(1e-4, 1), correlation=st.floats(-0.95, 0.95))
def test_ellipse_points_lie_two_sigma_from_the_mean(sigma_x: float, sigma_y: float, correlation: float) -> None:
    mixed = correlation * sigma_x * sigma_y
    cov = np.array([[sigma_x**2, mixed], [mixed, sigma_y**2]])
    mean = np.array([0.3, -0.4])
    offset = ellipse_points(mean, cov, 720) - mean
    assert np.einsum("ki,ij,kj->k", offset, np.linalg.inv(cov), offset) == pytest.approx(4.0, rel=1e-6)
    assert np.abs(offset).max(axis=0) == pytest.approx((2 * sigma_x, 2 * sigma_y), rel=1e-3)


def test_the_ellipse_holds_as_many_samples_as_two_sigma_should() -> None:
    cov = np.array([[4e-4, 3e-4], [3e-4, 9e-4]])
    samples = np.random.default_rng(0).multivariate_normal((0, 0), cov, 100_000)
    edge = ellipse_points(np.zeros(2), cov, 360)
    angle = np.arctan2(samples[:, 1], samples[:, 0])
    order = np.argsort(np.arctan2(edge[:, 1], edge[:, 0]))
    reach = np.interp(angle, np.arctan2(*edge[order].T[::-1]), np.linalg.norm(edge[order], axis=1), period=2 * math.pi)
    assert (np.linalg.norm(samples, axis=1) < reach).mean() == pytest.approx(1 - math.exp(-2), abs=0.005)


@given(yaw=st.floats(-math.pi, math.pi), fov=st.floats(0.3, 2.5))
def test_an_unhindered_sector_has_its_area(yaw: float, fov: float) -> None:
    points = sector_points(flat(), np.array([0.1, 0.2, yaw]), fov, 1.0)
    x, y = points.T
    area = 0.5 * (np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert area == pytest.approx(fov / 2, rel=0.05)


def test_a_sector_ends_at_a_wall() -> None:
    points = sector_points(flat(wall_from_x=0.5), np.array([0.0, 0.0, 0.0]), 1.0, 1.9)
    assert points[1:, 0] == pytest.approx(0.5, abs=0.01)


def test_docked_robots_leave_no_trail(frames: list[Frame]) -> None:
    trail = Trail.from_frames(frames)
    assert trail.true_xy.shape == trail.belief_xy.shape == (len(frames), 5, 2)
    assert np.isnan(trail.true_xy[:, 3:]).all()
    assert np.isfinite(trail.true_xy[:, :3]).all()
    assert trail.until(7).true_xy.shape == (7, 5, 2)
    assert Trail.from_frames([]).true_xy.shape == (0, 0, 2)


def test_robots_of_a_team_have_colours_of_their_own() -> None:
    colours = robot_colours(("observer",) * 2 + ("picket",) * 4)
    assert len(set(colours)) == 6

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.viewer.canvas import View, circle_points, dashes, disc, hatch, polygon, polyline, star_points

pytestmark = pytest.mark.render
metres = st.floats(-2.0, 2.0)


def blank(height: int = 120, width: int = 160) -> np.ndarray:
    return np.zeros((height, width, 3), np.uint8)


def ink(picture: np.ndarray) -> tuple[float, np.ndarray]:
    """Area in pixels and centroid (u, v) of what was drawn in white."""
    share = picture[..., 0] / 255
    v, u = np.indices(share.shape)
    return share.sum(), np.array([(share * u).sum(), (share * v).sum()]) / share.sum()


@given(x_min=metres, y_min=metres, width=st.floats(0.1, 50), height=st.floats(0.1, 50), size=st.integers(60, 900))
def test_a_view_holds_its_bounds_with_its_longer_side_as_asked(
    x_min: float, y_min: float, width: float, height: float, size: int
) -> None:
    bounds = (x_min, y_min, x_min + width, y_min + height)
    view = View.fit(bounds, size)
    assert max(view.width, view.height) == size
    corners = view.px([bounds[:2], bounds[2:]])
    assert (corners > -0.5).all()
    assert (corners < (view.width - 0.5, view.height - 0.5)).all()


@given(x=metres, y=metres)
def test_pixels_lead_back_to_the_world(x: float, y: float) -> None:
    view = View.fit((-2, -1, 2, 1), 300)
    u, v = view.px((x, y))
    assert view.world_from_px() @ (u, v, 1) == pytest.approx((x, y, 1))


def test_x_runs_right_and_y_up() -> None:
    view = View.fit((0, 0, 2, 1), 200)
    origin, right, up = view.px([(0, 0), (1, 0), (0, 1)])
    assert right - origin == pytest.approx((view.px_per_m, 0))
    assert up - origin == pytest.approx((0, -view.px_per_m))


@given(u=st.floats(40, 100), v=st.floats(40, 80), radius=st.floats(5, 30))
def test_a_disc_has_its_centre_and_area(u: float, v: float, radius: float) -> None:
    picture = blank()
    disc(picture, np.array([u, v]), radius, (255, 255, 255))
    area, centre = ink(picture)
    assert centre == pytest.approx((u, v), abs=0.1)
    assert area == pytest.approx(math.pi * (radius + 0.5) ** 2, rel=0.06)


def test_shapes_reach_beyond_the_picture_without_harm() -> None:
    picture = blank()
    far = np.array([(-1e9, -1e9), (1e9, 40.0), (1e9, 1e9)])
    for draw in (polygon, polyline):
        draw(picture, far, (255, 255, 255))
    hatch(picture, far + 1e9, (255, 255, 255))


@given(dash=st.floats(1, 9), gap=st.floats(1, 9), length=st.floats(1, 200))
def test_dashes_cover_their_share_of_a_line(dash: float, gap: float, length: float) -> None:
    pieces = dashes(np.array([(0.0, 0.0), (0.6 * length, 0.8 * length)]), dash, gap)
    drawn = sum(np.linalg.norm(piece[-1] - piece[0]) for piece in pieces)
    assert abs(drawn - length * dash / (dash + gap)) <= dash
    assert np.linalg.norm(pieces[0][-1] - pieces[0][0]) == pytest.approx(min(dash, length))


def test_dashes_follow_corners() -> None:
    (piece,) = dashes(np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]), 30, 5)
    assert piece.tolist() == [[0, 0], [10, 0], [10, 10]]


def test_hatching_stays_inside_its_outline() -> None:
    picture = np.full((120, 160, 3), 9, np.uint8)
    hatch(picture, np.array([(40.0, 30.0), (100.0, 30.0), (100.0, 90.0), (40.0, 90.0)]), (255, 255, 255))
    outside = np.ones((120, 160), bool)
    outside[28:93, 38:103] = False
    assert (picture[outside] == 9).all()
    inside = picture[34:87, 44:97, 0]
    assert 0.1 < (inside > 128).mean() < 0.5


def test_a_star_points_up_and_a_circle_is_round() -> None:
    star = star_points(np.array([50.0, 60.0]), 10.0)
    assert star[star[:, 1].argmin()] == pytest.approx((50, 50))
    assert np.linalg.norm(circle_points((1.0, 2.0), 3.0) - (1, 2), axis=1) == pytest.approx(3.0)

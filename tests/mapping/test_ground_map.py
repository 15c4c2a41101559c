from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.mapping import ground_map
from tests.mapping.chart import BODY, CELL, CONTACT, MARK, NX, NY, Chart, centres

START, END = (-0.1, 0.0), (0.5, 0.1)
STUCK, SILENT = int(ground_map.STUCK), int(ground_map.SILENT)


@pytest.fixture
def chart():
    return Chart()


def within(shape: shapely.LineString | shapely.Polygon, slack: float = 0.0) -> np.ndarray:
    """Cells whose centre lies in a shape grown by ``slack``."""
    x, y = centres()
    return shapely.contains_xy(shape.buffer(slack, quad_segs=64), x, y)


def test_a_pass_proves_what_the_contact_disc_swept_and_no_more(chart):
    chart.drive(START, END)
    swept = shapely.LineString([START, END]).buffer(CONTACT, quad_segs=64)
    proven = chart.ground > 0
    # steps of 4 cm leave cusps of less than 2.1 mm beside the ideal band
    assert np.all(proven[within(swept, -0.0021)])
    assert not proven[~within(swept, 1e-4)].any()
    assert np.all(chart.ground >= 0)


def test_the_body_clears_what_it_swept_of_obstacles(chart):
    chart.drive(START, END)
    swept = shapely.LineString([START, END]).buffer(BODY, quad_segs=64)
    assert np.all(chart.obstacle[within(swept, -0.0015)] < 0)
    assert not chart.obstacle[~within(swept, 1e-4)].any()


def test_uncertain_robots_prove_less(chart):
    sigma = 0.02
    chart.drive(START, END, sigma)
    sure = shapely.LineString([START, END]).buffer(CONTACT - 2 * sigma, quad_segs=64)
    assert np.all(chart.ground[within(sure, -0.004)] > 0)
    assert not chart.ground[~within(sure, 1e-4)].any()


def test_a_robot_that_might_be_anywhere_proves_nothing(chart):
    chart.drive(START, END, sigma=0.06)
    assert not chart.ground.any()


def test_standing_still_proves_nothing_more(chart):
    chart.enter(*START)
    once = chart.ground.copy()
    for k in range(100):
        chart.enter(START[0] + 0.009 * np.cos(k), START[1] + 0.009 * np.sin(k))
        assert len(chart.changes()) == 0
    np.testing.assert_array_equal(chart.ground, once)


def test_a_mark_is_darkest_under_the_robot_and_ends_at_its_radius(chart):
    x, y = 0.1, 0.05
    chart.enter(x, y, proves=False, marks=STUCK)
    away = np.hypot(centres()[0] - x, centres()[1] - y)
    assert np.all(chart.ground[away <= CONTACT] < 0)
    assert np.all(chart.ground[away > max(MARK, CONTACT)] == 0)
    assert not chart.obstacle.any()


def test_a_mark_grows_with_doubt_but_never_beyond_twice_its_radius(chart):
    chart.enter(0.1, 0.05, sigma=0.03, proves=False, marks=STUCK)
    some = np.count_nonzero(chart.ground)
    far = Chart()
    far.enter(0.1, 0.05, sigma=3.0, proves=False, marks=STUCK)
    away = np.hypot(centres()[0] - 0.1, centres()[1] - 0.05)
    assert some > np.count_nonzero(away <= max(MARK, CONTACT))
    assert np.count_nonzero(far.ground) == np.count_nonzero(away <= MARK + max(MARK, CONTACT))


def test_one_pass_does_not_overcome_a_mark_and_later_ones_do(chart):
    x, y = 0.2, 0.05
    chart.enter(x, y, proves=False, marks=STUCK)
    under = np.hypot(centres()[0] - x, centres()[1] - y) <= 0.04
    chart.drive(START, END)
    assert np.all(chart.ground[under] < 0)
    chart.drive(END, START)
    assert np.all(chart.ground[under] > 0)


def test_log_odds_stay_within_their_limit(chart):
    for _ in range(6):
        chart.drive(START, END)
        chart.drive(END, START)
    assert chart.ground.max() == 112
    for _ in range(20):
        chart.enter(0.2, 0.05, proves=False, marks=STUCK)
    assert chart.ground.min() == -112


def test_proven_ground_is_spared_when_a_robot_is_stuck_and_not_when_one_falls_silent(chart):
    x, y = 0.2, 0.05
    chart.drive(START, END)
    proven = chart.ground > 0
    away = np.hypot(centres()[0] - x, centres()[1] - y)
    chart.enter(x, y, proves=False, marks=STUCK)
    assert np.all(chart.ground[proven] > 0)
    assert np.all(chart.ground[~proven & (away <= CONTACT)] < 0)
    silent = Chart()
    silent.drive(START, END)
    silent.enter(x, y, proves=False, marks=SILENT)
    assert np.all(silent.ground[away <= CONTACT] < 0)


def test_the_list_of_changes_tells_the_map(chart):
    copy = np.zeros((2, NX * NY), dtype=int)
    for k in range(30):
        x, y = -0.3 + 0.035 * k, 0.3 * np.sin(0.3 * k)
        chart.enter(x, y, sigma=0.005 * (k % 3), marks=int(k % 7 == 0))
        for layer, cell, old, new in chart.changes():
            assert copy[layer, cell] == old
            copy[layer, cell] = new
    np.testing.assert_array_equal(copy[0].reshape(NX, NY), chart.ground)
    np.testing.assert_array_equal(copy[1].reshape(NX, NY), chart.obstacle)


@settings(max_examples=60, deadline=None)
@given(x=st.floats(-3, 3), y=st.floats(-3, 3), sigma=st.floats(0, 10), marks=st.integers(0, 2))
def test_any_footprint_stays_in_the_map_and_in_its_list(x, y, sigma, marks):
    chart = Chart()
    chart.enter(x, y, sigma, proves=True, marks=marks)
    changed = np.count_nonzero(chart.ground) + np.count_nonzero(chart.obstacle)
    assert changed <= len(chart.changes()) < chart.map.changes.shape[1]
    reach = max(BODY, MARK + MARK, MARK + CONTACT)
    away = np.hypot(centres()[0] - x, centres()[1] - y)
    assert not chart.ground[away > reach + 1e-4].any()


def test_two_robots_prove_independently(chart):
    chart.enter(0.0, 0.0, r=0)
    chart.enter(0.0, 0.0, r=1)
    under = np.hypot(*centres()) <= CONTACT - CELL
    assert np.all(chart.ground[under] == 112)


def test_where_people_set_robots_down_the_ground_is_known(chart):
    chart.drive(START, END)
    chart.begin([(0.0, 0.0), (0.3, -0.1)], known_m=0.1)
    x, y = centres()
    near = (np.hypot(x, y) <= 0.1) | (np.hypot(x - 0.3, y + 0.1) <= 0.1)
    np.testing.assert_array_equal(chart.ground > 0, near)
    np.testing.assert_array_equal(chart.obstacle < 0, near)
    assert len(chart.changes()) == 0

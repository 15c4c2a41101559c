from __future__ import annotations

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.worlds.world import Hazard

lengths = st.floats(0.01, 0.5)
places = st.floats(-1.0, 1.0)


@given(places, places, lengths, lengths, st.floats(0.0, 0.3), st.floats(-3.2, 3.2), places, places)
def test_signed_distance_is_that_of_shapelys_rounded_rectangle(x, y, a, b, radius, yaw, px, py):
    hazard = Hazard("trap", (x, y), (a, b), radius, yaw)
    rectangle = shapely.affinity.rotate(shapely.box(x - a, y - b, x + a, y + b), yaw, origin=(x, y), use_radians=True)
    point = shapely.Point(px, py)
    outside = shapely.distance(rectangle, point)
    expected = (outside if outside > 0 else -shapely.distance(rectangle.exterior, point)) - radius
    assert hazard.signed_distance_m(np.array([px, py])) == pytest.approx(expected, abs=1e-9)


@given(st.floats(0.01, 1.0), places, places)
def test_a_disc_is_a_radius_alone(radius, px, py):
    distance = Hazard("hole", (0.0, 0.0), radius_m=radius).signed_distance_m(np.array([[px, py]]))
    assert distance == pytest.approx([np.hypot(px, py) - radius])

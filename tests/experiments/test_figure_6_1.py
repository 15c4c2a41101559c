from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from baselines.inchworm_poses import ScanPose, scan_sequence
from coop_envs.errors import ConfigError
from experiments.figure_6_1 import FIELDS_OF_VIEW_RAD, THESIS_M2, Config, plot, run, sector


@pytest.fixture(scope="module")
def table():
    return run()


@pytest.mark.parametrize("name", THESIS_M2)
def test_the_mapped_areas_are_the_thesis_within_half_a_percent(table, name):
    areas = [step.area_m2 for step in table.steps[name]]
    np.testing.assert_allclose(areas, THESIS_M2[name], rtol=0.005)


@pytest.mark.parametrize("name", FIELDS_OF_VIEW_RAD)
def test_random_points_find_the_same_area(table, name):
    """By the definition: a point is mapped that, in some scan, is in range and ahead of both robots."""
    fov = FIELDS_OF_VIEW_RAD[name]
    low, high = np.array([-3.0, -3.0]), np.array([8.0, 5.0])
    points = np.random.default_rng(0).uniform(low, high, (400_000, 2))
    mapped = np.zeros(len(points), dtype=bool)
    for scan, step in zip(scan_sequence(4), table.steps[name], strict=True):
        seen = np.ones(len(points), dtype=bool)
        for x, y, heading in scan.robots:
            way = points - [x, y]
            off = np.arctan2(way[:, 1], way[:, 0]) - heading
            ahead = np.abs((off + np.pi) % (2 * np.pi) - np.pi) <= fov / 2
            seen &= ahead & (np.hypot(*way.T) <= 2.5)
        mapped |= seen
        area = mapped.mean() * np.prod(high - low)
        assert step.area_m2 == pytest.approx(area, rel=0.02)


def test_a_sectors_area():
    for fov in FIELDS_OF_VIEW_RAD.values():
        assert sector(ScanPose(1.0, 2.0, 0.3), fov, 2.5).area == pytest.approx(0.5 * fov * 2.5**2, rel=1e-5)


def test_the_poses_of_the_authors():
    expected = [
        [(0, 0, 0), (1, 2, -90)],
        [(2, 0, 90), (1, 2, 0)],
        [(2, 0, 0), (3, 2, -90)],
        [(4, 0, 90), (3, 2, 0)],
    ]
    found = [[(x, y, math.degrees(heading)) for x, y, heading in scan.robots] for scan in scan_sequence(4)]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert [scan.label for scan in scan_sequence(4)] == ["t0", "t3", "t6", "t9"]


def test_one_robot_drives_between_scans_and_the_other_only_turns():
    scans = scan_sequence(7, range_m=3.0)
    for k, (before, after) in enumerate(pairwise(scans)):
        ways = [math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in zip(before.robots, after.robots, strict=True)]
        assert ways[k % 2] == pytest.approx(0.8 * 3.0) and ways[1 - k % 2] == 0.0


def test_the_picture_has_a_panel_for_each_scan_and_field_of_view(table):
    figure = plot(table)
    assert len(figure.axes) == 12
    assert figure.axes[0].get_title() == "t0: 2.991 m²"


def test_impossible_settings_are_refused():
    with pytest.raises(ConfigError, match="steps"):
        run(Config(steps=0))
    with pytest.raises(ConfigError, match="range_m"):
        run(Config(range_m=-1.0))
    with pytest.raises(ConfigError, match="arc_points"):
        Config(arc_points=2)

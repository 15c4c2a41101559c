"""What two cameras see in common, and what rasters tell."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from baselines.common_view import Sector, hidden, parallax, sector_of, views
from baselines.driving import Scan
from baselines.inchworm_poses import scan_sequence
from baselines.inchworm_scan import next_stands
from baselines.rasters import Tries, Watcher, best_tile, fan, landing, tiles_of
from baselines.team_view import RobotView
from coop_envs.agents.catalog import load_team
from coop_envs.mapping.planning import BeliefGrid

MEMBER = load_team("surveyors").members[0]


def robot(x: float, y: float, yaw: float, name: str = "observer_0") -> RobotView:
    return RobotView(name, x, y, yaw, 0.001, True, True, (0.0, 0.0), False, 0.0, 0)


def watcher(x: float, y: float, yaw: float, name: str = "observer_0") -> Watcher:
    return Watcher(robot(x, y, yaw, name), MEMBER, sector_of(MEMBER))


def grid(wall_x: float | None = None) -> BeliefGrid:
    """4 x 4 m of unknown ground round the origin, with a wall across it or not."""
    obstacle = np.full((80, 80), 128, np.uint8)
    if wall_x is not None:
        obstacle[round((wall_x + 2.0) / 0.05)] = 243
    return BeliefGrid(np.full((80, 80), 128, np.uint8), obstacle, (-2.0, -2.0), 0.05)


@pytest.mark.parametrize(
    ("view_rad", "area_m2"), [(math.pi / 2, 2.993), (math.pi / 3, 1.770), (4 * math.pi / 3, 7.319)]
)
def test_the_first_scan_of_figure_6_1_sees_what_the_thesis_maps(view_rad: float, area_m2: float) -> None:
    step = 0.02
    axis = np.arange(-3.0, 5.0, step)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    seen = np.ones(len(points), dtype=bool)
    for pose in scan_sequence(1)[0].robots:
        stand, heading = np.array([[pose.x_m, pose.y_m]]), np.array([pose.heading_rad])
        seen &= views(Sector(0.5 * view_rad, 0.0, 2.5), stand, heading, points)[0, 0]
    assert np.count_nonzero(seen) * step**2 == pytest.approx(area_m2, rel=0.02)


def test_the_cameras_sector_is_its_field_of_view_less_a_margin() -> None:
    sector = sector_of(MEMBER)
    assert 2.0 * sector.half_rad == pytest.approx(math.radians(70.0), abs=0.12)
    assert sector.nearest_m == pytest.approx(0.15 / math.tan(math.atan(240 / 457.007)), rel=1e-3)
    assert sector_of(MEMBER, 4 * math.pi / 3).half_rad > 2.0


def test_walls_hide_what_is_behind_them() -> None:
    points = np.array([[0.5, 0.3], [1.5, 0.3], [1.5, -1.0]])
    np.testing.assert_array_equal(hidden(grid(1.0), np.zeros((1, 2)), points), [[False, True, True]])
    assert not hidden(grid(), np.zeros((1, 2)), points).any()


def test_parallax_is_the_sine_between_two_lines() -> None:
    sine = parallax(np.array([[0.0, 0.0]]), np.array([1.0, 1.0]), np.array([[1.0, 0.0], [2.0, 2.0]]))
    np.testing.assert_allclose(sine, [[1.0, 0.0]], atol=1e-12)


def test_a_full_raster_has_as_many_points_as_the_controller_draws() -> None:
    assert MEMBER.laser is not None
    assert len(fan(MEMBER.laser, Scan(1.0))) == 697


def test_rays_land_where_the_ground_or_a_known_wall_is() -> None:
    scan = Scan(0.2, 0.0, -0.11)
    landed, lands = landing(watcher(0, 0, 0), fan(MEMBER.laser, scan), grid())  # type: ignore[arg-type]
    assert lands.all()
    height_m = MEMBER.robot.body_height_m + 0.08
    np.testing.assert_allclose(np.hypot(*landed.T).min(), height_m / math.tan(0.17), rtol=0.01)
    stopped, _ = landing(watcher(0, 0, 0), fan(MEMBER.laser, scan), grid(0.9))  # type: ignore[arg-type]
    assert stopped[:, 0].max() < 1.05


def test_rasters_look_where_two_cameras_do() -> None:
    first, second = watcher(0.0, 0.0, 0.0), watcher(0.7, 1.2, -math.pi / 2, "picket_0")
    tiles, tries = tiles_of(first, [first, second], grid(), Tries()), Tries()
    best, rate = best_tile(tiles, tries, None)
    assert best is not None and rate > 0.0
    assert not tiles_of(first, [first, replace(second, robot=robot(0.7, 1.2, math.pi / 2))], grid(), Tries())
    before = tries.area_m2(best.squares)
    tries.add(best.squares, 1.0)
    assert tries.area_m2(best.squares) < 0.5 * before


def test_the_thesis_next_stand_is_among_those_tried() -> None:
    (_, stays), (moved, _) = (scan.robots for scan in scan_sequence(2, 1.6))
    stands = next_stands(watcher(stays.x_m, stays.y_m, stays.heading_rad))
    assert np.hypot(*(stands - (moved.x_m, moved.y_m)).T).min() < 1e-9

from __future__ import annotations

import numpy as np
import pytest

from baselines.inchworm_poses import scan_sequence
from coop_envs.agents.catalog import load_robot
from coop_envs.agents.power import sampled_energy_j
from experiments.scan_trip import Trip, energies_j, phases, plane_spots, raster, scanner, timeline

POWER = load_robot("zumy").power
COARSE = Trip(step=0.2)


def test_the_raster_is_the_authors():
    tangents = raster(Trip())
    assert tangents.shape == (170, 2)
    np.testing.assert_allclose(tangents.min(axis=0), [-0.4, -0.4], atol=1e-12)
    np.testing.assert_allclose(tangents.max(axis=0), [0.05, 0.4], atol=1e-12)
    np.testing.assert_allclose(np.abs(np.diff(tangents, axis=0)).sum(axis=1), 0.05)


def test_a_scan_lasts_as_long_as_the_authors():
    _, segments = timeline(Trip(), POWER)
    assert phases(segments) == ["scan t0", "move t1-2", "scan t3", "move t4-5", "scan t6"]
    assert sum(s.duration_s for s in segments if s.phase == "scan t0") == pytest.approx(42.55)
    assert sum(s.laser > 0 for s in segments if s.phase == "scan t3") == 170


def test_a_trips_energy_is_that_of_its_sampled_power_states():
    """Eq (6.16) over states written out by hand, at 1 kHz, against the segments' own sums."""
    _, segments = timeline(COARSE, POWER)
    period, sampled = 1e-3, 0.0
    for s in segments:
        n = round(s.duration_s / period)
        for v, omega in zip(s.speeds, s.yaw_rates, strict=True):
            sampled += sampled_energy_j(POWER.robot, np.tile([v, omega, 0, 1], (n, 1)), period)
            sampled += sampled_energy_j(POWER.marker, np.tile([s.markers, 1], (n, 1)), period)
        sampled += sampled_energy_j(POWER.scanner, np.tile([s.galvo, s.laser, 1], (n, 1)), period)
    assert sum(sum(energies_j(s, POWER)) for s in segments) == pytest.approx(sampled, rel=1e-4)


def test_only_one_robot_moves_at_a_time_and_markers_are_dark_in_scans():
    _, segments = timeline(Trip(), POWER)
    assert all(sum(rate != 0 for rate in (*s.speeds, *s.yaw_rates)) <= 1 for s in segments)
    for s in segments:
        lit = s.markers * 4e-4
        assert lit == pytest.approx(0.224 if s.phase.startswith("move") else 0.0)


@pytest.mark.parametrize("k", range(3))
def test_spots_lie_on_the_floor_or_the_wall_along_the_scanners_rays(k):
    scan, trip = scan_sequence(3)[k], Trip()
    spots = plane_spots(scan, trip)
    x, _, z = spots.points.T
    assert np.all(np.isclose(z, 0, atol=1e-9) | np.isclose(x, trip.wall_x_m))
    assert np.all(z > -1e-9) and np.all(x < trip.wall_x_m + 1e-9)
    way = spots.points - spots.cameras[scanner(scan)]
    right = -way[:, 1] / way[:, 0]
    np.testing.assert_allclose(np.stack([right, way[:, 2] / way[:, 0]], 1), raster(trip, mirrored=k == 1), atol=1e-9)


def test_a_camera_sees_only_what_its_image_holds():
    scan = scan_sequence(1)[0]
    narrow = plane_spots(scan, Trip(half_image=(0.7, 0.525)))
    seen = np.isfinite(narrow.points).all(axis=1)
    assert 0 < seen.sum() < 170
    below = plane_spots(scan, Trip()).points[seen] - narrow.cameras[1]
    assert np.all(np.abs(below[:, 0]) <= 0.7 * -below[:, 1]) and np.all(np.abs(below[:, 2]) <= 0.525 * -below[:, 1])
    starts, ends = narrow.rays()
    assert len(starts) == len(ends) == 2 * seen.sum()

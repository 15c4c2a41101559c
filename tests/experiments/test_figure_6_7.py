from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from baselines.inchworm_poses import scan_sequence
from coop_envs.mapping.swept_volume import SweptVolume, round_section
from experiments.comparison import silent
from experiments.figure_6_7 import SCRIPT, Config, Phase, plot, run, scans, surveyed_phases
from experiments.scan_trip import Spots, Trip, plane_spots, raster
from experiments.shots import Shots
from experiments.surveyed_trip import AUTHORS_RASTER, follow, stretches

FAST = replace(AUTHORS_RASTER, laser=(("raster_half_rad", (0.2, 0.3)), ("step_counts", 10)))
COARSE = Config(trip=Trip(step=0.2), surveyed=(("environment, coarse", FAST),))


@pytest.fixture(scope="module")
def table():
    return run(COARSE)


def test_phases_join_and_only_scans_sweep(table):
    for found in table.trips.values():
        assert [phase.name for phase in found] == ["scan t0", "move t1-2", "scan t3", "move t4-5", "scan t6"]
        assert found[0].energy_j[0] == 0.0 and found[0].h_v[0] == 0.0
        for a, b in pairwise(found):
            assert a.energy_j[-1] == pytest.approx(b.energy_j[0]) and a.h_v[-1] == b.h_v[0]
        for phase in found:
            assert (phase.gained > 0) == phase.name.startswith("scan")
            assert np.all(np.diff(phase.energy_j) > 0)


def test_uses_are_where_they_belong(table):
    for found in table.trips.values():
        for phase in found:
            idle, motion, markers, scanner = phase.used_j
            assert idle == pytest.approx(2 * 7.56 * phase.duration_s, rel=1e-5)
            if phase.name.startswith("scan"):
                assert scanner > 0 and motion == pytest.approx(0, abs=1e-6) and markers == pytest.approx(0, abs=1e-6)
            else:
                assert scanner == 0 and motion > 0 and markers > 0


def test_driving_two_metres_costs_what_the_power_model_says(table):
    """14 W per (m/s)^2 at 0.1 m/s for 20 s, a turn of a quarter for each robot at 0.5 rad/s beside it."""
    drive, turns = 14.0 * 0.1**2 * 20.0, 2 * 0.035 * 0.5 * np.pi / 2
    for found in table.trips.values():
        for phase in found:
            if phase.name.startswith("move"):
                assert phase.used_j[1] == pytest.approx(drive + turns, rel=0.15)


def test_cells_sweep_what_the_exact_union_does(table):
    trip = stretches(follow(FAST))
    rays = Shots.joined([shots for stretch in trip for shots in stretch.shots]).rays()
    exact = SweptVolume(round_section(sides=8)).add(*rays)
    assert surveyed_phases(trip, COARSE)[-1].h_v[-1] == pytest.approx(exact, rel=0.01)
    assert table.trips["environment, coarse"][-1].h_v[-1] == pytest.approx(exact, rel=0.01), "the same once more"
    scripts = [plane_spots(scan, COARSE.trip).rays() for scan in scan_sequence(3)]
    exact = SweptVolume(round_section(sides=8)).add(*(np.concatenate(side) for side in zip(*scripts, strict=True)))
    assert table.trips[SCRIPT][-1].h_v[-1] == pytest.approx(exact, rel=0.01)


def test_the_robots_scan_where_the_authors_did():
    survey = follow(FAST)
    believed = survey.batch.belief.position.numpy()[0, :, :2]
    np.testing.assert_allclose(believed, [(2, 0), (3, 2)], atol=0.04)
    frame = survey.batch.state.frame.numpy()[0].astype(float)
    c, s = np.cos(frame[3]), np.sin(frame[3])
    true = (survey.batch.state.position.numpy()[0, :, :2] - frame[:2]) @ np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(true, [(2, 0), (3, 2)], atol=0.15)


def test_the_map_gains_bits(table):
    for phase in scans(table.trips["environment, coarse"]):
        assert phase.bits is not None and phase.bits[-1] > phase.bits[0] + 50


def test_late_gain_counts_from_the_first_gain_to_the_last():
    uses = np.outer(np.arange(7.0), [1.0, 0.0, 0.0, 0.0])
    phase = Phase("scan", 6.0, uses, np.array([0.0, 0.0, 3.0, 4.0, 4.0, 4.0, 4.0]))
    assert phase.late_gain_share == pytest.approx(0.25)


def test_the_picture_has_three_panels_and_the_table_a_group_a_trip(table):
    assert len(plot(table).axes) == 3
    groups = {row.quantity.split(": ")[0] for row in table.comparisons}
    assert groups == {SCRIPT, "environment, coarse"}


def test_progress_goes_up_to_the_end():
    shares: list[float] = []
    run(replace(COARSE, surveyed=()), tick=shares.append)
    assert shares == [1.0]


def test_spots_may_come_from_elsewhere_and_be_missing():
    def nothing_seen(scan, trip):
        return Spots(plane_spots(scan, trip).cameras, np.full((len(raster(trip)), 3), np.nan))

    table = run(replace(COARSE, surveyed=()), nothing_seen, silent)
    assert table.trips[SCRIPT][-1].h_v[-1] == 0.0
    assert {row.quantity: row.ours for row in table.comparisons}[f"{SCRIPT}: h_v gained, scan t3"] == 0.0

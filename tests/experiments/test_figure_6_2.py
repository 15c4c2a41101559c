from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from baselines.inchworm_poses import scan_sequence
from coop_envs.errors import ConfigError
from coop_envs.mapping.block_map import BlockMap
from coop_envs.mapping.swept_volume import SweptVolume, round_section
from experiments.figure_6_2 import HALF_IMAGE, Config, plot, run
from experiments.scan_trip import Trip, plane_spots
from experiments.surveyed_trip import AUTHORS_RASTER

COARSE = Config(
    trip=Trip(step=0.2),
    surveyed=replace(AUTHORS_RASTER, scans=2, laser=(("raster_half_rad", (0.2, 0.3)), ("step_counts", 10))),
)


@pytest.fixture(scope="module")
def table():
    return run(COARSE)


def test_it_sweeps_what_it_says(table):
    first = plane_spots(scan_sequence(1)[0], COARSE.trip)
    assert table.stages[0].h_v["round"] == pytest.approx(SweptVolume(round_section(sides=8)).add(*first.rays(0, 1)))
    for sweep in ("round", "pentagonal", "environment"):
        values = [stage.h_v[sweep] for stage in table.stages]
        assert 0 < values[0] < values[1] < values[2]
    assert table.stages[0].h_v["pentagonal"] < table.stages[0].h_v["round"]


def test_the_first_measured_spot_is_two_cylinders(table):
    """Their length is that of two ways between a robot and the floor or a wall, both within the corner."""
    metres = table.stages[0].h_v["environment"] * 1e-3 / (np.pi * 0.05**2)
    assert 1.0 < metres < 8.0


def test_the_picture_has_a_panel_for_each_stage_and_trip(table):
    figure = plot(table)
    assert len(figure.axes) == 6 and len(table.comparisons) == 12
    panels: list[Any] = list(figure.axes)
    for axes in panels:
        spans = [np.ptp(getattr(axes, f"get_{axis}lim")()) for axis in "xyz"]
        np.testing.assert_allclose(np.array(axes.get_box_aspect()) / spans, axes.get_box_aspect()[0] / spans[0])


def test_within_both_images_the_first_scan_sweeps_far_less_than_the_thesis():
    for wall_x_m in np.arange(0.5, 12.01, 0.25):
        swept = BlockMap(0.025, 0.05)
        swept.enter(*plane_spots(scan_sequence(1)[0], Trip(wall_x_m=wall_x_m, half_image=HALF_IMAGE)).rays())
        assert swept.h_v < 1000


def test_a_share_beyond_the_scan_is_refused():
    with pytest.raises(ConfigError, match="part_way"):
        Config(part_way=1.0)

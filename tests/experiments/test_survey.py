from __future__ import annotations

import math

import numpy as np
import pytest

from baselines.inchworm_poses import ScanPose
from coop_envs.agents.raster import raster_axes
from coop_envs.agents.specification import Laser
from coop_envs.errors import CoopError
from coop_envs.scenario import load_scenario
from experiments import survey as survey_module
from experiments.shots import Shots, in_world
from experiments.survey import Survey, Sweep


def surveyors(teams: int = 1) -> Survey:
    return Survey(load_scenario("corner", fidelity="features"), teams=teams)


def test_a_scan_lights_every_point_of_its_raster_once():
    survey = surveyors(teams=3)
    survey.flash("poses", 1.0)
    survey.scan("scan", 0, Sweep(share=0.3))
    shots = Shots.joined([decision.shots for decision in survey.log])
    across, up = (len(axis) for axis in raster_axes(Laser(), 0.3))
    assert np.bincount(shots.team).tolist() == [across * up] * 3
    assert {decision.phase for decision in survey.log if len(decision.shots)} == {"scan"}
    assert np.all(np.diff(shots.time_s[shots.team == 1]) > 0)


def test_robots_drive_where_they_are_told():
    survey = surveyors(teams=4)
    survey.flash("poses")
    survey.drive("move", 0, ScanPose(0.8, 0.3, math.pi / 2), 0.2, 0.8)
    place, R = survey.batch.belief.position.numpy()[:, 0], survey.batch.belief.rotation.numpy()[:, 0]
    np.testing.assert_allclose(place[:, :2], np.tile([0.8, 0.3], (4, 1)), atol=0.04)
    np.testing.assert_allclose(np.arctan2(R[:, 1, 0], R[:, 0, 0]), math.pi / 2, atol=0.1)


def test_what_does_not_arrive_is_told(monkeypatch):
    survey = surveyors()
    monkeypatch.setattr(survey_module, "LONGEST_DRIVE_S", 1.0)
    with pytest.raises(CoopError, match="no arrival in far"):
        survey.drive("far", 0, ScanPose(1.5, 0.0, 0.0), 0.1, 0.5)


def test_landings_in_the_world_lie_on_the_planes_of_the_corner():
    survey = surveyors(teams=5)
    survey.flash("poses", 1.0)
    survey.scan("scan", 0, Sweep(share=0.5, elevation_rad=-0.1))
    shots = Shots.joined([decision.shots for decision in survey.log])
    x, y, z = in_world(survey.batch, shots.team, shots.landed).T
    off = np.minimum(np.minimum(np.abs(x - 2.0), np.abs(y + 0.5)), np.abs(z))
    assert np.nanmax(off) < 0.011, "walls rise within a cell of 1 cm"
    assert np.nanmin(np.abs(z)) < 1e-4


def test_energy_is_counted_by_use():
    survey = surveyors()
    before = survey.batch.state.energy.numpy()[0].sum(axis=0).copy()
    survey.flash("poses", 2.0)
    idle, motion, markers, scanner = survey.log[-1].energy_j[0].sum(axis=0) - before
    assert idle == pytest.approx(2 * 7.56 * 2.0, rel=1e-5)
    assert motion == 0.0 and scanner == 0.0 and markers == pytest.approx(2 * 0.459 * 2.0, rel=0.1)

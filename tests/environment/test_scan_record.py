"""What the viewer and the log are told of scanning: every point, in the world, by whom, and what it is worth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.mapping.ground_map import GROUND
from coop_envs.metrics import volume_bits
from coop_envs.point_accuracy import surface_distance_m
from coop_envs.recording import Scan
from coop_envs.recording.scan import NO_SCAN


@pytest.fixture(scope="module")
def scanned():
    """A team that stands in the corner and scans for a while, and all it measured."""
    env = exploration_v0.parallel_env(scenario="corner", team="surveyors")
    env.reset(seed=1)
    action = np.zeros(8, dtype=np.float32)
    action[0], action[4], action[6] = 1.0, 1.0, -0.25
    scans, counted, frames = [env.scan()], 0, []
    for _ in range(60):
        env.step(dict.fromkeys(env.agents, action))
        counted += int(env.batch.loop.points.count.numpy()[0])
        scans.append(env.scan())
        frames.append(env.frame(volume=len(frames) == 0))
    return env, scans, counted, frames


def test_all_points_are_kept_and_lie_on_the_surface(scanned):
    env, scans, counted, frames = scanned
    scan = Scan.joined(scans)
    assert len(scan) == counted > 100
    assert sum(len(frame.scan) for frame in frames) == counted
    distance = surface_distance_m(env.batch.pool.worlds[0], scan.points_m)
    assert np.median(distance) < 0.02
    assert np.median(scan.point_sigma_m) == pytest.approx(math.sqrt(3) * np.median(distance), rel=2.0)


def test_each_point_is_told_with_its_laser_and_two_cameras(scanned):
    env, scans, _, frames = scanned
    robots = Scan.joined(scans).point_robots
    cameras = [k for k, member in enumerate(env.scenario.team.members) if member.camera is not None]
    lasers = [k for k, member in enumerate(env.scenario.team.members) if member.laser is not None]
    assert set(np.unique(robots[:, 0])) <= set(lasers)
    assert len(set(robots[:, 0])) > 1
    assert set(np.unique(robots[:, 1:])) <= set(cameras)
    assert (robots[:, 1] != robots[:, 2]).all()
    assert frames[10].scanning.all()


def test_metrics_tell_of_the_points(scanned):
    env, scans, counted, _ = scanned
    scan = Scan.joined(scans)
    metrics = env.metrics(scan)
    assert metrics["points_measured"] == counted
    assert metrics["point_error_m"] < metrics["point_error_95_m"] < 0.3
    assert "points_measured" not in env.metrics()
    assert metrics["survey_bits"] > 0.5 * metrics["volume_bits"], "at all heights, without what bodies add"
    assert 0 < metrics["h_v"] < 2 * counted * 3.0 / 0.1
    nothing = env.metrics(NO_SCAN)
    assert nothing["point_error_m"] is None and nothing["h_v"] == nothing["survey_bits"] == 0.0


def test_volume_and_ground_make_up_the_information(scanned):
    """A standing team's ground is what its start proved; all that came after it lies in the volume."""
    env, _, _, frames = scanned
    at_rest = frames[0].information_bits
    ground = env.batch.map.log_odds.numpy()[0, int(GROUND)]
    gained = env.frame().information_bits - at_rest
    assert (ground != 0).any()
    assert volume_bits(env.batch, 0) == pytest.approx(gained + volume_at_start(frames), rel=0.02)


def volume_at_start(frames) -> float:
    """Bits that the first frame's volume holds if all of it is right."""
    p = np.clip(frames[0].map_volume[frames[0].map_volume != 128] / 255.0, 1e-3, 1 - 1e-3)
    return float(np.sum(1.0 + p * np.log2(p) + (1.0 - p) * np.log2(1.0 - p)))

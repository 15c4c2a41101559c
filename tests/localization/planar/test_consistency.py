"""Whether the planar filter's covariance tells the truth, and whether one that linearises plainly does."""

from __future__ import annotations

import numpy as np
import pytest

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.driving import driven
from coop_envs.localization.planar.settings import PlanarSettings
from tests.localization.planar.plain_filter import PlainFilter
from tests.localization.planar.world import STEP_S, World, nees, started

SEEDS, STEPS, ROBOTS = 14, 100, 3
ROUGH = PlanarSettings(yaw_rad_rtm=0.3, yaw_rad_rtrad=0.3, start_position_m=0.1, start_yaw_rad=0.2)


def make_world(seed: int) -> World:
    rng = np.random.default_rng(seed)
    pose = np.stack([rng.uniform(-1.0, 1.0, ROBOTS), rng.uniform(-1.0, 1.0, ROBOTS), rng.uniform(-3, 3, ROBOTS)], 1)
    return World(ROUGH, pose, np.zeros((0, 2)), rng, sight_m=10.0, range_sigma_m=0.05, bearing_sigma_rad=0.03)


def plain_like(team) -> PlainFilter:
    blocks = np.zeros_like(team.covariance)
    order = [1, 2, 0]
    for k, name in enumerate(team.names):
        blocks[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = team.covariance_of(name)[np.ix_(order, order)]
    return PlainFilter(ROUGH, team.pose, blocks)


def run(seed: int):
    """Squared yaw errors over their variance of the plain filter and ours, and NEES of ours, each (instants, K)."""
    world = make_world(seed)
    team = started(world)
    plain = plain_like(team)
    plain_yaw, our_yaw, our_nees = [], [], []
    for step in range(STEPS):
        forward, turn = np.full(ROBOTS, 0.8), world.rng.normal(0.4, 0.3, ROBOTS)
        world.drive(forward, turn)
        team.move(np.arange(ROBOTS), *driven(team.settings, forward, turn, STEP_S))
        plain.drive(forward, turn, STEP_S)
        seen = world.look()
        team.update(seen)
        plain.see(seen.seer, seen.subject, seen.measured, seen.sigma)
        if step >= STEPS // 3 and step % 5 == 0:
            our_yaw.append(se2.wrapped(team.pose[:, 2] - world.pose[:, 2]) ** 2 / np.diag(team.covariance)[::3])
            plain_yaw.append(se2.wrapped(plain.pose[:, 2] - world.pose[:, 2]) ** 2 / np.diag(plain.P)[2::3])
            our_nees.append(nees(team, world.pose))
    return np.array(plain_yaw), np.array(our_yaw), np.array(our_nees)


@pytest.fixture(scope="module")
def runs():
    """As `run`, each (seeds, instants, K)."""
    return [np.array(part) for part in zip(*(run(seed) for seed in range(SEEDS)), strict=True)]


@pytest.mark.slow
def test_plain_linearisation_is_overconfident_in_yaw_and_ours_is_not(runs):
    plain, ours, _ = runs
    assert plain.mean() > 1.5
    assert 0.7 < ours.mean() < 1.3


@pytest.mark.slow
def test_poses_are_consistent(runs):
    assert 0.75 < runs[2].mean() < 1.25

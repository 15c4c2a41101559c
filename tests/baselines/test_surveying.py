"""Whole surveys in the environment itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from baselines.frontier import Frontier
from baselines.inchworm_scan import InchwormScan
from baselines.surveying import SET_DOWN_M
from coop_envs import exploration_v0
from coop_envs.agents.team import Member
from coop_envs.errors import ConfigError
from coop_envs.policy import Policy, check_needs
from tests.baselines.fake_world import describe

POLICIES = (InchwormScan, Frontier)
SCENE: dict[str, Any] = {"scenario": "u_turn", "team": "surveyors", "map.ego_stride": 2}


def unscanned(env: Any, starts: np.ndarray) -> list[str]:
    """Robots whose bodies reach over cells that the belief does not hold free, away from where they were set down."""
    model, batch = env.batch.map_model, env.batch
    free = batch.map.log_odds.numpy()[0, 1].reshape(model.nx, model.ny) < 0
    cells = np.stack(np.meshgrid(np.arange(model.nx), np.arange(model.ny), indexing="ij"), axis=-1)
    centres = batch.map.corner.numpy()[0] + (cells + 0.5) * model.cell
    known = free | (np.hypot(*np.moveaxis(centres[:, :, None] - starts, -1, 0)).min(axis=-1) <= SET_DOWN_M)
    positions = batch.belief.position.numpy()[0, :, :2]
    members: tuple[Member, ...] = env.scenario.team.members
    return [
        member.name
        for member, at in zip(members, positions, strict=True)
        if not known[np.hypot(*np.moveaxis(centres - at, -1, 0)) <= member.robot.body_radius_m].all()
    ]


@pytest.mark.parametrize("policy_type", POLICIES)
def test_nobody_drives_over_unscanned_ground_and_somebody_always_stands(policy_type: type[Policy]) -> None:
    env, policy = exploration_v0.parallel_env(**SCENE), policy_type()
    observations, _ = env.reset(seed=3)
    policy.reset(env.team_description, 3)
    starts = env.batch.belief.position.numpy()[0, :, :2].copy()
    moved = scanned = 0
    for _ in range(600):
        actions = policy.act(observations)
        for action in actions.values():
            assert action.shape == (8,) and action.dtype == np.float32 and np.all(np.abs(action) <= 1.0)
        moving = [name for name, action in actions.items() if action[0] <= 0.0]
        driving = [name for name in moving if actions[name][1] != 0.0]
        scanning = [name for name, action in actions.items() if action[4] > 0.0]
        assert len(driving) <= 1 and len(moving) < len(env.agents)
        assert not (moving and scanning)
        moved, scanned = moved + len(moving), scanned + len(scanning)
        observations, *_ = env.step(actions)
        assert unscanned(env, starts) == []
    assert moved > 100 and scanned > 100
    assert env.metrics()["mapped_m2"] > 0.5


def test_equal_seeds_survey_alike() -> None:
    runs = []
    for _ in range(2):
        env, policy = exploration_v0.parallel_env(**SCENE), InchwormScan()
        observations, _ = env.reset(seed=5)
        policy.reset(env.team_description, 5)
        runs.append([])
        for _ in range(150):
            runs[-1].append(policy.act(observations))
            observations, *_ = env.step(runs[-1][-1])
    assert all(np.array_equal(a[name], b[name]) for a, b in zip(*runs, strict=True) for name in a)


@pytest.mark.parametrize("lost", ["observer_0", "picket_0"])
def test_the_team_goes_on_as_long_as_two_are_left(lost: str) -> None:
    env, policy = exploration_v0.parallel_env(**SCENE), InchwormScan()
    observations, _ = env.reset(seed=1)
    policy.reset(env.team_description, 1)
    scans = 0
    for decision in range(300):
        live = {name: seen for name, seen in observations.items() if decision < 100 or name != lost}
        if decision > 250:
            live = {"picket_1": observations["picket_1"]}
        actions = policy.act(live)
        assert set(actions) == set(live)
        if 100 < decision <= 250:
            scans += any(action[4] > 0.0 for action in actions.values())
        if decision > 260:
            assert actions["picket_1"][0] > 0.0 and actions["picket_1"][4] <= 0.0
        still = {name: np.array([1, 0, 0, 0, -1, 0, 0, 0], np.float32) for name in env.agents}
        observations, *_ = env.step({**still, **actions})
    assert scans > 10


@pytest.mark.parametrize("policy_type", POLICIES)
@pytest.mark.parametrize("team", ["scouts", "inchworm"])
def test_teams_that_cannot_scan_are_refused(policy_type: type[Policy], team: str) -> None:
    with pytest.raises(ConfigError, match="at least"):
        check_needs(policy_type(), describe(team))

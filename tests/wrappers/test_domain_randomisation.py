"""Scenarios drawn anew: within their ranges, by their law, by the seed; refused before training, not during it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from coop_envs.errors import ConfigError
from coop_envs.scenario import load_scenario
from coop_envs.wrappers import ActionDelay, Choice, DomainRandomisation, Range, sample_scenario
from tests.wrappers.stacks import team

RANGES = {
    "environment.friction": Range(0.4, 1.0),
    "sensing.pixel_noise_px": Range(0.1, 10.0, log=True),
    "rates.substeps": Range(4, 6),
    "environment.texture": Choice(("cardboard", "carpet")),
    "team.members.picket_0.cruise_speed_m_s": Range(0.1, 0.2),
}


def test_entries_follow_their_laws() -> None:
    scenario, rng = load_scenario("arena", team="inchworm"), np.random.default_rng(0)
    drawn = [sample_scenario(scenario, RANGES, rng) for _ in range(300)]
    friction = [one.environment.friction for one in drawn]
    noise = [one.sensing.pixel_noise_px for one in drawn]
    assert stats.kstest(friction, stats.uniform(0.4, 0.6).cdf).pvalue > 1e-3
    assert stats.kstest(noise, stats.loguniform(0.1, 10.0).cdf).pvalue > 1e-3
    assert {one.rates.substeps for one in drawn} == {4, 5, 6}
    assert {one.environment.texture for one in drawn} == {"cardboard", "carpet"}
    assert all(0.1 <= one.team.members[1].cruise_speed_m_s <= 0.2 for one in drawn)
    assert all(one.team.members[2] == scenario.team.members[2] for one in drawn)


def test_the_order_in_which_entries_are_named_does_not_matter() -> None:
    scenario = load_scenario("arena", team="inchworm")
    backwards = dict(reversed(RANGES.items()))
    a, b = (sample_scenario(scenario, ranges, np.random.default_rng(4)) for ranges in (RANGES, backwards))
    assert a == b != scenario


def test_every_reset_draws_anew_and_the_environment_obeys() -> None:
    env = DomainRandomisation(ActionDelay(team(), 1), {"team.members.picket_0.cruise_speed_m_s": Range(0.05, 0.2)})
    drive = np.array([-1, 1, 0, 0, 0, 0, 0, 1], np.float32)
    speeds, ways = [], []
    for _ in range(4):
        env.reset(seed=None if speeds else 0)
        speeds.append(env.scenario.team.members[1].cruise_speed_m_s)
        start = env.frame().true_xy_yaw[1, :2].copy()
        for _ in range(5):
            env.step({name: drive if name == "picket_0" else np.eye(1, 8)[0] for name in env.agents})
        ways.append(np.linalg.norm(env.frame().true_xy_yaw[1, :2] - start))
        assert env.team_description.members[1].cruise_speed_m_s == speeds[-1]
    assert len(set(speeds)) == 4
    assert np.argsort(ways).tolist() == np.argsort(speeds).tolist()
    np.testing.assert_allclose(np.array(ways) / speeds, 0.8, rtol=0.15)  # four decisions of 0.2 s


def test_spaces_stay_the_same_objects() -> None:
    env = DomainRandomisation(team(), RANGES)
    space = env.action_space("picket_0")
    env.reset(seed=0)
    assert env.action_space("picket_0") is space


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"environment.friction": Range(0.4, 3.0)}, r"environment\.friction: got 3\.0, expected above 0, at most 2"),
        ({"environment.frikshun": Range(0.4, 1.0)}, "did you mean 'friction'"),
        ({"environment.medium": Choice(("air", "fire", "water"))}, "'air' or 'water'"),
        (
            {"rates.tick_s": Range(0.01, 0.2), "rates.substeps": Range(1, 64)},
            r"rates\.substeps: got 1, expected enough",
        ),
        ({"team": Choice(("inchworm", "scouts"))}, "leave the team"),
        ({"rates.ticks_per_decision": Range(1, 99)}, "1 to 60"),
    ],
)
def test_ranges_are_tried_at_both_ends(ranges, message) -> None:
    with pytest.raises(ConfigError, match=message):
        DomainRandomisation(team(), ranges)


def test_ranges_are_ranges() -> None:
    with pytest.raises(ConfigError, match=r"^range: got"):
        Range(2.0, 1.0)
    with pytest.raises(ConfigError, match=r"^range\.low: got 0"):
        Range(0.0, 1.0, log=True)
    with pytest.raises(ConfigError, match=r"^choice\.options"):
        Choice(())

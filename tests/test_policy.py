"""Policies by name and by file, and teams that do not meet their needs."""

from __future__ import annotations

from pathlib import Path

import pytest

from coop_envs.agents.catalog import load_team
from coop_envs.errors import ConfigError
from coop_envs.policy import Policy, TeamDescription, TeamNeeds, check_needs, load_policy

FILE = """
from baselines.random_walk import RandomWalk

def make_policy():
    return RandomWalk()
"""


def described(team: str) -> TeamDescription:
    members = load_team(team).members
    return TeamDescription(tuple(m.name for m in members), members, 0.05, 0.2, goal_known=True, time_limit_s=60.0)


@pytest.mark.parametrize("name", ["random_walk", "goal_grid"])
@pytest.mark.parametrize("team", ["scouts", "inchworm", "surveyors"])
def test_baselines_are_found_by_name_and_fit_the_teams(name: str, team: str) -> None:
    policy = load_policy(name)
    assert policy.name == name
    assert isinstance(policy, Policy)
    check_needs(policy, described(team))


def test_a_misspelt_name_is_told_its_neighbour() -> None:
    with pytest.raises(ConfigError, match=r"^policy: got 'goal_gird', expected one of .*did you mean 'goal_grid'\?\)$"):
        load_policy("goal_gird")


def test_a_file_makes_a_policy(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    assert load_policy(str(path)).name == "random_walk"


@pytest.mark.parametrize(
    ("text", "expected"), [("", "defines make_policy"), ("make_policy = list", "name, needs, reset")]
)
def test_a_file_that_makes_none_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=expected):
        load_policy(str(path))
    with pytest.raises(ConfigError, match="existing"):
        load_policy(str(tmp_path / "none.py"))


@pytest.mark.parametrize("kind", ["cameras", "hats", "lasers", "pickets"])
def test_a_team_that_falls_short_is_refused_in_one_line(kind: str) -> None:
    policy = load_policy("random_walk")
    policy.needs = TeamNeeds(**{kind: 20})
    with pytest.raises(ConfigError) as caught:
        check_needs(policy, described("scouts"))
    assert str(caught.value).startswith(f"team.{kind}: got ")
    assert "at least 20 (policy random_walk needs them)" in str(caught.value)
    assert "\n" not in str(caught.value)

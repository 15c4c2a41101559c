from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_team, names
from coop_envs.errors import ConfigError
from coop_envs.localization.logs.team_file import LogTeam, read_team, read_team_text, team_text


@pytest.mark.parametrize("name", names("teams"))
def test_a_team_comes_back_from_its_text(name):
    team = load_team(name)
    robots = tuple(f"robot {k}" for k in range(len(team.members)))
    starts = {robots[0]: (0.0, 0.0, 0.0), robots[1]: (0.1, -0.25, 3.0)}
    back = read_team_text(team_text(team, robots, starts), "team.yaml")
    assert (back.team, back.robots, back.starts) == (team, robots, starts)


def test_a_team_by_name_or_as_it_is():
    team = load_team("inchworm")
    for reference in ("inchworm", team, {"base": "inchworm"}):
        found = read_team(reference)
        assert found.team == team and found.robots == ("observer_0", "picket_0", "picket_1")


def test_robots_without_a_team():
    found = read_team({"robots": ["a", "b"], "starts": {"b": [1, 2, 0.5]}})
    assert (found.team, found.robots, found.starts) == (None, ("a", "b"), {"b": (1.0, 2.0, 0.5)})
    back = read_team_text(team_text(None, found.robots, found.starts), "team.yaml")
    assert (back.team, back.robots, back.starts) == (None, found.robots, found.starts)


def test_members_own_starts_are_seen_from_the_first_observer():
    member = {"robot": "zumy", "start": [1.0, 2.0, 1.5707963267948966]}
    team = {
        "members": [
            {**member, "role": "observer", "cameras": ["lifecam"]},
            {**member, "role": "picket", "hat": "zumy", "start": [1.0, 2.5, 1.5707963267948966]},
        ]
    }
    starts = read_team(team).starts
    assert starts["observer_0"] == (0.0, 0.0, 0.0)
    assert starts["picket_0"] == pytest.approx((0.5, 0.0, 0.0))
    assert read_team({**team, "starts": {"picket_0": [3, 3, 3]}}).starts == {"picket_0": (3.0, 3.0, 3.0)}


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"base": "inchworms"}, "team.base: got 'inchworms', expected one of the teams"),
        ({"base": "inchworm", "robots": ["a"]}, r"team.robots: got \('a',\), expected none beside a team"),
        ({"base": "inchworm", "names": {"picket_7": "a"}}, "team.names: got 'picket_7', expected a member: observer_0"),
        ({"base": "inchworm", "names": {"picket_0": "picket_1"}}, r"team.names: got .*expected each name once"),
        ({"base": "inchworm", "starts": {"zumy": [0, 0, 0]}}, "team.starts: got 'zumy', expected a robot of the log"),
        ({"base": "inchworm", "starts": {"picket_0": [0, 0]}}, "team.starts.picket_0"),
        ({"base": "inchworm", "starts": {"picket_0": [0, 0, float("nan")]}}, "expected a finite number"),
        ({"base": "inchworm", "start": {}}, "team.start: got 'start'"),
        ({"starts": {}}, "team: got None, expected a team"),
        ({"robots": ["a"], "cameras": []}, "team.cameras: got 'cameras', expected one of: base, members"),
        ({"robots": ["a"], "name": "b"}, "team.name: got 'b', expected none without a team"),
        ({"base": "inchworm", "strats": {}}, "team.strats: got 'strats', .*; did you mean 'starts'?"),
        ({"robots": ["a"], "names": {"a": "b"}}, "team.names: got .* expected none without a team"),
        ({"robots": ["a", "a"]}, "expected each name once"),
        ("none.yaml", "team: got 'none.yaml', expected a YAML file that can be read"),
        ("none", "team: got 'none', expected one of the teams"),
    ],
)
def test_refused(entries, message):
    with pytest.raises(ConfigError, match=message):
        read_team(entries)


@settings(max_examples=200, deadline=None)
@given(text=st.one_of(st.text(max_size=60), st.text(max_size=40).map(lambda tail: f"base: inchworm\n{tail}")))
def test_any_text_gives_a_team_or_a_plain_refusal(text):
    try:
        found = read_team_text(text, "team.yaml")
    except ConfigError:
        return
    assert isinstance(found, LogTeam)

from __future__ import annotations

import pytest

from coop_envs.agents import load_robot, load_team
from coop_envs.agents.catalog import names
from coop_envs.errors import ConfigError

EYE = {"role": "observer", "robot": "zumy", "cameras": ["lifecam"]}


def test_presets_are_as_described():
    scouts, inchworm = load_team("scouts"), load_team("inchworm")
    assert [m.reserve for m in scouts.members] == [False, False] + [True] * 11
    assert {m.robot.name for m in scouts.members[1:]} == {"velociroach"}
    assert [m.hat.name if m.hat else None for m in inchworm.members] == [None, "zumy", "zumy2"]
    for name, size in (("surveyors", 3), ("surveyors_pair", 2)):
        members = load_team(name).members
        assert len(members) == size
        assert all(m.camera and m.hat and m.laser for m in members)


@pytest.mark.parametrize("name", names("teams"))
def test_names_follow_roles_and_every_active_picket_can_be_seen(name):
    team = load_team(name)
    assert [m.name for m in team.members][:2] == ["observer_0", "picket_0"]
    assert all(m.hat for m in team.members if m.role == "picket")


def test_a_team_is_read_from_a_file(tmp_path):
    file = tmp_path / "duo.yaml"
    file.write_text(
        "members:\n"
        "  - {role: observer, robot: zumy, cameras: [lifecam]}\n"
        "  - {role: picket, robot: {base: zumy, mass_kg: 0.4}, hat: hat1, count: 2, start: [1, 0.5, 0]}\n"
    )
    team = load_team(file)
    assert team.name == "duo"
    assert team.members[2].name == "picket_1"
    assert team.members[1].robot.mass_kg == 0.4
    assert team.members[1].start == (1.0, 0.5, 0.0)
    assert load_team(team) is team


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ([], "a list of robots"),
        ("zumy", "a list of robots"),
        (["zumy"], r"members\.0: .*a mapping"),
        ([{**EYE, "cameras": []}], r"team\.members\.cameras: .*at least one robot with a camera"),
        ([{**EYE, "cameras": []}, {**EYE}], r"a camera on the first observer"),
        ([{"role": "picket", "robot": "zumy", "cameras": ["ch6"]}], "an observer first"),
        ([EYE, {"role": "pickett", "robot": "zumy"}], r"members\.1\.role: .*did you mean 'picket'"),
        ([EYE, {"role": "picket", "robot": "zumy"}, EYE], "observers before pickets"),
        ([{**EYE, "name": "eye"}], r"team\.members\.name"),
        ([{**EYE, "cameras": "lifecam"}], "a list of cameras"),
        ([{**EYE, "cameras": ["lifecam", "ch6"]}], "none or one camera"),
        ([{**EYE, "hat": "hat2"}], r"members\.0\.hat: .*hat0, hat1"),
        ([{**EYE, "count": 0}], r"members\.0\.count"),
        ([{**EYE, "cruise_speed_m_s": 3.0}], r"at most 1\.0 m/s \(zumy\)"),
        ([{**EYE, "reserve": True}], "false for an observer"),
        ([{**EYE, "wheels": 4}], r"members\.0\.wheels: "),
        ([{"role": "observer", "cameras": ["ch6"]}], r"members\.0\.robot: got None, expected a value"),
    ],
)
def test_bad_teams_are_refused_in_one_line(members, message):
    with pytest.raises(ConfigError, match=message) as caught:
        load_team({"members": members})
    assert "\n" not in str(caught.value)


def test_an_unknown_preset_and_a_missing_file_are_refused():
    with pytest.raises(ConfigError, match="did you mean 'inchworm'"):
        load_team("inchwrom")
    with pytest.raises(ConfigError, match="a file that exists"):
        load_team("nowhere/team.yaml")


def test_a_base_lends_what_is_not_replaced():
    heavy = load_robot({"base": "zumy", "name": "heavy", "mass_kg": 0.5})
    assert (heavy.name, heavy.mass_kg, heavy.track_m) == ("heavy", 0.5, 0.1)

from __future__ import annotations

import itertools

import pytest

from coop_envs.agents.catalog import load_team
from coop_envs.agents.colours import arrangements


@pytest.mark.parametrize(("leds", "count", "shared"), [(6, 13, 1), (5, 13, 2), (4, 4, 0), (8, 14, 1)])
def test_arrangements_agree_on_few_leds(leds, count, shared):
    made = arrangements(leds, count)
    assert made[0] == tuple(range(leds)) and len(set(made)) == count
    for a, b in itertools.combinations(made, 2):
        assert sum(x == y for x, y in zip(a, b, strict=True)) <= shared


def test_there_is_an_arrangement_for_everyone():
    assert len(arrangements(4, 30)) == 30


def test_robots_of_a_team_with_the_same_hat_wear_different_colours():
    hats = [member.hat for member in load_team("scouts").members if member.hat and member.hat.name == "hat0"]
    assert len({tuple(led.hue_deg for led in hat.leds) for hat in hats}) == len(hats) == 12
    assert len({tuple(led.position_m for led in hat.leds) for hat in hats}) == 1
    assert len({tuple(sorted(led.hue_deg for led in hat.leds)) for hat in hats}) == 1
    other = [member.hat for member in load_team("surveyors").members]
    assert [hat.leds[0].hue_deg for hat in other if hat] == [0.0, 0.0, 0.0]

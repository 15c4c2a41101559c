"""What a policy's file says about itself, and what it must not be made to say."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.actions import ACTION_NAMES
from coop_envs.errors import ConfigError
from coop_envs.observations import MATE_FIELDS, SELF_FIELDS
from coop_envs.policy import TeamNeeds
from coop_envs.scenario import load_scenario
from policies.description import Entry, Input, PolicyDescription, describe_policy, description_in, read_description
from policies.networks import NetworkSettings
from tests.policies.builders import description

SLOWLY = settings(deadline=None)  # the first example prepares the checks
VALID = description(NetworkSettings())
OWN, MATES, MAP = VALID.inputs
ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


def paths(data: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Every place in nested data."""
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [path] * bool(path) + [p for key, child in children for p in paths(child, (*path, key))]


PLACES = paths(json.loads(VALID.to_json()))


def test_a_description_tells_scenario_rates_and_entries():
    rubble = describe_policy(
        "digger", load_scenario("rubble"), NetworkSettings(kind="mlp"), command="coop train", seed=3, steps=10, repeat=2
    )
    assert (rubble.decision_s, rubble.repeat, rubble.cell_m, rubble.scenario) == (0.2, 2, 0.1, "rubble")
    own, mates, window = rubble.inputs
    assert [entry.name for entry in own.entries] == [field.name for field in SELF_FIELDS]
    assert [(e.unit, e.scale) for e in mates.entries] == [(f.unit, f.scale) for f in MATE_FIELDS]
    assert [entry.name for entry in window.entries] == ["ground", "obstacle", "robots"]
    assert rubble.actions == ACTION_NAMES


@pytest.mark.parametrize(
    ("scenario", "needs"),
    [("arena", TeamNeeds(cameras=1, hats=1, pickets=1)), ("rubble", TeamNeeds(cameras=1, hats=1, lasers=1, pickets=1))],
)
def test_a_policy_needs_one_of_each_that_it_was_trained_with(scenario, needs):
    made = describe_policy("p", load_scenario(scenario), NetworkSettings(), command="", seed=0, steps=0)
    assert made.needs == needs
    fixed = TeamNeeds(cameras=2)
    made = describe_policy("p", load_scenario(scenario), NetworkSettings(), command="", seed=0, steps=0, needs=fixed)
    assert made.needs == fixed


@pytest.mark.parametrize(
    ("values", "start"),
    [
        ({"format": 2}, "format: got 2, expected 1"),
        ({"name": " "}, "name: got ' ', expected"),
        ({"name": "a\nb"}, "name: got 'a\\nb', expected"),
        ({"decision_s": 0.0}, "decision_s: got 0.0, expected above 0 s"),
        ({"decision_s": float("nan")}, "decision_s: got nan, expected above 0 s"),
        ({"cell_m": -1.0}, "cell_m: got -1.0, expected above 0 m"),
        ({"repeat": 0}, "repeat: got 0, expected 1 decision or more"),
        ({"seed": -1}, "seed: got -1, expected 0 or more"),
        ({"steps": -1}, "steps: got -1, expected 0 or more"),
        ({"needs": TeamNeeds(hats=-1)}, "needs.hats: got -1, expected 0 or more"),
        ({"actions": ACTION_NAMES[::-1]}, "actions: got ('marker_brightness', "),
        ({"inputs": VALID.inputs[:1]}, "inputs: got ['self'], expected self, mates, map"),
        (
            {"inputs": (Input("self", OWN.entries[:-1]), MATES, MAP)},
            "inputs.self: got '28 entries', expected the 29 that are observed",
        ),
        (
            {"inputs": (OWN, Input("mates", (Entry("role_observer", "1", 2.0), *MATES.entries[1:])), MAP)},
            "inputs.mates[0]: got 'role_observer in 2 1', expected role_observer in 1 1, which is observed",
        ),
    ],
)
def test_values_that_cannot_be_are_refused_in_one_line(values, start):
    with pytest.raises(ConfigError) as caught:
        replace(VALID, **values)
    assert str(caught.value).startswith(start)
    assert "\n" not in str(caught.value)


@SLOWLY
@given(
    name=st.text(min_size=1).filter(lambda s: s.strip() and s.isprintable()),
    command=st.text(),
    seed=st.integers(0, 2**64),
    repeat=st.integers(1, 50),
    stochastic=st.booleans(),
    decision_s=st.floats(1e-3, 10.0),
    hold=st.floats(0.01, 0.99),
    kind=st.sampled_from(["attention", "mlp"]),
)
def test_json_gives_back_an_equal_description(hold, kind, **values):
    made = replace(VALID, **values, network=NetworkSettings(kind=kind, hold_probability=hold))
    assert read_description(made.to_json(), "file") == made


def refused_or_valid(text: str) -> PolicyDescription | None:
    """What the text describes; None if it is refused as it should."""
    try:
        return read_description(text, "file")
    except ConfigError as error:
        message = str(error)
    assert "\n" not in message
    assert message.startswith("file")
    return None


@SLOWLY
@given(st.text() | ANY_JSON.map(json.dumps))
def test_no_text_does_more_than_to_be_refused(text):
    assert refused_or_valid(text) is None


@settings(SLOWLY, max_examples=300)
@given(place=st.sampled_from(PLACES), value=ANY_JSON)
def test_any_entry_replaced_is_refused_or_valid(place, value):
    data = json.loads(VALID.to_json())
    parent = data
    for key in place[:-1]:
        parent = parent[key]
    parent[place[-1]] = value
    made = refused_or_valid(json.dumps(data))
    if made is not None:
        assert read_description(made.to_json(), "file") == made


@SLOWLY
@given(place=st.sampled_from(PLACES))
def test_no_entry_may_be_missing(place):
    data = json.loads(VALID.to_json())
    parent = data
    for key in place[:-1]:
        parent = parent[key]
    del parent[place[-1]]
    has_default = place[0] in ("needs", "network") and len(place) == 2
    assert (refused_or_valid(json.dumps(data)) is not None) == has_default


@pytest.mark.parametrize("place", [(), ("network",), ("inputs", 0), ("inputs", 1, "entries", 3)])
def test_unknown_entries_are_refused(place):
    data = json.loads(VALID.to_json())
    parent = data
    for key in place:
        parent = parent[key]
    parent["colour"] = "red"
    with pytest.raises(ConfigError, match=r"^file: .*colour.*expected one of: "):
        read_description(json.dumps(data), "file")


def test_metadata_without_a_description_is_refused():
    with pytest.raises(ConfigError, match=r"^file: metadata: got \['author'\], expected an entry coop_envs_policy$"):
        description_in({"author": "me"}, "file")


def test_deeply_nested_json_is_refused():
    assert refused_or_valid("[" * 100_000) is None

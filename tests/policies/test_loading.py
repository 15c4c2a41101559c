"""Files that are no policies, or policies of another time, team or rate."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import onnx
import pytest
from onnx import TensorProto, helper

from coop_envs.errors import ConfigError
from coop_envs.policy import Policy
from policies import shipped as shipping
from policies.description import METADATA_KEY
from policies.loading import load
from policies.network_settings import NetworkSettings
from policies.shipped import shipped, shipped_names
from tests.policies.builders import description, model, team


def described(change: Callable[[dict[str, Any]], Any]) -> bytes:
    """A policy file whose description is changed."""
    data = json.loads(description(NetworkSettings(kind="mlp")).to_json())
    change(data)
    return altered(lambda proto: helper.set_model_props(proto, {METADATA_KEY: json.dumps(data)}))


def altered(change: Callable[[onnx.ModelProto], Any]) -> bytes:
    """A policy file whose model is changed."""
    proto = onnx.load_model_from_string(model())
    change(proto)
    return proto.SerializeToString()


def other_model(proto: onnx.ModelProto) -> None:
    """A valid model that is no policy, under a policy's description."""
    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in "xy")
    proto.graph.CopyFrom(helper.make_graph([helper.make_node("Relu", ["x"], ["y"])], "other", [x], [y]))


def fixed_rows(proto: onnx.ModelProto) -> None:
    for value in proto.graph.input:
        value.type.tensor_type.shape.dim[0].dim_value = 3


def no_std(proto: onnx.ModelProto) -> None:
    del proto.graph.output[3]


BAD: dict[str, tuple[Callable[[], bytes], str]] = {
    "empty": (lambda: b"", "a policy exported to ONNX"),
    "text": (lambda: b"def make_policy():\n    pass\n", "a policy exported to ONNX"),
    "truncated": (lambda: model()[:-1000], "a policy exported to ONNX"),
    "half": (lambda: model()[: len(model()) // 2], "a policy exported to ONNX"),
    "no description": (lambda: altered(lambda m: m.ClearField("metadata_props")), "an entry coop_envs_policy"),
    "no JSON": (lambda: altered(lambda m: helper.set_model_props(m, {METADATA_KEY: "{"})), "in JSON"),
    "version": (lambda: described(lambda d: d.update(format=2)), "format: got 2, expected 1"),
    "no version": (lambda: described(lambda d: d.pop("format")), "format: got None, expected 1"),
    "actions": (lambda: described(lambda d: d["actions"].reverse()), "actions: got ('marker_brightness'"),
    "entries": (lambda: described(lambda d: d["inputs"][0]["entries"].pop()), "inputs.self: got '28 entries'"),
    "order": (
        lambda: described(lambda d: d["inputs"][1]["entries"].reverse()),
        "inputs.mates[0]: got 'speed in 0.5 m/s', expected role_observer in 1 1",
    ),
    "scale": (
        lambda: described(lambda d: d["inputs"][0]["entries"][2].update(scale=1.0)),
        "inputs.self[2]: got 'x in 1 m', expected x in 2 m",
    ),
    "type": (lambda: described(lambda d: d.update(repeat="often")), "repeat: got 'often', expected a"),
    "other model": (lambda: altered(other_model), "inputs: got {'x'"),
    "fixed rows": (lambda: altered(fixed_rows), "expected any number of robots"),
    "no std": (lambda: altered(no_std), "outputs.std: got []"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, kind):
    make, message = BAD[kind]
    path = tmp_path / "policy.onnx"
    path.write_bytes(make())
    with pytest.raises(ConfigError) as caught:
        load(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_file_or_its_folder_is_a_policy(tmp_path):
    path = tmp_path / "policy.onnx"
    path.write_bytes(model())
    for place in (path, tmp_path, str(tmp_path)):
        policy = load(place)
        assert isinstance(policy, Policy)
        assert policy.name == "learned"


@pytest.mark.parametrize("place", ["none.onnx", "."])
def test_a_missing_file_is_told(tmp_path, place):
    expected = r"^policy: got .*, expected an existing \.onnx file, or a folder with policy\.onnx$"
    with pytest.raises(ConfigError, match=expected):
        load(tmp_path / place)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"decision_s": 0.1}, "team.decision_s: got 0.1, expected 0.2 (policy learned was trained so)"),
        ({"cell_m": 0.1}, "team.cell_m: got 0.1, expected 0.05 (policy learned was trained so)"),
        ({"robots": 1}, "team.pickets: got 0, expected at least 1 (policy learned needs them)"),
    ],
)
def test_other_teams_and_rates_are_refused_in_one_line(tmp_path, other, message):
    path = tmp_path / "policy.onnx"
    path.write_bytes(model())
    policy = load(path)
    with pytest.raises(ConfigError) as caught:
        policy.reset(team(**other), seed=0)
    assert str(caught.value) == message


def test_shipped_policies_are_found_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(shipping, "TRAINED", tmp_path / "none")
    assert shipped_names() == []
    monkeypatch.setattr(shipping, "TRAINED", tmp_path)
    for name in ("scout", "digger"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "policy.onnx").write_bytes(model())
    (tmp_path / "empty").mkdir()
    assert shipped_names() == ["digger", "scout"]
    assert isinstance(shipped("scout"), Policy)
    with pytest.raises(ConfigError, match=r"^policy: got 'scot', .*digger, scout; did you mean 'scout'\?$"):
        shipped("scot")


def test_every_shipped_policy_loads():
    for name in shipped_names():
        assert Path(name).name == name
        assert isinstance(shipped(name), Policy)

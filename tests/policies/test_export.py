"""From a network to a file that answers the same, or to no file."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest
import torch

from coop_envs.errors import ConfigError, CoopError
from policies import export as exporting
from policies.distribution import TeamActionDistribution
from policies.export import export
from policies.networks import NetworkSettings
from policies.onnx_policy import OnnxPolicy
from tests.policies.builders import description, model, network, rows, tensors

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("kind", ["attention", "mlp"])
@pytest.mark.parametrize("count", [1, 3, 13])
@pytest.mark.parametrize("alone", [False, True])
def test_the_file_answers_as_the_network(kind, count, alone):
    observed = rows(count, seed=count)
    if alone:
        observed["mask"][:] = 0
    with torch.no_grad():
        heads = network(kind)(tensors(observed))
        distribution = TeamActionDistribution(heads)
    action, hold, mean, std = OnnxPolicy(model(kind), "file").answers(observed)
    np.testing.assert_allclose(mean, heads.mean, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(hold, distribution.hold_probability, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(std, heads.log_std.exp(), rtol=1e-5)
    np.testing.assert_allclose(action, distribution.mode(), rtol=1e-5, atol=1e-5)
    assert action.shape == (count, 8) and np.abs(action).max() <= 1.0
    assert set(np.unique(action[:, 0])) <= {-1.0, 1.0}


@pytest.mark.parametrize("kind", ["attention", "mlp"])
def test_the_file_says_nothing_of_the_place_it_was_made_in(kind):
    for text in (str(ROOT), "site-packages", ".py", "File "):
        assert text.encode() not in model(kind)


def test_equal_networks_make_equal_files_and_stay_as_they_were(tmp_path):
    made = network("mlp").train()
    path = tmp_path / "folder" / "policy.onnx"
    export(made, description(made.settings), path)
    assert path.read_bytes() == model("mlp")
    assert [p.name for p in path.parent.iterdir()] == ["policy.onnx"]
    assert made.training
    assert all(p.requires_grad for p in made.parameters())


def keeps_the_old_file(tmp_path: Path, **changes: object) -> str:
    """Export over an old file, which must fail and leave it; the message."""
    path = tmp_path / "policy.onnx"
    path.write_bytes(b"old")
    made = network("mlp", **changes)  # type: ignore[arg-type]
    with pytest.raises(CoopError) as caught:
        export(made, description(NetworkSettings(kind="mlp")), path)
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["policy.onnx"]
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_full_disk_leaves_the_old_file(tmp_path, monkeypatch):
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    right = model("mlp")
    monkeypatch.setattr(exporting, "_model", lambda *_: right)
    monkeypatch.setattr(os, "fsync", full)
    message = keeps_the_old_file(tmp_path)
    assert message == f"{tmp_path}/policy.onnx: got No space left on device, expected a place to write the file to"


def test_a_file_that_answers_otherwise_is_not_kept(tmp_path, monkeypatch):
    other = model("mlp")  # of a network with another seed than below
    monkeypatch.setattr(exporting, "_model", lambda *_: other)
    message = keeps_the_old_file(tmp_path, seed=5)
    assert "differ from the network's by" in message


def test_the_description_must_be_of_the_network(tmp_path):
    assert keeps_the_old_file(tmp_path, width=32).startswith("description.network: got NetworkSettings(kind='mlp'")


def test_weights_that_are_not_finite_are_refused(tmp_path):
    made = network("mlp")
    with torch.no_grad():
        made.action_head.bias[3] = torch.nan
    with pytest.raises(ConfigError, match=r"^network\.action_head\.bias: got 'numbers that are not finite'"):
        export(made, description(made.settings), tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())

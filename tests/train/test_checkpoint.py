"""Checkpoints come back as they were written, hold no code, and are there whole or not at all."""

from __future__ import annotations

import errno
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from coop_envs.errors import ConfigError
from train import checkpoint as module
from train.checkpoint import (
    Checkpoint,
    check_same,
    checkpoints,
    newest_checkpoint,
    read_checkpoint,
    write_checkpoint,
)
from train.training_error import TrainingError

TREE = {
    "teams": {"map": np.arange(6, dtype=np.int8).reshape(2, 3), "keys": np.array([2**64 - 1], dtype=np.uint64)},
    "empty": np.zeros((0, 4), dtype=np.float32),
    "flags": [np.array([True, False]), None, 3, 0.1, "text"],
    "scalar": np.array(1e-300),
}


def sample(k: int = 0) -> Checkpoint:
    return Checkpoint({"version": "1", "k": k}, TREE, {"weights": {"w": torch.arange(3.0)}, "step": 7})


def quiet(_: str) -> None:
    """Hear nothing."""


def test_it_comes_back_bit_for_bit(tmp_path):
    read = read_checkpoint(write_checkpoint(tmp_path, 5, sample()))
    assert read.about["version"] == "1"
    assert read.state["flags"][1:] == [None, 3, 0.1, "text"]
    pairs = [(read.state["teams"][name], array) for name, array in TREE["teams"].items()]
    pairs += [(read.state[name], TREE[name]) for name in ("empty", "scalar")] + [
        (read.state["flags"][0], [True, False])
    ]
    for got, expected in pairs:
        np.testing.assert_array_equal(got, expected)
        assert got.dtype == np.asarray(expected).dtype
    assert torch.equal(read.learner["weights"]["w"], torch.arange(3.0))


def test_the_last_two_are_kept_and_the_newest_is_read(tmp_path):
    for k in (9, 10, 200):
        write_checkpoint(tmp_path, k, sample(k))
    assert [path.name for path in checkpoints(tmp_path)] == [
        "checkpoint_000000000010.zip",
        "checkpoint_000000000200.zip",
    ]
    assert newest_checkpoint(tmp_path, quiet)[1].about["k"] == 200


@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_a_part_of_a_file_falls_back(share, tmp_path):
    write_checkpoint(tmp_path, 1, sample(1))
    newest = write_checkpoint(tmp_path, 2, sample(2))
    data = newest.read_bytes()
    newest.write_bytes(data[: int(share * len(data))])
    told: list[str] = []
    assert newest_checkpoint(tmp_path, told.append)[1].about["k"] == 1
    assert len(told) == 1
    assert newest.name in told[0]
    assert not newest.exists()
    assert newest.with_suffix(".damaged").exists()


def test_any_flipped_byte_is_noticed_or_harmless(tmp_path):
    path = write_checkpoint(tmp_path, 1, sample())
    data = path.read_bytes()
    for place in np.linspace(0, len(data) - 1, 60).astype(int).tolist():
        path.write_bytes(data[:place] + bytes([data[place] ^ 0x55]) + data[place + 1 :])
        try:
            _, read = newest_checkpoint(tmp_path, quiet)
        except ConfigError:
            continue
        np.testing.assert_array_equal(read.state["teams"]["map"], TREE["teams"]["map"])
        assert torch.equal(read.learner["weights"]["w"], torch.arange(3.0))


def test_none_that_can_be_read_is_an_error(tmp_path):
    (tmp_path / "checkpoint_000000000001.zip").write_bytes(b"nothing")
    with pytest.raises(ConfigError, match="resume"):
        newest_checkpoint(tmp_path, quiet)


def test_code_in_a_checkpoint_is_not_run(tmp_path):
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, (str(tmp_path / "ran"),)

    path = write_checkpoint(tmp_path / "kept", 1, Checkpoint({}, {}, {"weights": Trap()}))
    with pytest.raises(ConfigError):
        newest_checkpoint(path.parent, quiet)
    assert not (tmp_path / "ran").exists()


def test_a_full_disk_leaves_what_was_there(tmp_path, monkeypatch):
    good = write_checkpoint(tmp_path, 1, sample(1))

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
    with pytest.raises(TrainingError, match=r"No space left on device.*the last good checkpoint is .*000001\.zip"):
        write_checkpoint(tmp_path, 2, sample(2), good)
    with pytest.raises(TrainingError, match="there is no checkpoint"):  # none of this run's
        write_checkpoint(tmp_path, 2, sample(2))
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == [good]
    assert read_checkpoint(good).about["k"] == 1


def test_a_crash_while_writing_leaves_no_checkpoint(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "replace", lambda *_: pytest.fail("renamed"))
    monkeypatch.setattr(module, "_write", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        write_checkpoint(tmp_path, 2, sample())
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_file_takes_no_place_of_those_kept(tmp_path):
    for k in (1, 2, 30):
        path = write_checkpoint(tmp_path, k, sample(k))
    path.write_bytes(b"nothing")
    read, found = newest_checkpoint(tmp_path, quiet)
    assert found.path == read
    for k in (3, 4):
        write_checkpoint(tmp_path, k, sample(k))
    assert [path.name for path in checkpoints(tmp_path)] == [module.NAME.format(k) for k in (3, 4)]


def test_tensors_of_a_device_are_read_to_the_cpu(tmp_path, monkeypatch):
    load, places = torch.load, []
    monkeypatch.setattr(torch, "load", lambda *a, **k: places.append(k["map_location"]) or load(*a, **k))
    read_checkpoint(write_checkpoint(tmp_path, 1, sample()))
    assert places == ["cpu"]


def test_the_first_difference_is_named():
    with pytest.raises(ConfigError, match=r"team\.members\.1\.name: got 'b', expected 'a'"):
        check_same(
            {"team": {"members": [{"name": "o"}, {"name": "a"}]}}, {"team": {"members": [{"name": "o"}, {"name": "b"}]}}
        )

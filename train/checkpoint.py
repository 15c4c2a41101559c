"""Checkpoints: everything a training's future depends on, in one file that is there whole or not at all.

A checkpoint is a zip of ``about.json`` (whose it is), ``state.json`` (a tree whose arrays are named by number),
``arrays/K.npy`` and ``learner.pt`` (tensors, read by ``torch.load(weights_only=True)``). Nothing in it is code.
"""

from __future__ import annotations

import io
import json
import os
import re
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from coop_envs.errors import ConfigError
from train.training_error import TrainingError

FORMAT = 1
KEPT = 2
NAME = "checkpoint_{:012d}.zip"
PATTERN = re.compile(r"checkpoint_(\d{12})\.zip")
COMPRESSION_LEVEL = 1  # maps are mostly empty


@dataclass(frozen=True)
class Checkpoint:
    """``about`` and ``state`` are plain trees; ``state`` may hold arrays. ``learner`` holds tensors in dicts.

    ``path`` is the file it was read from.
    """

    about: dict[str, Any]
    state: dict[str, Any]
    learner: dict[str, Any]
    path: Path | None = None


def write_checkpoint(folder: Path, steps: int, checkpoint: Checkpoint, good: Path | None = None) -> Path:
    """Write the checkpoint of so many steps, then let go of all but the newest `KEPT`.

    ``good`` is the checkpoint to name if that fails. Whatever interrupts the writing, no unfinished file stays.

    Raises:
        TrainingError: it cannot be written; those before are untouched.
    """
    path = folder / NAME.format(steps)
    part = path.with_suffix(".part")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with part.open("wb") as file:
            _write(file, checkpoint)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        _sync(folder)
    except OSError as error:
        raise TrainingError(cannot_write(path, error, good)) from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    for old in checkpoints(folder)[:-KEPT]:
        old.unlink(missing_ok=True)
    return path


def cannot_write(path: Path, error: OSError, good: Path | None) -> str:
    """What failed, why, and from which checkpoint training can go on."""
    return f"{path}: got '{error.strerror or error}', expected to write it; {last_good(good)}"


def last_good(good: Path | None) -> str:
    """The checkpoint that this run read or wrote last, in words."""
    return f"the last good checkpoint is {good}" if good else "there is no checkpoint"


def checkpoints(folder: Path) -> list[Path]:
    """The folder's checkpoints, oldest first."""
    return sorted(path for path in folder.glob("checkpoint_*.zip") if PATTERN.fullmatch(path.name))


def newest_checkpoint(folder: Path, warn: Any) -> tuple[Path, Checkpoint]:
    """The newest checkpoint that can be read; ``warn`` is told, in a line each, of those that cannot.

    Those passed over are renamed to ``.damaged``, so that they do not count among the `KEPT`.

    Raises:
        ConfigError: there is none, or it is of another format.
    """
    damaged: list[Path] = []
    for path in reversed(checkpoints(folder)):
        try:
            checkpoint = read_checkpoint(path)
        except ConfigError:
            raise
        except Exception as error:  # noqa: BLE001  a damaged file makes its readers raise anything
            why = (str(error).splitlines() or [type(error).__name__])[0][:80]
            warn(f"{path.name} is damaged ({why}): passing over it to the one before")
            damaged.append(path)
            continue
        for other in damaged:
            with suppress(OSError):  # a folder that cannot be written is told of by who writes there
                other.rename(other.with_suffix(".damaged"))
        return path, checkpoint
    raise ConfigError("resume", str(folder), "a folder with a checkpoint that can be read")


def read_checkpoint(path: Path) -> Checkpoint:
    """The checkpoint in a file.

    Raises:
        ConfigError: it is of another format.
    """
    with zipfile.ZipFile(path) as archive:
        about = json.loads(archive.read("about.json"))
        if about["format"] != FORMAT:
            raise ConfigError(f"{path.name}.format", about["format"], f"{FORMAT}, which this version reads")
        arrays = [name for name in archive.namelist() if name.startswith("arrays/")]
        found = {name: np.lib.format.read_array(io.BytesIO(archive.read(name)), allow_pickle=False) for name in arrays}
        state = _unpacked(json.loads(archive.read("state.json")), found)
        learner = torch.load(io.BytesIO(archive.read("learner.pt")), map_location="cpu", weights_only=True)
    return Checkpoint(about, state, learner, path)


def check_same(about: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Refuse a checkpoint whose ``about`` differs from what is to be trained.

    Raises:
        ConfigError: naming the first entry that differs.
    """
    for name, wanted in expected.items():
        if about.get(name) != wanted:
            field, kept, asked = _difference(name, about.get(name), wanted)
            raise ConfigError(field, asked, f"{kept!r}, as in the checkpoint to go on from")


def _difference(field: str, got: Any, wanted: Any) -> tuple[str, Any, Any]:
    """The first place inside of two trees where they differ."""
    if isinstance(got, Mapping) and isinstance(wanted, Mapping):
        for key in [*wanted, *got]:
            if got.get(key) != wanted.get(key):
                return _difference(f"{field}.{key}", got.get(key), wanted.get(key))
    if isinstance(got, list) and isinstance(wanted, list) and len(got) == len(wanted):
        for k, (one, other) in enumerate(zip(got, wanted, strict=True)):
            if one != other:
                return _difference(f"{field}.{k}", one, other)
    return field, got, wanted


def _write(file: Any, checkpoint: Checkpoint) -> None:
    arrays: list[np.ndarray[Any, Any]] = []
    state = _packed(checkpoint.state, arrays)
    learner = io.BytesIO()
    torch.save(checkpoint.learner, learner)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=COMPRESSION_LEVEL) as archive:
        archive.writestr("about.json", json.dumps({"format": FORMAT, **checkpoint.about}))
        archive.writestr("state.json", json.dumps(state))
        archive.writestr("learner.pt", learner.getvalue())
        for k, array in enumerate(arrays):
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, array, allow_pickle=False)
            archive.writestr(f"arrays/{k}.npy", buffer.getbuffer())


def _packed(value: Any, arrays: list[np.ndarray[Any, Any]]) -> Any:
    """The tree in JSON's types, its arrays moved to the list."""
    if isinstance(value, Mapping):
        return {str(key): _packed(item, arrays) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_packed(item, arrays) for item in value]
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    return value.item() if isinstance(value, np.generic) else value


def _unpacked(value: Any, arrays: Mapping[str, Any]) -> Any:
    if isinstance(value, dict):
        if set(value) == {"array"}:
            return arrays[f"arrays/{value['array']}.npy"]
        return {key: _unpacked(item, arrays) for key, item in value.items()}
    return [_unpacked(item, arrays) for item in value] if isinstance(value, list) else value


def _sync(folder: Path) -> None:
    """Make the new name last."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

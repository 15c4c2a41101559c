"""Learned policies from their files."""

from __future__ import annotations

import os
from pathlib import Path

from coop_envs.errors import ConfigError, require
from policies.onnx_policy import OnnxPolicy

FILE_NAME = "policy.onnx"


def load(path: str | os.PathLike[str]) -> OnnxPolicy:
    """The policy in a file, or in the ``policy.onnx`` of a folder.

    Raises:
        ConfigError: there is no such file, it is no policy's, or one that this version cannot run.
        CoopError: onnxruntime is missing.
    """
    place = Path(path)
    file = place / FILE_NAME if place.is_dir() else place
    require(file.is_file(), "policy", str(path), f"an existing .onnx file, or a folder with {FILE_NAME}")
    try:
        model = file.read_bytes()
    except OSError as error:
        raise ConfigError("policy", str(file), f"a file that can be read ({error.strerror})") from None
    return OnnxPolicy(model, str(file))

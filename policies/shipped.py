"""Policies that come with the package, each in ``trained/NAME/policy.onnx``."""

from __future__ import annotations

from importlib.resources import files

from coop_envs.validation import known
from policies.loading import FILE_NAME
from policies.onnx_policy import OnnxPolicy

TRAINED = files("policies") / "trained"


def shipped_names() -> list[str]:
    """The names of all policies that come with the package."""
    if not TRAINED.is_dir():
        return []
    return sorted(folder.name for folder in TRAINED.iterdir() if (folder / FILE_NAME).is_file())


def shipped(name: str) -> OnnxPolicy:
    """The policy of this name.

    Raises:
        ConfigError: there is none.
        CoopError: onnxruntime is missing.
    """
    file = TRAINED / known(name, shipped_names(), "policy", "a shipped policy") / FILE_NAME
    return OnnxPolicy(file.read_bytes(), f"{name}/{FILE_NAME}")


def learned_scouts() -> OnnxPolicy:
    """One Zumy and its VelociRoACHs, trained in random arenas."""
    return shipped("learned_scouts")


def learned_surveyors() -> OnnxPolicy:
    """Three surveyors that scan, trained in rubble."""
    return shipped("learned_surveyors")

"""What a policy is, what it needs of a team, and how it is found by name or path."""

from __future__ import annotations

import difflib
import importlib.util
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.team import Member
from coop_envs.errors import ConfigError

ENTRY_POINT_GROUP = "coop_envs.policies"
FILE_ENTRY_POINT_GROUP = "coop_envs.policy_files"
TRAINED = "onnx"
"""What is looked for in the folder of a training run."""

Observations = dict[str, dict[str, NDArray[Any]]]
Actions = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class TeamNeeds:
    """The least a policy can work with: how many robots carry a camera, a hat, a laser, and how many are pickets."""

    cameras: int = 1
    hats: int = 0
    lasers: int = 0
    pickets: int = 0


@dataclass(frozen=True)
class TeamDescription:
    """What the team's operator knows beforehand, never truth.

    ``names`` are the agents, ``members[i]`` the robot of agent ``names[i]``; ``cell_m`` is the side of one cell of the
    observed map window; ``goal_known`` says whether the task names a goal, ``collects_lost`` whether somebody takes
    lost robots out of the way.
    """

    names: tuple[str, ...]
    members: tuple[Member, ...]
    cell_m: float
    decision_s: float
    goal_known: bool
    time_limit_s: float
    collects_lost: bool = False


@runtime_checkable
class Policy(Protocol):
    """A central policy: it sees the observations of all live agents and answers with one action for each."""

    name: str
    needs: TeamNeeds

    def reset(self, team: TeamDescription, seed: int) -> None:
        """Start an episode with this team; equal seeds give equal actions."""
        ...

    def act(self, observations: Observations) -> Actions:
        """Answer each live agent's observation dict with a float32 action (8,) in [-1, 1]."""
        ...


def check_needs(policy: Policy, team: TeamDescription) -> None:
    """Refuse a team that lacks what the policy needs.

    Raises:
        ConfigError: naming the policy, the first kind of equipment that falls short, and both numbers.
    """
    has = {
        "cameras": sum(m.camera is not None for m in team.members),
        "hats": sum(m.hat is not None for m in team.members),
        "lasers": sum(m.laser is not None for m in team.members),
        "pickets": sum(m.role == "picket" for m in team.members),
    }
    for kind, number in has.items():
        needed = getattr(policy.needs, kind)
        if number < needed:
            raise ConfigError(f"team.{kind}", number, f"at least {needed} (policy {policy.name} needs them)")


def load_policy(name_or_path: str) -> Policy:
    """Make a policy by its name, from a trained policy's file or folder, or from a Python file.

    Names are entry points of the group ``coop_envs.policies``; only the one asked for is imported. A Python file
    defines ``make_policy() -> Policy``. Other files are read by the entry point of the group
    ``coop_envs.policy_files`` that is named like their suffix; a folder is that of a training run.

    Raises:
        ConfigError: if there is no such name or file, or the file makes no policy.
    """
    path = Path(name_or_path)
    if path.suffix == ".py":
        return _load_module(path)
    points = {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
    if name_or_path in points:
        return _checked(points[name_or_path].load()(), name_or_path)
    kind = TRAINED if path.is_dir() else path.suffix.removeprefix(".")
    readers = {point.name: point for point in entry_points(group=FILE_ENTRY_POINT_GROUP)}
    if path.exists() and kind in readers:
        return _checked(readers[kind].load()(path), name_or_path)
    raise ConfigError("policy", name_or_path, _expected_names(name_or_path, points))


def _expected_names(name: str, points: dict[str, EntryPoint]) -> str:
    close = difflib.get_close_matches(name, points, n=1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    return f"one of {', '.join(sorted(points))} or the path of a .onnx or .py file or of a training run{hint}"


def _load_module(path: Path) -> Policy:
    if not path.is_file():
        raise ConfigError("policy", str(path), "an existing .py file")
    spec = importlib.util.spec_from_file_location(f"policy_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not callable(getattr(module, "make_policy", None)):
        raise ConfigError("policy", str(path), "a file that defines make_policy()")
    return _checked(module.make_policy(), str(path))


def _checked(policy: object, source: str) -> Policy:
    if not isinstance(policy, Policy):
        raise ConfigError("policy", source, f"something with name, needs, reset and act, not {type(policy).__name__}")
    return policy

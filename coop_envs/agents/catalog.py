"""The robots, hats, cameras and teams that come with the package, by name; each is one YAML file."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from coop_envs.agents.camera_info import from_file
from coop_envs.agents.colours import with_distinct_hats
from coop_envs.agents.specification import Camera, Hat, RobotSpecification
from coop_envs.agents.team import Team
from coop_envs.errors import ConfigError, require
from coop_envs.validation import known, read_yaml, validated

Reference = str | Mapping[str, Any]


def load_robot(reference: Reference) -> RobotSpecification:
    """A robot by name, or by a mapping whose ``base`` is a name and whose other entries replace that robot's."""
    return validated(RobotSpecification, _resolved("robots", reference, "robot"), "robot")


def load_hat(reference: Reference) -> Hat:
    """A hat by name, or by a mapping as in `load_robot`."""
    return validated(Hat, _resolved("hats", reference, "hat"), "hat")


def load_camera(reference: Reference) -> Camera:
    """A camera by name, or by a mapping as in `load_robot`; ``file`` takes lens and image size from a calibration."""
    return validated(Camera, _resolved("cameras", reference, "camera"), "camera")


def load_team(reference: Reference | Path | Team) -> Team:
    """A team by preset name, YAML file or mapping.

    Each entry of ``members`` names ``robot``, ``cameras`` and ``hat``; ``count`` repeats it; names follow from roles.
    Robots with the same hat wear its colours in different places, so that cameras can tell them apart.
    """
    if isinstance(reference, Team):
        return reference
    return validated(Team, team_tree(reference), "team")


def team_tree(reference: Any) -> dict[str, Any]:
    """A team as a plain mapping with every name resolved, ready to be overridden (and resolved again) and validated."""
    tree = _team_source(reference)
    members: Any = tree.get("members")
    require(isinstance(members, list | tuple) and bool(members), "team.members", members, "a list of robots")
    expanded = [member for i, entry in enumerate(members) for member in _members(entry, f"team.members.{i}")]
    for i, member in enumerate(expanded):
        role = member.get("role")
        rank = sum(other.get("role") == role for other in expanded[:i])
        member.setdefault("name", f"{role}_{rank}")
    return {**tree, "members": with_distinct_hats(expanded)}


def names(shelf: str) -> list[str]:
    """What a shelf (robots, hats, cameras, teams) holds."""
    folder = resources.files("coop_envs.agents") / shelf
    return sorted(Path(entry.name).stem for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def _team_source(reference: Any) -> dict[str, Any]:
    if isinstance(reference, Mapping):
        if "base" in reference:
            return _resolved("teams", reference, "team")
        return {"name": "team", **reference}
    if not isinstance(reference, str | Path):
        raise ConfigError("team", reference, f"a mapping, a YAML file or one of the teams: {', '.join(names('teams'))}")
    path = Path(reference)
    if path.suffix in (".yaml", ".yml"):
        require(path.is_file(), "team", str(reference), "a file that exists")
        return {"name": path.stem, **read_yaml(path.read_text(), str(path))}
    return _resolved("teams", str(reference), "team")


def _members(entry: Any, field: str) -> list[dict[str, Any]]:
    require(isinstance(entry, Mapping), field, entry, "a mapping with role, robot, cameras, hat, ...")
    member = dict(entry)
    count = member.pop("count", 1)
    require(isinstance(count, int) and 1 <= count <= 64, f"{field}.count", count, "a whole number, 1 to 64")
    if "robot" in member:
        member["robot"] = _resolved("robots", member["robot"], f"{field}.robot")
    if member.get("hat") is not None:
        member["hat"] = _resolved("hats", member["hat"], f"{field}.hat")
    cameras = member.get("cameras", [])
    require(isinstance(cameras, list | tuple), f"{field}.cameras", cameras, "a list of cameras")
    member["cameras"] = [_resolved("cameras", camera, f"{field}.cameras") for camera in cameras]
    return [dict(member) for _ in range(count)]


def _resolved(shelf: str, reference: Any, field: str) -> dict[str, Any]:
    """The mapping behind a name, or behind a mapping that may name a ``base``."""
    if isinstance(reference, str):
        entry = _shelf_entry(shelf, known(reference, names(shelf), field, f"one of the {shelf}"))
        return _resolved(shelf, entry, field)
    if not isinstance(reference, Mapping):
        raise ConfigError(field, reference, f"one of the {shelf} ({', '.join(names(shelf))}) or a mapping")
    changes = from_file(reference) if "file" in reference and shelf == "cameras" else dict(reference)
    base = changes.pop("base", None)
    return {**_resolved(shelf, base, f"{field}.base"), **changes} if base is not None else changes


@functools.cache
def _shelf_entry(shelf: str, name: str) -> dict[str, Any]:
    file = resources.files("coop_envs.agents") / shelf / f"{name}.yaml"
    return read_yaml(file.read_text(), f"{shelf}/{name}.yaml")

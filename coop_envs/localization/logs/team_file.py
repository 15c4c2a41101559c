"""Who is in a log: its ``team.yaml``, a team as elsewhere with what only a log needs to say besides.

Entries besides those of a team (``base`` or ``members``):

- ``names``: what the log calls a member, where that is not its name.
- ``starts``: x (m), y (m), yaw (rad) of robots as people set them down, in the team frame, by the log's names.
- ``robots``: instead of a team, the names of robots without known bodies and cameras, as in planar logs.
- ``topics``: where a ROS bag carries what, see `bag_topics`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from coop_envs.agents.catalog import load_team
from coop_envs.agents.team import Team
from coop_envs.errors import ConfigError, require
from coop_envs.validation import STRICT, known, read_yaml, validated

Start = tuple[float, float, float]
TeamReference = str | Path | Mapping[str, Any] | Team


@dataclass(frozen=True)
class _Entries:
    """What a log's team file says besides the team."""

    __pydantic_config__ = STRICT
    robots: tuple[str, ...] = ()
    names: dict[str, str] = field(default_factory=dict)
    starts: dict[str, Start] = field(default_factory=dict)
    topics: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class LogTeam:
    """``robots[i]`` is what the log calls member i of ``team``; without a team, robots as the file lists them."""

    team: Team | None = None
    robots: tuple[str, ...] = ()
    starts: Mapping[str, Start] = field(default_factory=dict)
    topics: Mapping[str, Any] = field(default_factory=dict)


def read_team(reference: TeamReference) -> LogTeam:
    """A log's team: the name of a team, a YAML file, its entries, or a `Team`.

    Raises:
        ConfigError: an entry that is unknown or makes no sense.
    """
    if isinstance(reference, Team):
        return _with_team(reference, _Entries())
    if isinstance(reference, Mapping):
        return _from_entries(dict(reference), "team")
    path = Path(reference)
    if path.suffix not in (".yaml", ".yml"):
        return _with_team(load_team(str(reference)), _Entries())
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ConfigError("team", str(path), f"a YAML file that can be read ({_reason(error)})") from None
    return read_team_text(text, str(path))


def read_team_text(text: str, source: str) -> LogTeam:
    """A log's team from YAML text; ``source`` names it in errors.

    Raises:
        ConfigError: as `read_team`.
    """
    return _from_entries(read_yaml(text, source), Path(source).stem)


def team_text(team: Team | None, robots: tuple[str, ...], starts: Mapping[str, Start]) -> str:
    """YAML text from which `read_team_text` gives the same."""
    entries: dict[str, Any] = {"starts": {name: list(start) for name, start in starts.items()}}
    if team is None:
        entries["robots"] = list(robots)
    else:
        entries |= _plain(dataclasses.asdict(team))
        entries["names"] = {m.name: name for m, name in zip(team.members, robots, strict=True) if m.name != name}
    return yaml.safe_dump({name: value for name, value in entries.items() if value}, sort_keys=False)


def _from_entries(entries: dict[str, Any], name: str) -> LogTeam:
    fields = [field.name for field in dataclasses.fields(_Entries)]
    for key in entries:
        known(key, ("base", "name", "members", *fields), f"team.{key}", "one of")
    own = {key: entries.pop(key) for key in fields if key in entries}
    extra = validated(_Entries, own, "team")
    if "base" in entries or "members" in entries:
        return _with_team(load_team(entries if "base" in entries else {"name": name, **entries}), extra)
    require(bool(extra.robots), "team", None, "a team (base or members), or robots")
    require(not entries, "team.name", entries.get("name"), "none without a team")
    require(not extra.names, "team.names", extra.names, "none without a team: robots are named in 'robots'")
    return _complete(None, extra.robots, extra)


def _with_team(team: Team, extra: _Entries) -> LogTeam:
    require(not extra.robots, "team.robots", extra.robots, "none beside a team")
    members = [member.name for member in team.members]
    for name in extra.names:
        known(name, members, "team.names", "a member")
    return _complete(team, tuple(extra.names.get(name, name) for name in members), extra)


def _complete(team: Team | None, robots: tuple[str, ...], extra: _Entries) -> LogTeam:
    require(len(set(robots)) == len(robots), "team.names", robots, "each name once")
    require(all(name and name.isprintable() for name in robots), "team.names", robots, "names")
    for name in extra.starts:
        known(name, robots, "team.starts", "a robot of the log")
    return LogTeam(team, robots, extra.starts or _placed(team, robots), extra.topics)


def _placed(team: Team | None, robots: tuple[str, ...]) -> dict[str, Start]:
    """Where the members' own ``start`` puts them, seen from the first observer's."""
    members = () if team is None else team.members
    origin = members[0].start if members else None
    if origin is None:
        return {}
    c, s = np.cos(origin[2]), np.sin(origin[2])
    starts: dict[str, Start] = {}
    for member, name in zip(members, robots, strict=True):
        if member.start is not None:
            x, y, yaw = (a - b for a, b in zip(member.start, origin, strict=True))
            starts[name] = (float(c * x + s * y), float(c * y - s * x), yaw)
    return starts


def _plain(value: Any) -> Any:
    """Lists in place of tuples, nothing in place of None, for YAML."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _reason(error: Exception) -> str:
    return error.strerror or "cannot be read" if isinstance(error, OSError) else "not UTF-8"

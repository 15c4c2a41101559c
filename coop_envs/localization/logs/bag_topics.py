"""Which topics of a ROS bag carry what: the ``topics`` entry of a log's team file.

Each kind of row has a topic, or a list of them, in which ``{robot}`` and ``{camera}`` stand for names without a slash:

    topics:
      imu: "/{robot}/imu"
      odometry: ["/{robot}/odom", {topic: /wheels, robot: zumy1}]
      poses: {topic: "/{camera}/poses/{robot}", sigma_rotation_rad: 0.02, sigma_position_m: 0.005}

What is not named keeps its default (`DEFAULT`); an empty list reads nothing. The sigmas serve messages without a
covariance, or with one of zeros.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from coop_envs.errors import ConfigError, require
from coop_envs.localization.logs.columns import FIXES, IMU, ODOMETRY, POSES, TRUTH
from coop_envs.validation import STRICT, known, validated

DEFAULT: dict[str, str] = {
    IMU.name: "/{robot}/imu",
    ODOMETRY.name: "/{robot}/odom",
    POSES.name: "/{camera}/poses/{robot}",
    FIXES.name: "/{robot}/fix",
    TRUTH.name: "/{robot}/truth",
}


@dataclass(frozen=True)
class _Entry:
    __pydantic_config__ = STRICT
    topic: str
    robot: str | None = None
    camera: str | None = None
    sigma_rotation_rad: float | None = None
    sigma_position_m: float | None = None

    def __post_init__(self) -> None:
        for name in ("sigma_rotation_rad", "sigma_position_m"):
            value = getattr(self, name)
            require(value is None or value > 0, f"topics.{name}", value, "more than 0")


@dataclass(frozen=True)
class Source:
    """What one topic carries: rows of a kind, of these robots; sigmas where its messages have no covariance."""

    kind: str
    names: Mapping[str, str]
    sigma_rotation_rad: float | None
    sigma_position_m: float | None


class Topics:
    """What each topic of a bag carries.

    Raises:
        ConfigError: an entry that is unknown, or a topic from which nobody can tell whose it is.
    """

    def __init__(self, given: Mapping[str, Any]) -> None:
        for name in given:
            known(name, DEFAULT, "topics", "a kind of row")
        self._entries = [(kind, entry, _pattern(kind, entry)) for kind in DEFAULT for entry in _entries(kind, given)]

    def source(self, topic: str) -> Source | None:
        """What a topic carries, None if nothing that is read."""
        for kind, entry, pattern in self._entries:
            match = pattern.fullmatch(topic)
            if match:
                names = {"robot": entry.robot, "camera": entry.camera} | match.groupdict()
                told = {role: name for role, name in names.items() if name is not None and role in _roles(kind)}
                return Source(kind, told, entry.sigma_rotation_rad, entry.sigma_position_m)
        return None


def _entries(kind: str, given: Mapping[str, Any]) -> list[_Entry]:
    value = given.get(kind, DEFAULT[kind])
    found = value if isinstance(value, list | tuple) else [value]
    return [validated(_Entry, {"topic": item} if isinstance(item, str) else item, f"topics.{kind}") for item in found]


def _pattern(kind: str, entry: _Entry) -> re.Pattern[str]:
    text = re.escape(entry.topic)
    for role in ("robot", "camera"):
        first, *others = text.split(re.escape(f"{{{role}}}"))
        again = f"(?P={role})".join(others)
        text = f"{first}(?P<{role}>[^/]+){again}" if others else first
        told = bool(others) or getattr(entry, role) is not None
        if told != (role in _roles(kind)):
            expected = f"a topic with {{{role}}}, or an entry {role}" if role in _roles(kind) else f"none for a {role}"
            raise ConfigError(f"topics.{kind}", entry.topic, expected)
    return re.compile(text)


def _roles(kind: str) -> tuple[str, ...]:
    return ("camera", "robot") if kind == POSES.name else ("robot",)

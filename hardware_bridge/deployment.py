"""`Deployment`: what a team file says: which robots, how to reach them, where they start, what holds them back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from coop_envs.agents.catalog import load_team
from coop_envs.agents.team import Team
from coop_envs.belief_loop import BeliefSettings
from coop_envs.errors import ConfigError, require
from coop_envs.estimation.estimator import Plan
from coop_envs.estimation.settings import Estimation, MapSettings, Rates
from coop_envs.policy import TeamDescription
from coop_envs.validation import STRICT, known, read_yaml, validated
from hardware_bridge.addresses import check_addresses
from hardware_bridge.cameras.opencv_camera import OpencvCameraSettings
from hardware_bridge.cameras.ros1_camera import Ros1CameraSettings
from hardware_bridge.cameras.simulator_camera import SimulatorCameraSettings
from hardware_bridge.links.simulator_udp import SimulatorUdpSettings
from hardware_bridge.links.velociroach_xbee import VelociroachSettings
from hardware_bridge.links.zumy_ros1 import ZumyRos1Settings
from hardware_bridge.links.zumy_serial import ZumySerialSettings
from hardware_bridge.safety.limits import SafetyLimits
from hardware_bridge.safety.polygon import depth
from hardware_bridge.seeing import Seeing

LinkSettings = SimulatorUdpSettings | VelociroachSettings | ZumyRos1Settings | ZumySerialSettings
CameraSettings = OpencvCameraSettings | Ros1CameraSettings | SimulatorCameraSettings
Pose = tuple[float, float, float]
APART_M = 0.05
"""No two robots can be set down nearer to each other."""


@dataclass(frozen=True)
class Wiring:
    """How one robot of the team is reached, and its camera if it carries one."""

    __pydantic_config__ = STRICT
    link: Annotated[LinkSettings, Field(discriminator="kind")]
    camera: Annotated[CameraSettings, Field(discriminator="kind")] | None = None


@dataclass(frozen=True)
class Site:
    """Where people set the robots down, in the team frame: the first observer's start, x ahead, y to the left.

    ``start`` is (x m, y m, yaw rad) of every robot in the team's order, reserves at the dock; the map covers
    ``map_size_m`` from ``map_corner_m`` on. ``goal`` is (x, y, radius) in metres.
    """

    __pydantic_config__ = STRICT
    start: tuple[Pose, ...]
    map_corner_m: tuple[float, float] = (-2.0, -4.0)
    map_size_m: tuple[float, float] = (8.0, 8.0)
    dock: Pose | None = None
    goal: Pose | None = None

    def __post_init__(self) -> None:
        for size in self.map_size_m:
            require(0.5 <= size <= 100, "site.map_size_m", self.map_size_m, "0.5 to 100 m along each side")


@dataclass(frozen=True)
class Emulation:
    """Emulated robots instead of real ones: a scenario's world, and how real the firmware's weaknesses are.

    ``lockstep``: time passes as fast as the machine can, and only while the mission asks. ``quirks`` are those of
    `hardware_bridge.emulators.quirks`, by agent name or for ``all``.
    """

    __pydantic_config__ = STRICT
    scenario: str = "rubble"
    overrides: dict[str, Any] = field(default_factory=dict)
    world: int = 0
    split: Literal["train", "heldout"] = "heldout"
    seed: int = 0
    lockstep: bool = False
    quirks: dict[str, dict[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require(self.seed >= 0, "emulation.seed", self.seed, "0 or more")
        require(self.world >= 0, "emulation.world", self.world, "0 or more")


@dataclass(frozen=True)
class Deployment:
    """A team file; settings of belief and map are those that the policy was made for."""

    __pydantic_config__ = STRICT
    team: Team
    robots: dict[str, Wiring]
    site: Site | None = None
    emulation: Emulation | None = None
    rates: Rates = field(default_factory=Rates)
    estimation: Estimation = field(default_factory=Estimation)
    map: MapSettings = field(default_factory=MapSettings)
    seeing: Seeing = field(default_factory=Seeing)
    safety: SafetyLimits = field(default_factory=SafetyLimits)
    time_limit_s: float = 600.0
    collects_lost: bool = False

    def __post_init__(self) -> None:
        names = [member.name for member in self.team.members]
        for member in self.team.members:
            wired = self.robots.get(member.name)
            require(
                wired is not None, f"robots.{member.name}", None, "how it is reached: a link, a camera if it has one"
            )
            assert wired is not None
            has, camera = member.camera is not None, wired.camera
            expected = "a camera, as the team has it" if has else "none, as the team has none"
            require(has == (camera is not None), f"robots.{member.name}.camera", camera and camera.kind, expected)
            deaf = isinstance(wired.link, VelociroachSettings) and member.robot.radio_imu
            expected = "a robot with radio_imu: false, such as velociroach_radio: that radio carries no IMU"
            require(not deaf, f"robots.{member.name}.link.kind", wired.link.kind, expected)
        for name in self.robots:
            known(name, names, "robots", "one of the team")
        require(self.time_limit_s > 0, "time_limit_s", self.time_limit_s, "more than 0 s")
        if self.emulation is None:
            require(self.site is not None, "site", None, "where the robots start, or an emulation in its place")
        else:
            require(self.site is None, "site", "a site", "none beside an emulation, which has its own")
            for name in self.emulation.quirks:
                known(name, ["all", *names], "emulation.quirks", "all, or one of the team")
        if self.site is not None:
            self._check_site(self.site)
        parts = [(n, w, getattr(self.robots[n], w)) for n in names for w in ("link", "camera")]
        check_addresses(parts)

    def _check_site(self, site: Site) -> None:
        """Everybody on the map, within the geofence, in a place of its own; every port named."""
        members, fence = self.team.members, self.safety.corners
        require(len(site.start) == len(members), "site.start", len(site.start), f"{len(members)} poses, one a robot")
        (left, low), (wide, high) = site.map_corner_m, site.map_size_m
        at_work = [i for i, member in enumerate(members) if not member.reserve]
        for i in at_work:
            x, y, _ = site.start[i]
            field, place = f"site.start.{i}", (x, y)
            on_map = left <= x <= left + wide and low <= y <= low + high
            reach = f"on the map, x {left:g} to {left + wide:g} m, y {low:g} to {low + high:g} m"
            require(on_map, field, place, reach)
            require(fence is None or depth(fence, place) > 0, field, place, "within safety.geofence")
            for k in at_work[:i]:
                away_m = math.dist(place, site.start[k][:2])
                require(away_m >= APART_M, field, place, f"{APART_M} m or more from {members[k].name}'s")
        for name, wiring in self.robots.items():
            named = getattr(wiring.link, "port", 0) is not None
            require(named, f"robots.{name}.link.port", None, "a serial port such as /dev/ttyUSB0")

    def belief_settings(self) -> BeliefSettings:
        """What the belief has to know beforehand.

        Raises:
            ConfigError: there is no site yet.
        """
        site = self._site()
        shape = (round(site.map_size_m[0] / self.map.cell_m), round(site.map_size_m[1] / self.map.cell_m))
        return BeliefSettings(self.team, self.rates, self.estimation, self.map, self.time_limit_s, shape)

    def plan(self) -> Plan:
        """Where people set the robots down, for the estimator."""
        site, cells = self._site(), self.belief_settings().map_shape
        goal = (*site.goal, 1.0) if site.goal else (0.0, 0.0, 0.0, 0.0)
        single = {"start": site.start, "dock": site.dock or site.start[-1], "goal": goal, "corner": site.map_corner_m}
        arrays = {name: np.array([value], dtype=np.float32) for name, value in single.items()}
        return Plan(**arrays, cells=np.array([cells], dtype=np.int32))

    def description(self) -> TeamDescription:
        """What a policy may know of the team beforehand."""
        return TeamDescription(
            names=tuple(member.name for member in self.team.members),
            members=self.team.members,
            cell_m=self.map.cell_m * self.map.ego_stride,
            decision_s=self.rates.decision_s,
            goal_known=self._site().goal is not None,
            time_limit_s=self.time_limit_s,
            collects_lost=self.collects_lost,
        )

    def _site(self) -> Site:
        if self.site is None:
            raise ConfigError("site", None, "where the robots start (an emulation's follows when it has started)")
        return self.site


def load_deployment(source: str | Path | Mapping[str, Any]) -> Deployment:
    """A team file, or what stands in one.

    Raises:
        ConfigError: the first entry that is missing, unknown or wrong.
    """
    if isinstance(source, Mapping):
        tree = dict(source)
    else:
        tree = _read(Path(source))
    if "team" not in tree:
        raise ConfigError("team", None, "a team's name or its members")
    tree["team"] = load_team(tree["team"])
    robots = tree.get("robots")
    require(isinstance(robots, Mapping), "robots", robots, "a mapping: a link for each robot, a camera if it has one")
    assert isinstance(robots, Mapping)
    for name in robots:
        known(name, [member.name for member in tree["team"].members], "robots", "one of the team")
    tree["robots"] = {name: _wiring(f"robots.{name}", entry) for name, entry in robots.items()}
    return validated(Deployment, tree)


def _read(path: Path) -> dict[str, Any]:
    require(path.is_file(), "team", str(path), "a team file (.yaml) that exists")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError("team", str(path), f"a text file that can be read ({error})") from None
    return read_yaml(text, str(path))


def _wiring(path: str, entry: object) -> Wiring:
    """One robot's entry; ``path`` stands before the field also where a value is refused by what it is for."""
    try:
        return validated(Wiring, entry, path)
    except ConfigError as error:
        if error.field.startswith(path):
            raise
        raise ConfigError(f"{path}.{error.field}", error.value, error.expected) from None

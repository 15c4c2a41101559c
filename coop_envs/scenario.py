"""A scenario: world, team, task and the numbers of sensing, belief and reward, as one validated tree.

Scenarios are YAML files in ``worlds/scenarios``; ``load_scenario("arena", team="inchworm")`` reads one by name or path,
and overrides replace single entries: ``load_scenario("arena", **{"task.time_limit_s": 100})`` or
``load_scenario("arena", task={"time_limit_s": 100})``. Unknown keys are refused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from coop_envs.agents.catalog import team_tree
from coop_envs.agents.team import Team
from coop_envs.errors import ConfigError, require
from coop_envs.estimation.settings import Estimation, MapSettings, Rates
from coop_envs.validation import STRICT, known, read_yaml, validated
from coop_envs.worlds.arena import ArenaGeometry, RandomArenaGeometry
from coop_envs.worlds.build import Split, build_world
from coop_envs.worlds.building import BuildingGeometry
from coop_envs.worlds.corner import CornerGeometry
from coop_envs.worlds.flat import FlatGeometry
from coop_envs.worlds.height_map import HeightMapGeometry
from coop_envs.worlds.mesh_file import MeshFileGeometry
from coop_envs.worlds.placement import Footprint
from coop_envs.worlds.ramp import RampGeometry
from coop_envs.worlds.rubble import RubbleGeometry
from coop_envs.worlds.world import World

Geometry = Annotated[
    ArenaGeometry
    | RandomArenaGeometry
    | FlatGeometry
    | CornerGeometry
    | RampGeometry
    | RubbleGeometry
    | BuildingGeometry
    | MeshFileGeometry
    | HeightMapGeometry,
    Field(discriminator="kind"),
]
Fidelity = Literal["poses", "features"]
Physics = Literal["fast"]


@dataclass(frozen=True)
class Environment:
    """The environment column of thesis Table 6.1: geometry, friction, textures, lighting, particulate."""

    __pydantic_config__ = STRICT
    geometry: Geometry
    friction: float = 0.8
    texture: str = "cardboard"
    albedo: float = 0.6
    ambient_lux: float = 0.0
    particulate: float = 0.0
    medium: Literal["air", "water"] = "air"

    def __post_init__(self) -> None:
        require(0 < self.friction <= 2, "environment.friction", self.friction, "above 0, at most 2")
        require(0 <= self.albedo <= 1, "environment.albedo", self.albedo, "0 to 1")
        require(self.ambient_lux >= 0, "environment.ambient_lux", self.ambient_lux, "0 or more lux")
        require(
            0 <= self.particulate < 1,
            "environment.particulate",
            self.particulate,
            "0 up to 1 (fraction lost per metre)",
        )


@dataclass(frozen=True)
class Calibration:
    """How far calibration is off, as standard deviations drawn once a robot: the truth departs from what is believed.

    ``focal_share`` scales the focal length, ``centre_px`` shifts the image, ``hat_m`` each LED along each axis.
    """

    __pydantic_config__ = STRICT
    focal_share: float = 0.0
    centre_px: float = 0.0
    hat_m: float = 0.0

    def __post_init__(self) -> None:
        for name, limit in (("focal_share", 0.2), ("centre_px", 100.0), ("hat_m", 0.05)):
            value = getattr(self, name)
            require(0 <= value <= limit, f"sensing.calibration.{name}", value, f"0 to {limit:g}")


@dataclass(frozen=True)
class Sensing:
    """How cameras see LEDs: noise of pixel and hue at a reference signal, losses, lights that are none, calibration.

    A frame misses a hat with the chance ``dropout`` and shows a reflection of it instead with the chance ``outlier``;
    ``blob_dropout`` is the chance to miss a single LED, ``false_lights`` the mean number of other lights in a frame
    (at most 4). Blobs closer than ``merge_px`` are one. An LED may be any blob within ``hue_tolerance_deg`` of its hue.
    """

    __pydantic_config__ = STRICT
    pixel_noise_px: float = 0.5
    hue_noise_deg: float = 5.0
    hue_tolerance_deg: float = 29.0
    dropout: float = 0.02
    outlier: float = 0.005
    blob_dropout: float = 0.01
    false_lights: float = 0.2
    merge_px: float = 2.0
    calibration: Calibration = Calibration()
    min_leds: int = 4
    full_signal_range_m: float = 1.0
    detection_signal: float = 0.05

    def __post_init__(self) -> None:
        require(self.pixel_noise_px > 0, "sensing.pixel_noise_px", self.pixel_noise_px, "more than 0 px")
        require(0 <= self.blob_dropout < 1, "sensing.blob_dropout", self.blob_dropout, "0 up to 1")
        require(0 <= self.false_lights <= 4, "sensing.false_lights", self.false_lights, "0 to 4 a frame")
        for name in ("hue_noise_deg", "merge_px"):
            require(getattr(self, name) >= 0, f"sensing.{name}", getattr(self, name), "0 or more")
        tolerance_fits = 0 < self.hue_tolerance_deg <= 180
        require(tolerance_fits, "sensing.hue_tolerance_deg", self.hue_tolerance_deg, "above 0, at most 180 degrees")
        require(0 <= self.dropout < 1, "sensing.dropout", self.dropout, "0 up to 1")
        require(0 <= self.outlier < 1, "sensing.outlier", self.outlier, "0 up to 1")
        require(4 <= self.min_leds <= 8, "sensing.min_leds", self.min_leds, "4 to 8")
        for name in ("full_signal_range_m", "detection_signal"):
            require(getattr(self, name) > 0, f"sensing.{name}", getattr(self, name), "more than 0")


@dataclass(frozen=True)
class Scanning:
    """Laser spots in cameras: signal at full power, shares of missed and false ones, jitter of the frames' stamps.

    ``spot_signal`` is that of a spot on a white surface, faced squarely from ``sensing.full_signal_range_m``, on the
    scale on which an LED at full brightness has 1 there; ``beam_m`` is the beam's width.
    """

    __pydantic_config__ = STRICT
    spot_signal: float = 8.0
    beam_m: float = 0.003
    missed: float = 0.02
    false_spot: float = 0.005
    stamp_jitter_s: float = 0.0003

    def __post_init__(self) -> None:
        for name in ("spot_signal", "beam_m", "stamp_jitter_s"):
            require(getattr(self, name) >= 0, f"scanning.{name}", getattr(self, name), "0 or more")
        for name in ("missed", "false_spot"):
            require(0 <= getattr(self, name) < 1, f"scanning.{name}", getattr(self, name), "0 up to 1")


@dataclass(frozen=True)
class Task:
    """What counts as done: a goal reached by the observer, or a share of the reachable ground mapped.

    With ``collect_lost`` somebody takes lost robots out of the way, as in the experiments of thesis section 2.2.3;
    else they stay where they are, as obstacles and, while their hats are lit, as landmarks.
    """

    __pydantic_config__ = STRICT
    success: Literal["goal", "coverage"] = "goal"
    time_limit_s: float = 600.0
    coverage_target: float = 0.9
    collect_lost: bool = False

    def __post_init__(self) -> None:
        require(self.time_limit_s > 0, "task.time_limit_s", self.time_limit_s, "more than 0 s")
        require(0 < self.coverage_target <= 1, "task.coverage_target", self.coverage_target, "above 0, at most 1")


@dataclass(frozen=True)
class Reward:
    """Weights of the reward's terms, each per unit of its name; the reward is their sum."""

    __pydantic_config__ = STRICT
    information_per_bit: float = 0.1
    energy_per_joule: float = 0.0
    action_energy_per_joule: float = 0.02
    loss_per_picket: float = 5.0
    loss_per_observer: float = 50.0
    goal: float = 50.0


@dataclass(frozen=True)
class Scenario:
    """Everything that defines an exploration problem."""

    __pydantic_config__ = STRICT
    name: str
    description: str
    environment: Environment
    team: Team
    task: Task = Task()
    rates: Rates = dataclasses.field(default_factory=Rates)
    sensing: Sensing = Sensing()
    scanning: Scanning = Scanning()
    estimation: Estimation = dataclasses.field(default_factory=Estimation)
    map: MapSettings = dataclasses.field(default_factory=MapSettings)
    reward: Reward = Reward()
    fidelity: Fidelity = "poses"
    physics: Physics = "fast"

    def __post_init__(self) -> None:
        step_s = self.rates.tick_s / self.rates.substeps
        for member in self.team.members:
            step_m, limit_m = member.robot.max_speed_m_s * step_s, 0.5 * member.robot.body_radius_m
            expected = f"enough that {member.name} moves at most {limit_m:.3f} m a substep, not {step_m:.3f}"
            require(step_m <= limit_m, "rates.substeps", self.rates.substeps, expected)
        geometry = self.environment.geometry
        has_goal = isinstance(geometry, RandomArenaGeometry) or geometry.goal is not None
        require(has_goal or self.task.success != "goal", "task.success", "goal", "coverage, in a world without a goal")


def load_scenario(source: str | Path | Scenario, **overrides: Any) -> Scenario:
    """A scenario by name, YAML file or as it is, with entries replaced.

    Overrides are names of entries, dotted to reach inside, or nested mappings. ``team`` takes a preset's name, a YAML
    file or a mapping; ``world`` takes a mesh or a .png height map, which replaces the geometry, makes
    coverage the task and surveyors the team unless ``team`` names another.
    Raises: `ConfigError` in one line.
    """
    if isinstance(source, Scenario) and not overrides:
        return source
    tree = dataclasses.asdict(source) if isinstance(source, Scenario) else _read(source)
    changes = dict(overrides)
    world = changes.pop("world", None)
    if world is not None:
        tree = _merged(tree, _mesh_overrides(str(world)))
    if "team" in changes:
        team = changes.pop("team")
        tree["team"] = dataclasses.asdict(team) if isinstance(team, Team) else team
    tree["team"] = team_tree(tree.get("team"))
    for name, value in changes.items():
        tree = _merged(tree, _nested(name, value))
    return validated(Scenario, {**tree, "team": team_tree(tree["team"])})


def scenario_names() -> list[str]:
    """The scenarios that come with the package."""
    return sorted(Path(entry.name).stem for entry in _folder().iterdir() if entry.name.endswith(".yaml"))


def scenario_world(scenario: Scenario, split: Split = "train", index: int = 0) -> World:
    """World number ``index`` of the scenario's training or held-out worlds, with the team's starts in it."""
    return environment_world(scenario.environment, scenario.team, split, index)


def environment_world(environment: Environment, team: Team, split: Split, index: int) -> World:
    """World number ``index`` of the environment's training or held-out worlds, with the team's starts in it."""
    return build_world(
        environment.geometry,
        footprints(team),
        split=split,
        index=index,
        friction=environment.friction,
        albedo=environment.albedo,
        ambient_lux=environment.ambient_lux,
        medium=environment.medium,
        particulate=environment.particulate,
    )


def footprints(team: Team) -> tuple[Footprint, ...]:
    """What a world needs to know of each member to place it."""
    return tuple(
        Footprint(
            name=member.name,
            observer=member.role == "observer",
            reserve=member.reserve,
            body_radius_m=member.robot.body_radius_m,
            contact_radius_m=member.robot.contact_radius_m,
            max_step_m=member.robot.max_step_m,
            start=member.start,
            camera=member.camera is not None,
        )
        for member in team.members
    )


def _folder() -> Any:
    return resources.files("coop_envs") / "worlds" / "scenarios"


def _read(source: str | Path) -> dict[str, Any]:
    path = Path(source)
    if path.suffix in (".yaml", ".yml"):
        require(path.is_file(), "scenario", str(source), "a file that exists")
        return read_yaml(path.read_text(), str(path))
    name = known(str(source), scenario_names(), "scenario", "a YAML file or one of")
    return read_yaml((_folder() / f"{name}.yaml").read_text(), f"{name}.yaml")


def _mesh_overrides(path: str) -> dict[str, Any]:
    """Changes that make a file the world: a height map if it is a .png, else a mesh. Its ground may roll."""
    picture = Path(path).suffix.lower() == ".png"
    return {
        "name": Path(path).stem,
        "description": f"The {'height map' if picture else 'mesh'} {Path(path).name}; map what can be reached.",
        "environment": {"geometry": {"kind": "height_map" if picture else "mesh_file", "path": path}},
        "task": {"success": "coverage"},
        "team": "surveyors",
        "map": {"ego_stride": 2, "levels": 16, "floor_m": -0.375, "step_levels": 1},
        "reward": {"information_per_bit": 0.01},
    }


def _nested(name: str, value: Any) -> dict[str, Any]:
    """{"a": {"b": value}} for the dotted name "a.b"."""
    for key in reversed(name.split(".")):
        value = {key: value}
    return value


def _merged(tree: Any, changes: Any, path: str = "") -> Any:
    """``tree`` with the entries of ``changes`` put in; another ``kind`` or a ``base`` replaces the whole mapping."""
    if isinstance(tree, list | tuple) and isinstance(changes, Mapping):
        items = list(tree)
        for key, value in changes.items():
            index = _item(items, str(key), path)
            items[index] = _merged(items[index], value, f"{path}.{key}")
        return items
    if not (isinstance(tree, Mapping) and isinstance(changes, Mapping)):
        return changes
    if "base" in changes or changes.get("kind", tree.get("kind")) != tree.get("kind"):
        return dict(changes)
    replaced = {key: _merged(tree.get(key), value, f"{path}.{key}".strip(".")) for key, value in changes.items()}
    return {**tree, **replaced}


def _item(items: list[Any], key: str, path: str) -> int:
    """The place in a list that a number, or the ``name`` of an entry, stands for."""
    names = [str(entry.get("name")) if isinstance(entry, Mapping) else "" for entry in items]
    if key in names:
        return names.index(key)
    if not key.isdigit() or int(key) >= len(items):
        raise ConfigError(f"{path}.{key}", key, f"0 to {len(items) - 1} or one of {', '.join(filter(None, names))}")
    return int(key)

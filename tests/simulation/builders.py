"""Small worlds and teams for the physics, and how to drive them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from coop_envs.agents.catalog import load_camera, load_hat, load_robot
from coop_envs.agents.specification import Hat, Imu, RobotSpecification
from coop_envs.agents.team import Member, Team
from coop_envs.device import prepare
from coop_envs.geometry.keyed_random import team_key
from coop_envs.sensing.leds import LedModel
from coop_envs.sensing.spots import SpotModel
from coop_envs.simulation.calibration import CalibrationError
from coop_envs.simulation.fast import FastPhysics, Placement, Stage
from coop_envs.simulation.state import Status
from coop_envs.simulation.step import Clock
from coop_envs.worlds.world import Hazard, HeightField, Mesh, World

Pose = tuple[float, float, float]
EXACT = Placement(0.0, 0.0)
SILENT = Imu(*[0.0] * 8)
ZUMY = load_robot("zumy")
ROACH = load_robot("velociroach")
DECISION_S = 0.2


def calm(robot: RobotSpecification, **changes) -> RobotSpecification:
    """The robot without slip, noise and bias."""
    return replace(robot, **{"slip": 0.0, "odometry_noise": 0.0, "imu": SILENT, **changes})


def prompt(robot: RobotSpecification, **changes) -> RobotSpecification:
    """A calm robot whose wheels follow at once."""
    return calm(robot, drive_lag_s=0.0, **changes)


def team_of(*robots: RobotSpecification, hat: Hat | None = None, reserves: int = 0) -> Team:
    """An observer with a camera and pickets with hats; the last ``reserves`` of them wait in the dock."""
    hat = hat or load_hat("hat0")
    first = len(robots) - reserves
    pickets = [
        Member(f"picket_{k - 1}", "picket", robot, hat=hat, reserve=k >= first)
        for k, robot in enumerate(robots)
        if k > 0
    ]
    return Team("team", (Member("observer_0", "observer", robots[0], (load_camera("ch6"),), hat), *pickets))


def ground_of(surface: Callable, bounds_m=(-2.0, -2.0, 2.0, 2.0), cell_m=0.02) -> HeightField:
    """A height field through z = surface(x, y)."""
    x_min, y_min, x_max, y_max = bounds_m
    x = np.linspace(x_min, x_max, round((x_max - x_min) / cell_m) + 1)
    y = np.linspace(y_min, y_max, round((y_max - y_min) / cell_m) + 1)
    heights = np.broadcast_to(surface(*np.meshgrid(x, y, indexing="ij")), (len(x), len(y)))
    return HeightField(heights.astype(np.float32), (x_min, y_min), cell_m)


FLAT = ground_of(lambda x, y: 0.0 * x)


def world_of(
    ground: HeightField = FLAT,
    starts: Sequence[Pose] = ((0.0, 0.0, 0.0),),
    hazards: Sequence[Hazard] = (),
    mesh: Mesh | None = None,
    dock: Pose = (-1.5, -1.5, 0.0),
    friction: float = 0.8,
) -> World:
    """A world with these starts, one for each robot."""
    return World("scene", ground, mesh, tuple(hazards), tuple(starts), dock, None, friction=friction)


def led_model(**changes) -> LedModel:
    """LEDs as in the scenarios, without dropouts and outliers."""
    model = LedModel()
    model.noise_px, model.reference_range, model.detection_signal, model.min_leds = 0.5, 1.0, 0.05, 4
    model.hue_tolerance = 29.0
    for name, value in changes.items():
        setattr(model, name, value)
    return model


def spot_model(**changes) -> SpotModel:
    """Laser spots as in the scenarios, none missed, none false, exact stamps."""
    model = SpotModel()
    model.gain, model.albedo, model.beam = 8.0, 0.6, 0.003
    for name, value in changes.items():
        setattr(model, name, value)
    return model


def clock_of(tick_s=1.0 / 30.0, substeps=4, ticks=6) -> Clock:
    """Rates of the physics; by default those of the scenarios."""
    clock = Clock()
    clock.tick_s, clock.substeps, clock.ticks = tick_s, substeps, ticks
    return clock


def physics_of(
    team: Team,
    *worlds: World,
    teams: int = 1,
    seed: int = 0,
    chosen_worlds: Sequence[int] | None = None,
    clock: Clock | None = None,
    leds: LedModel | None = None,
    spots: SpotModel | None = None,
    placement: Placement = EXACT,
    fidelity: str = "poses",
    calibration: CalibrationError | None = None,
) -> FastPhysics:
    """The physics of ``teams`` teams, set down at their starts; team b has seed ``seed + b``."""
    worlds = worlds or (world_of(),)
    models = leds or led_model(), spots or spot_model()
    stage = Stage(worlds, len(team.members), placement, prepare("cpu"))
    physics = FastPhysics(team, stage, clock or clock_of(), *models, teams, fidelity, calibration)
    keys = np.array([team_key(seed + b, 0) for b in range(teams)], dtype=np.uint64)
    where = np.zeros(teams, dtype=np.int32) if chosen_worlds is None else np.array(chosen_worlds, dtype=np.int32)
    physics.reset(np.ones(teams, dtype=np.int32), keys, where)
    return physics


def wheels_of(robot: RobotSpecification, speed: ArrayLike, yaw_rate: ArrayLike) -> np.ndarray:
    """Left and right wheel speed (rad/s), counter-clockwise positive."""
    half = np.multiply(yaw_rate, robot.track_m / 2)
    return np.stack([np.subtract(speed, half), np.add(speed, half)], axis=-1) / robot.wheel_radius_m


def command(
    physics: FastPhysics, robot: RobotSpecification, speed: ArrayLike = 0.0, yaw_rate: ArrayLike = 0.0, index: int = 0
) -> None:
    """Set the wheels of robot ``index`` in every team; ``speed`` and ``yaw_rate`` may be one for each team."""
    physics.command.wheels.numpy()[:, index] = wheels_of(robot, speed, yaw_rate)


def run(physics: FastPhysics, seconds: float, each: Callable[[], object] | None = None) -> list:
    """Step for some time; what ``each`` returned after every decision."""
    seen = []
    for _ in range(round(seconds / DECISION_S)):
        physics.step()
        seen.append(each() if each else None)
    return seen


def position(physics: FastPhysics, index=0, team=0) -> np.ndarray:
    """Body origin, a copy (3,)."""
    return physics.state.position.numpy()[team, index].astype(float)


def feet(physics: FastPhysics, *robots: RobotSpecification) -> np.ndarray:
    """Where robots stand: the points on the ground under their bodies (B, N, 3)."""
    heights = np.array([robot.body_height_m for robot in robots])[:, None]
    return physics.state.position.numpy() - physics.state.rotation.numpy()[..., 2].astype(float) * heights


def yaw(physics: FastPhysics, index=0, team=0) -> float:
    """Heading in radians."""
    return float(physics.state.yaw.numpy()[team, index])


def status(physics: FastPhysics, index=0, team=0) -> Status:
    """What has become of a robot."""
    return Status(int(physics.state.status.numpy()[team, index]))

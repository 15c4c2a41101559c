"""`FastPhysics`: truth and measurements of a batch of teams, on one device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.command import allocate_command
from coop_envs.agents.raster import laser_models
from coop_envs.agents.team import Team
from coop_envs.geometry.arrays import allocate
from coop_envs.sensing.features import allocate_features
from coop_envs.sensing.leds import LedModel
from coop_envs.sensing.measurements import allocate_measurements
from coop_envs.sensing.solver import allocate_workspace, solve_poses, solver_model
from coop_envs.sensing.spots import SpotModel
from coop_envs.simulation.calibration import CalibrationError
from coop_envs.simulation.dynamics import Ground
from coop_envs.simulation.imaging import FALSE_LIGHTS, allocate_labels, image_leds
from coop_envs.simulation.parameters import pack_hazards, pack_robots, pack_terrain
from coop_envs.simulation.reset import Starting, Starts, place_teams, serve_dock
from coop_envs.simulation.scan import shine
from coop_envs.simulation.sight import see
from coop_envs.simulation.state import State
from coop_envs.simulation.step import Clock, advance
from coop_envs.worlds.world import World


@dataclass(frozen=True)
class Placement:
    """How exactly people set robots down: standard deviations."""

    position_sigma_m: float = 0.005
    yaw_sigma_rad: float = 0.03


class Stage:
    """W worlds on a device: what robots stand on and where they start. Batches of teams may share one."""

    def __init__(self, worlds: Sequence[World], robots: int, placement: Placement, device: str) -> None:
        self.device = device
        self.ground = Ground()
        self.ground.terrain, self.meshes = pack_terrain(worlds, device)
        self.ground.hazards = pack_hazards(worlds, device)
        self.ground.friction = worlds[0].friction
        self.starts = _pack_starts(worlds, robots, placement, device)


class FastPhysics:
    """Steps those of B teams whose ``running`` is 1 through W worlds; launches are recorded once and replayed."""

    def __init__(
        self,
        team: Team,
        stage: Stage,
        clock: Clock,
        led_model: LedModel,
        spot_model: SpotModel,
        teams: int,
        fidelity: str = "poses",
        calibration: CalibrationError | None = None,
    ) -> None:
        n, device = len(team.members), stage.device
        self.device, self.teams, self.stage, self.ground = device, teams, stage, stage.ground
        self.robots, self.cameras, self.hats = pack_robots(team, device)
        self.state: State = allocate(State, (teams, n, clock.ticks), device)
        self.command = allocate_command(teams, n, clock.ticks, device)
        self.lasers = laser_models(team, clock.tick_s, device)
        self.measurements = allocate_measurements(teams, n, clock.ticks, device)
        self.running = wp.ones(teams, dtype=int, device=device)
        shared = [self.state, self.command]
        self._serve_dock = self._record(
            serve_dock, teams, [*shared, self.robots, stage.starts, self.ground, self.running]
        )
        self._advance = self._record(
            advance, teams, [*shared, self.measurements, self.robots, self.lasers, self.ground, clock, self.running]
        )
        self.calibration = CalibrationError() if calibration is None else calibration
        self.sight = self._record_sight(led_model, fidelity)
        believed = [self.robots, self.lasers, self.cameras]
        lit = [*shared, self.measurements, *believed, self.calibration, led_model, spot_model]
        scanning = any(member.laser is not None for member in team.members)
        self._shine = [self._record(shine, (teams, clock.ticks), [*lit, self.ground, self.running])] * scanning
        self.starting: Starting = allocate(Starting, (teams,), device)
        self._place = self._record(
            place_teams, teams, [self.state, self.robots, stage.starts, self.ground, self.starting]
        )

    def _record_sight(self, leds: LedModel, fidelity: str) -> list[wp.Launch]:
        """Frames of LED blobs in ``features``; then the poses that rung ``fidelity`` makes of them, in ``answer``."""
        teams, n = self.state.position.shape
        size = (teams, n, sum(int(k) for k in self.hats.leds.numpy()) + FALSE_LIGHTS)
        self.features, self.labels = allocate_features(*size, self.device), allocate_labels(*size, self.device)
        self.answer = wp.zeros((teams, n, n), dtype=int, device=self.device)
        blobs, where = [self.features, self.labels], [self.hats, self.cameras, leds]
        frames = [self.state, self.command, *blobs, self.robots, *where, self.calibration, self.ground, self.running]
        told = [self.measurements, self.answer, self.running]
        if fidelity == "features":
            known = [self.cameras, self.hats, self.command.brightness, self.measurements.docked]
            kernel = solve_poses
            inputs = [self.features, *known, leds, solver_model(leds), allocate_workspace(*size, self.device), *told]
        else:
            kernel, inputs = see, [self.state, *blobs, *where, *told]
        return [self._record(image_leds, (teams, n), frames), self._record(kernel, (teams, n), inputs)]

    def _record(self, kernel: wp.Kernel, dim: int | tuple[int, int], inputs: list[object]) -> wp.Launch:
        return wp.launch(kernel, dim, inputs=inputs, device=self.device, record_cmd=True)

    def reset(self, chosen: NDArray[np.int32], keys: NDArray[np.uint64], worlds: NDArray[np.int32]) -> None:
        """Start the teams with ``chosen`` 1 anew, each with its key and world (all (B,))."""
        self.call_up(chosen, keys, worlds)
        self.place()

    def call_up(self, chosen: NDArray[np.int32], keys: NDArray[np.uint64], worlds: NDArray[np.int32]) -> None:
        """Say in ``starting`` which teams are to start anew, and each one's key and world (all (B,))."""
        self.starting.chosen.assign(chosen)
        self.starting.key.assign(keys)
        self.starting.world.assign(worlds)

    def place(self) -> None:
        """Set down the robots of the teams that ``starting`` names."""
        self._place.launch()

    def step(self) -> None:
        """Carry out ``command`` for one decision and fill ``measurements``."""
        self._serve_dock.launch()
        self._advance.launch()
        for launch in self.sight:
            launch.launch()
        for launch in self._shine:
            launch.launch()


def _pack_starts(worlds: Sequence[World], robots: int, placement: Placement, device: str) -> Starts:
    poses = np.zeros((len(worlds), robots, 3), dtype=np.float32)
    for w, world in enumerate(worlds):
        poses[w] = (list(world.starts) + [world.dock] * robots)[:robots]
    starts = Starts()
    starts.pose = wp.array(poses, dtype=wp.vec3, device=device)
    starts.dock = wp.array([world.dock for world in worlds], dtype=wp.vec3, device=device)
    starts.position_sigma, starts.yaw_sigma = placement.position_sigma_m, placement.yaw_sigma_rad
    return starts

"""`TeamBatch`: B teams in one environment, from actions to observations, as arrays on one device.

The loop of a decision is: actions -> commands -> physics -> measurements -> belief, map, observations -> score. The
batch of one is the single environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.actions import ACTION_SIZE
from coop_envs.agents.control import control, drive_models
from coop_envs.agents.raster import Raster, rest_rasters
from coop_envs.belief_loop import BeliefLoop, BeliefSettings
from coop_envs.errors import ConfigError
from coop_envs.geometry.arrays import allocate, assign, part_of, to_numpy
from coop_envs.mapping.information import cell_information_ubit
from coop_envs.observations import Observations, allocate_observations
from coop_envs.packed_pool import PackedPool, tell_plans
from coop_envs.scenario import Scenario
from coop_envs.scoring import TERMS, Score, judge, open_account, pickets, score_model
from coop_envs.sensing.leds import LedModel
from coop_envs.sensing.spots import SpotModel
from coop_envs.simulation.calibration import CalibrationError
from coop_envs.simulation.fast import FastPhysics
from coop_envs.simulation.step import Clock
from coop_envs.world_pool import WorldPool
from coop_envs.worlds.world import World


@dataclass(frozen=True)
class Exchange:
    """What a batch and its user exchange, device arrays over B teams: ``actions`` (B, N, 8) in, the others out."""

    actions: wp.array
    observations: Observations
    score: Score

    def part(self, rows: slice) -> Exchange:
        """These teams' part of the same memory."""
        return Exchange(self.actions[rows], part_of(self.observations, rows), part_of(self.score, rows))


def allocate_exchange(scenario: Scenario, pool: WorldPool, teams: int, device: str) -> Exchange:
    """An exchange of nothing yet."""
    n, (nx, ny) = len(scenario.team.members), pool.map_shape
    return Exchange(
        wp.zeros((teams, n, ACTION_SIZE), dtype=float, device=device),
        allocate_observations(teams, n, device),
        allocate(Score, (teams, n), device, terms=(teams, len(TERMS)), covered=(teams, nx * ny)),
    )


class TeamBatch:
    """B teams of the scenario's robots in the worlds of a pool.

    ``actions`` (B, N, 8) is written by the caller before `step`; ``observations``, ``score``, ``belief`` and ``state``
    hold the outcome. All are device arrays; on the CPU ``.numpy()`` of each is a view. ``exchange`` may be a part of a
    larger one.
    """

    def __init__(self, scenario: Scenario, packed: PackedPool, teams: int, exchange: Exchange | None = None) -> None:
        n, device = len(scenario.team.members), packed.device
        self.scenario, self.pool, self.teams, self.device = scenario, packed.pool, teams, device
        exchange = exchange or allocate_exchange(scenario, packed.pool, teams, device)
        self.actions, self.observations, self.score = exchange.actions, exchange.observations, exchange.score
        self.physics = open_physics(scenario, packed, teams)
        self.state, self.running = self.physics.state, self.physics.running
        self.starting = self.physics.starting
        self.measurements, self.command = self.physics.measurements, self.physics.command
        settings = belief_settings(scenario, packed.pool.map_shape)
        self.loop = BeliefLoop(settings, self.measurements, self.command, self.running, device, self.observations)
        self.belief, self.map, self.map_model = self.loop.belief, self.loop.map, self.loop.map_model
        self.truth = packed.truth
        self.raster: Raster = allocate(Raster, (teams, n), device)
        table = wp.array(cell_information_ubit(), dtype=int, device=device)
        accounts = [self.state, self.map, self.truth, self.map_model, self.score]
        drives = drive_models(scenario.team, scenario.task.collect_lost, device)
        told = [self.actions, self.belief.declared, self.belief.undock, self.belief.clock]
        called = [*told, drives, self.physics.lasers, self.raster, self.command, self.running]
        weights = score_model(scenario.reward, scenario.task, scenario.rates.decision_s)
        scored = [self.state, self.belief, self.map, self.truth, self.map_model, weights, self.score]
        estimator, chosen = self.loop.estimator, self.starting.chosen
        self._tell_plans = self._record(
            tell_plans,
            teams,
            [self.starting, packed.sites, estimator.plans, estimator.corner, estimator.cells, estimator.chosen],
        )
        self._rest_rasters = self._record(rest_rasters, (teams, n), [self.raster, chosen])
        self._open_account = self._record(open_account, teams, [*accounts, chosen])
        self._control = self._record(control, (teams, n), called)
        self._judge = self._record(judge, teams, [*scored, pickets(scenario.team, device), table, self.running])

    def _record(self, kernel: wp.Kernel, dim: int | tuple[int, int], inputs: list[object]) -> wp.Launch:
        return wp.launch(kernel, dim, inputs=inputs, device=self.device, record_cmd=True)

    def place(self, chosen: NDArray[np.int32], keys: NDArray[np.uint64], worlds: NDArray[np.int32]) -> None:
        """Set the teams with ``chosen`` 1 down anew; their next decision, at rest, gives the first observation.

        chosen (B,) 0 or 1, keys (B,) random keys, worlds (B,) places in the pool.
        """
        self.physics.call_up(chosen, keys, worlds)
        self.start()

    def start(self) -> None:
        """Set down anew the teams that ``starting`` names."""
        self.physics.place()
        self._tell_plans.launch()
        self.loop.estimator.begin()
        self._rest_rasters.launch()
        self._open_account.launch()

    def snapshot(self) -> dict[str, dict[str, NDArray[np.generic]]]:
        """A copy of everything that changes, by part and name; `restore` brings it back."""
        return {name: to_numpy(part) for name, part in self._parts().items()}

    def restore(self, snapshot: Mapping[str, Mapping[str, NDArray[np.generic]]]) -> None:
        """Go back to a `snapshot` of this batch or of one of the same scenario, worlds and size.

        Raises:
            ConfigError: the snapshot is of another batch.
        """
        try:
            for name, part in self._parts().items():
                assign(part, snapshot[name])
        except (KeyError, ValueError) as error:
            raise ConfigError(
                "state", str(error), "a snapshot of the same scenario, worlds and number of teams"
            ) from None

    def _parts(self) -> dict[str, Any]:
        return {
            "state": self.state,
            "belief": self.belief,
            "map": self.map,
            "plans": self.loop.plans,
            "score": self.score,
            "measurements": self.measurements,
            "command": self.command,
            "raster": self.raster,
            "points": self.loop.points,
            "observations": self.observations,
        }

    def step(self) -> None:
        """Carry out ``actions`` for one decision in every running team."""
        self._control.launch()
        self.physics.step()
        self.loop.step()
        self._judge.launch()


def open_physics(scenario: Scenario, packed: PackedPool, teams: int) -> FastPhysics:
    """The physics of B teams alone, for studies that hold no belief or another one."""
    world = packed.pool.worlds[0]
    models = _clock(scenario), _led_model(scenario, world), _spot_model(scenario, world)
    calibration = _calibration_error(scenario)
    return FastPhysics(scenario.team, packed.stage, *models, teams, scenario.fidelity, calibration)


def belief_settings(scenario: Scenario, map_shape: tuple[int, int]) -> BeliefSettings:
    """What of a scenario a robot's host knows."""
    return BeliefSettings(
        team=scenario.team,
        rates=scenario.rates,
        estimation=scenario.estimation,
        map=scenario.map,
        time_limit_s=scenario.task.time_limit_s,
        map_shape=map_shape,
    )


def _clock(scenario: Scenario) -> Clock:
    clock = Clock()
    clock.tick_s, clock.substeps = scenario.rates.tick_s, scenario.rates.substeps
    clock.ticks = scenario.rates.ticks_per_decision
    return clock


def _led_model(scenario: Scenario, world: World) -> LedModel:
    sensing, medium = scenario.sensing, world.medium
    model = LedModel()
    model.noise_px, model.reference_range = sensing.pixel_noise_px, sensing.full_signal_range_m
    model.absorption = float(np.mean(medium.absorption_1_m)) - float(np.log1p(-medium.particulate))
    model.detection_signal, model.min_leds = sensing.detection_signal, sensing.min_leds
    model.dropout, model.outlier = sensing.dropout, sensing.outlier
    model.hue_noise, model.hue_tolerance = sensing.hue_noise_deg, sensing.hue_tolerance_deg
    model.blob_dropout, model.false_lights, model.merge = sensing.blob_dropout, sensing.false_lights, sensing.merge_px
    return model


def _calibration_error(scenario: Scenario) -> CalibrationError:
    given, error = scenario.sensing.calibration, CalibrationError()
    error.focal_share, error.centre, error.hat = given.focal_share, given.centre_px, given.hat_m
    return error


def _spot_model(scenario: Scenario, world: World) -> SpotModel:
    scanning = scenario.scanning
    model = SpotModel()
    model.gain, model.albedo, model.beam = scanning.spot_signal, world.albedo, scanning.beam_m
    model.missed, model.false_spot, model.jitter = scanning.missed, scanning.false_spot, scanning.stamp_jitter_s
    return model

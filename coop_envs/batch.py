"""`TeamBatch`: B teams in one environment, from actions to observations, as arrays on one device.

The loop of a decision is: actions -> commands -> physics -> measurements -> belief, map, observations -> score. The
batch of one is the single environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.actions import ACTION_SIZE
from coop_envs.agents.control import control, drive_models
from coop_envs.agents.raster import Raster, rest_rasters
from coop_envs.belief_loop import BeliefLoop, BeliefSettings
from coop_envs.errors import ConfigError
from coop_envs.geometry.arrays import allocate, assign, to_numpy
from coop_envs.mapping.information import cell_information_ubit
from coop_envs.scenario import Scenario
from coop_envs.scoring import TERMS, Score, judge, open_account, pickets, score_model
from coop_envs.sensing.leds import LedModel
from coop_envs.sensing.spots import SpotModel
from coop_envs.simulation.calibration import CalibrationError
from coop_envs.simulation.fast import FastPhysics, Placement
from coop_envs.simulation.step import Clock
from coop_envs.truth_lookup import pack_truth
from coop_envs.world_pool import WorldPool
from coop_envs.worlds.world import World


class TeamBatch:
    """B teams of the scenario's robots in the worlds of a pool.

    ``actions`` (B, N, 8) is written by the caller before `step`; ``observations``, ``score``, ``belief`` and ``state``
    hold the outcome. All are device arrays; on the CPU ``.numpy()`` of each is a view.
    """

    def __init__(self, scenario: Scenario, pool: WorldPool, teams: int, device: str) -> None:
        n = len(scenario.team.members)
        self.scenario, self.pool, self.teams, self.device = scenario, pool, teams, device
        leds = _led_model(scenario, pool.worlds[0])
        spots = _spot_model(scenario, pool.worlds[0])
        self.physics = FastPhysics(
            scenario.team,
            pool.worlds,
            _clock(scenario),
            leds,
            spots,
            teams,
            device,
            Placement(scenario.estimation.start_position_m, scenario.estimation.start_yaw_rad),
            scenario.fidelity,
            _calibration_error(scenario),
        )
        self.state, self.running = self.physics.state, self.physics.running
        self.measurements, self.command = self.physics.measurements, self.physics.command
        settings = belief_settings(scenario, pool.map_shape)
        self.loop = BeliefLoop(settings, self.measurements, self.command, self.running, device)
        self.belief, self.map, self.map_model = self.loop.belief, self.loop.map, self.loop.map_model
        self.observations = self.loop.observations
        self.actions = wp.zeros((teams, n, ACTION_SIZE), dtype=float, device=device)
        covered = (teams, self.map_model.nx * self.map_model.ny)
        self.score: Score = allocate(Score, (teams, n), device, terms=(teams, len(TERMS)), covered=covered)
        self.truth = pack_truth(pool.worlds, pool.truth, pool.solids, device)
        kinds = pickets(scenario.team, device)
        table = wp.array(cell_information_ubit(), dtype=int, device=device)
        self._accounts = [self.state, self.map, self.truth, self.map_model, self.score]
        drives = drive_models(scenario.team, scenario.task.collect_lost, device)
        self.raster: Raster = allocate(Raster, (teams, n), device)
        told = [self.actions, self.belief.declared, self.belief.undock, self.belief.clock]
        called = [*told, drives, self.physics.lasers, self.raster, self.command, self.running]
        weights = score_model(scenario.reward, scenario.task, scenario.rates.decision_s)
        scored = [self.state, self.belief, self.map, self.truth, self.map_model, weights, self.score]
        self._control = self._record(control, (teams, n), called)
        self._judge = self._record(judge, teams, [*scored, kinds, table, self.running])

    def _record(self, kernel: wp.Kernel, dim: int | tuple[int, int], inputs: list[object]) -> wp.Launch:
        return wp.launch(kernel, dim, inputs=inputs, device=self.device, record_cmd=True)

    def place(self, chosen: NDArray[np.int32], keys: NDArray[np.uint64], worlds: NDArray[np.int32]) -> None:
        """Set the teams with ``chosen`` 1 down anew; their next decision, at rest, gives the first observation.

        chosen (B,) 0 or 1, keys (B,) random keys, worlds (B,) places in the pool.
        """
        self.physics.reset(chosen, keys, worlds)
        pool = self.pool
        self.loop.reset(chosen, pool.plan(worlds))
        mask = wp.array(chosen, dtype=int, device=self.device)
        wp.launch(rest_rasters, self.raster.point.shape, inputs=[self.raster, mask], device=self.device)
        wp.launch(open_account, self.teams, inputs=[*self._accounts, mask], device=self.device)

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

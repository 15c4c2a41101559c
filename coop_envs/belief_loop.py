"""`BeliefLoop`: from measurements and commands to beliefs, maps and observations, in simulation and on robots alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.command import Command
from coop_envs.agents.team import Team
from coop_envs.estimation.estimator import Plan, TeamEstimator
from coop_envs.estimation.settings import Estimation, MapSettings, Rates
from coop_envs.mapping.ground_map import MapModel
from coop_envs.observations import Observations, ViewModel, allocate_observations, observe
from coop_envs.sensing.measurements import Measurements


@dataclass(frozen=True)
class BeliefSettings:
    """What a host has to know beforehand to hold a team's belief; ``map_shape`` is cells along x and y."""

    team: Team
    rates: Rates
    estimation: Estimation
    map: MapSettings
    time_limit_s: float
    map_shape: tuple[int, int]


class BeliefLoop:
    """Beliefs, maps and observations of B teams, a function of plans, ``measurements`` and ``command`` alone.

    Teams whose ``running`` (B,) is 0 stay as they are. ``observations`` are written where they are given.
    """

    def __init__(
        self,
        settings: BeliefSettings,
        measurements: Measurements,
        command: Command,
        running: wp.array,
        device: str,
        observations: Observations | None = None,
    ) -> None:
        teams, n = running.shape[0], len(settings.team.members)
        self.map_model = _map_model(settings)
        self.estimator = TeamEstimator(
            settings.team, settings.rates, settings.estimation, self.map_model, measurements, command, running, device
        )
        self.belief, self.map, self.plans = self.estimator.belief, self.estimator.map, self.estimator.plans
        self.observations = observations or allocate_observations(teams, n, device)
        seen = [self.belief, self.map, self.map_model, _view_model(settings), self.estimator.members]
        self.points = self.estimator.points
        inputs = [*seen, measurements.gyro, command, self.points, self.observations, running]
        self._observe = wp.launch(observe, (teams, n), inputs=inputs, device=device, record_cmd=True)

    def reset(self, chosen: NDArray[np.int32], plan: Plan) -> None:
        """Start the beliefs and maps of the teams with ``chosen`` 1 (B,) anew."""
        self.estimator.reset(chosen, plan)

    def step(self) -> None:
        """Take in one decision's measurements and the command under which they were made."""
        self.estimator.step()
        self._observe.launch()


def _map_model(settings: BeliefSettings) -> MapModel:
    model = MapModel()
    model.nx, model.ny = settings.map_shape
    model.cell, model.stride = settings.map.cell_m, settings.map.ego_stride
    model.mark_radius = settings.estimation.hazard_mark_m
    if any(member.laser is not None for member in settings.team.members):
        tallest_m = max(member.robot.height_m for member in settings.team.members)
        model.levels, model.floor = settings.map.levels, settings.map.floor_m
        above_m = tallest_m - 0.5 * model.cell  # the floor lies, on average, in the middle of the level under a passage
        model.clearance = min(max(math.ceil(above_m / model.cell), 1), model.levels)
        model.step, model.sweep = settings.map.step_levels, settings.map.sweep_radius_m
    return model


def _view_model(settings: BeliefSettings) -> ViewModel:
    view = ViewModel()
    view.time_limit, view.decision = settings.time_limit_s, settings.rates.decision_s
    view.stuck = settings.estimation.stuck_s
    return view

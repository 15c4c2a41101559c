"""`TeamFilter`: the team filter alone, without map and declarations, in windows of any length: for logs and studies."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.command import Command
from coop_envs.agents.team import Team
from coop_envs.estimation.belief import Belief, allocate_belief, member_models
from coop_envs.estimation.calibration import CalibrationPrior, pack_optics
from coop_envs.estimation.correction import fuse
from coop_envs.estimation.joining import Plans, Prior, begin
from coop_envs.estimation.propagation import FilterModel, propagate
from coop_envs.estimation.rows import allocate_rows
from coop_envs.estimation.settings import Estimation
from coop_envs.geometry.arrays import allocate, assign, to_numpy
from coop_envs.sensing.measurements import Measurements

Snapshot = dict[str, NDArray[Any]]


class TeamFilter:
    """Beliefs of B teams of the same robots, a function of starts, ``measurements`` and ``command`` alone.

    Teams whose ``running`` (B,) is 0 stay as they are. Launches are recorded once and replayed.
    """

    def __init__(
        self,
        team: Team,
        settings: Estimation,
        measurements: Measurements,
        command: Command,
        device: str = "cpu",
        running: wp.array | None = None,
    ) -> None:
        self.teams, robots, self.ticks = measurements.gyro.shape
        self.device, self._settings = device, settings
        self.members = member_models(team, settings, device)
        self.belief: Belief = allocate_belief(team, self.teams, device, settings)
        self.rows = allocate_rows(self.belief)
        self.plans: Plans = allocate(Plans, (self.teams, robots), device)
        self.running = wp.full(self.teams, 1, dtype=int, device=device) if running is None else running
        self.chosen = wp.zeros(self.teams, dtype=int, device=device)
        self._window_s = 0.0
        self.optics = pack_optics(team, device)
        model, prior = FilterModel(), _prior(settings)
        told = [self.belief, command, measurements, self.plans, prior]
        calibration = [self.optics.hats, _calibration_prior(settings)]
        self._begin = self._record(begin, [self.belief, self.plans, prior, self.members, *calibration, self.chosen])
        self._steps = [
            self._record(propagate, [*told, self.members, model, self.rows, self.running]),
            self._record(fuse, [self.belief, measurements, self.members, self.optics, model, self.rows, self.running]),
        ]

    def _record(self, kernel: wp.Kernel, inputs: list[object]) -> wp.Launch:
        return wp.launch(kernel, self.teams, inputs=inputs, device=self.device, record_cmd=True)

    def reset(self, start: NDArray[np.floating[Any]]) -> None:
        """Start all teams anew with their robots at rest at ``start`` (B, N, 3): x, y, yaw in the team frame."""
        self.plans.start.assign(np.asarray(start, dtype=np.float32))
        self.chosen.fill_(1)
        self.begin()

    def begin(self) -> None:
        """Start the teams with ``chosen`` 1 anew, by ``plans``."""
        self._begin.launch()

    def step(self, window_s: float) -> None:
        """Carry the belief over a window, its ticks equally long, and fuse what was seen at its end."""
        if window_s != self._window_s:
            self._window_s = window_s
            model = _filter_model(window_s, self.ticks, self._settings)
            for launch in self._steps:
                launch.set_param_by_name("model", model)
        for launch in self._steps:
            launch.launch()

    def snapshot(self) -> Snapshot:
        """A copy of the belief."""
        return {name: array.copy() for name, array in to_numpy(self.belief).items()}

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a `snapshot`."""
        assign(self.belief, snapshot)


def _calibration_prior(settings: Estimation) -> CalibrationPrior:
    prior = CalibrationPrior()
    prior.focal, prior.centre_px = settings.focal_sigma, settings.centre_sigma_px
    prior.place, prior.turn, prior.hat = settings.lever_sigma_m, settings.lever_sigma_rad, settings.hat_sigma_m
    return prior


def _filter_model(window_s: float, ticks: int, settings: Estimation) -> FilterModel:
    model = FilterModel()
    model.tick_s, model.decision_s = window_s / ticks, window_s
    model.rest_s, model.odometry_scale = settings.rest_s, settings.odometry_noise_scale
    model.slip_position, model.slip_heading = settings.slip_position_m_rts, settings.slip_heading_rad_rts
    return model


def _prior(settings: Estimation) -> Prior:
    prior = Prior()
    prior.position, prior.height = settings.start_position_m, settings.start_height_m
    prior.yaw, prior.tilt = settings.start_yaw_rad, settings.start_tilt_rad
    return prior

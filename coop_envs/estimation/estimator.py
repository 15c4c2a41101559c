"""`TeamEstimator`: measurements and commands in, belief and map out; the same on robots and in simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.command import Command
from coop_envs.agents.team import Team
from coop_envs.estimation.charting import chart, chart_rays
from coop_envs.estimation.declaring import StuckModel, declare
from coop_envs.estimation.ranging import GAP_GATE, Points, RangingModel, find_range
from coop_envs.estimation.settings import Estimation, Rates
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.geometry.arrays import allocate
from coop_envs.mapping.ground_map import MapModel, allocate_map, begin_map
from coop_envs.sensing.measurements import Measurements


@dataclass(frozen=True)
class Plan:
    """What people know when they set a batch of teams down: poses in each team's frame and where its map lies.

    start (B, N, 3) and dock (B, 3) x, y, yaw; goal (B, 4) x, y, radius, 1 if there is one. The map
    has ``cells`` (B, 2) from its lower ``corner`` (B, 2).
    """

    start: NDArray[np.float32]
    dock: NDArray[np.float32]
    goal: NDArray[np.float32]
    corner: NDArray[np.float32]
    cells: NDArray[np.int32]


class TeamEstimator:
    """Beliefs and maps of B teams of the same robots; launches are recorded once and replayed.

    It reads ``measurements`` and ``command``, and steps the teams whose ``running`` (B,) is 1.
    """

    def __init__(
        self,
        team: Team,
        rates: Rates,
        settings: Estimation,
        map_model: MapModel,
        measurements: Measurements,
        command: Command,
        running: wp.array,
        device: str,
    ) -> None:
        teams, n = running.shape[0], len(team.members)
        self.device, self.teams, self._decision_s = device, teams, rates.decision_s
        self.filter = TeamFilter(team, settings, measurements, command, device, running)
        self.members, self.belief, self.plans = self.filter.members, self.filter.belief, self.filter.plans
        self.chosen = self.filter.chosen
        reach_m = map_model.mark_radius + max(map_model.mark_radius, *(m.robot.body_radius_m for m in team.members))
        scanning = map_model.levels > 0
        swept = _swept_cells(team, rates, map_model) if scanning else 0
        self.map = allocate_map(teams, n, map_model, reach_m, device, swept)
        self.points: Points = allocate(Points, (teams, rates.ticks_per_decision), device)
        self.corner, self.cells = (wp.zeros(teams, dtype=kind, device=device) for kind in (wp.vec2, wp.vec2i))
        seen = [self.belief, measurements, self.members]
        self._launches = [
            self._record(declare, [*seen, _stuck_model(rates, settings), running]),
            self._record(chart, [self.belief, self.map, self.members, map_model, running]),
        ]
        box = [self.corner, self.cells, self.plans.start, settings.start_ground_m]
        self._begin_map = self._record(begin_map, [self.map, map_model, *box, self.chosen])
        if scanning:
            told = [self.belief, measurements, command, self.members]
            ranged = [
                *told,
                self.filter.optics.cameras,
                _ranging_model(team, settings),
                self.filter.rows,
                self.points,
                running,
            ]
            charted = [self.belief, self.map, self.members, self.points, map_model, running]
            self._launches += [self._record(find_range, ranged), self._record(chart_rays, charted)]

    def _record(self, kernel: wp.Kernel, inputs: list[object]) -> wp.Launch:
        return wp.launch(kernel, self.teams, inputs=inputs, device=self.device, record_cmd=True)

    def reset(self, chosen: NDArray[np.int32], plan: Plan) -> None:
        """Start the beliefs and maps of the teams with ``chosen`` 1 (B,) anew."""
        self.plans.start.assign(plan.start)
        self.plans.dock.assign(plan.dock)
        self.plans.goal.assign(plan.goal)
        self.corner.assign(plan.corner)
        self.cells.assign(plan.cells)
        self.chosen.assign(chosen)
        self.begin()

    def begin(self) -> None:
        """Start the teams with ``chosen`` 1 anew, by ``plans``, ``corner`` and ``cells``."""
        self.filter.begin()
        self._begin_map.launch()

    def step(self) -> None:
        """Take in one decision's measurements and the command under which they were made."""
        self.filter.step(self._decision_s)
        for launch in self._launches:
            launch.launch()


def _stuck_model(rates: Rates, settings: Estimation) -> StuckModel:
    model = StuckModel()
    model.stuck_s, model.silent_s, model.decision_s = settings.stuck_s, settings.silent_s, rates.decision_s
    return model


def _ranging_model(team: Team, settings: Estimation) -> RangingModel:
    model = RangingModel()
    model.limits.max_range = max(member.camera.max_range_m for member in team.members if member.camera)
    model.limits.gap_gate, model.limits.max_sigma = GAP_GATE, settings.point_sigma_m
    model.focal_sigma, model.centre_sigma = settings.focal_sigma, settings.centre_sigma_px
    return model


def _swept_cells(team: Team, rates: Rates, model: MapModel) -> int:
    """The most cells that one decision's rays, two a tick, can change, and the columns that are judged for it.

    In each slice a square of cells is tried; a ray changes those above it and within its radius, less than half of
    them, which leaves as much for the columns.
    """
    reach = max(member.camera.max_range_m for member in team.members if member.camera) / model.cell
    across = (math.floor(2.0 * max(model.sweep / model.cell, 0.5) * math.sqrt(3.0)) + 1) ** 2
    return 2 * rates.ticks_per_decision * math.ceil(reach + 2.0) * across

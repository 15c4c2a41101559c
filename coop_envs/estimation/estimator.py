"""`TeamEstimator`: measurements and commands in, belief and map out; the same on robots and in simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.command import Command
from coop_envs.agents.team import Team
from coop_envs.estimation.belief import LOST, WORKING, Belief, MemberModel, allocate_belief, member_models
from coop_envs.estimation.correction import fuse
from coop_envs.estimation.declaring import StuckModel, declare, position_sigma
from coop_envs.estimation.joining import Prior, begin
from coop_envs.estimation.propagation import FilterModel, propagate
from coop_envs.mapping.ground_map import Footprint, GroundMap, MapModel, allocate_map, clear_map, draw_footprint
from coop_envs.sensing.measurements import Measurements

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

PROVING_S = wp.constant(1.0)


@dataclass(frozen=True)
class Plan:
    """What people know when they set a batch of teams down: poses in each team's frame and where its map lies.

    start (B, N, 3) and dock (B, 3) x, y, yaw; goal (B, 4) x, y, radius, 1 if there is one; corner (B, 2) of the map.
    """

    start: NDArray[np.float32]
    dock: NDArray[np.float32]
    goal: NDArray[np.float32]
    corner: NDArray[np.float32]


@wp.kernel
def chart(
    belief: Belief,
    ground: GroundMap,
    members: wp.array(dtype=MemberModel),
    model: MapModel,
    running: wp.array(dtype=int),
):
    """Enter every robot of the running teams into their maps."""
    b = wp.tid()
    ground.change_count[b] = 0
    if running[b] == 0:
        return
    for r in range(members.shape[0]):
        foot = Footprint()
        p = belief.position[b, r]
        foot.x = float(p[0])
        foot.y = float(p[1])
        foot.sigma = position_sigma(belief, b, r)
        foot.contact_radius = members[r].contact_radius
        foot.body_radius = members[r].body_radius
        working = belief.declared[b, r] == WORKING and belief.silent_s[b, r] == 0.0
        foot.proves = int(working and belief.tried_s[b, r] < PROVING_S)
        foot.marks = int(belief.declared[b, r] == LOST and belief.marked[b, r] == 1)
        draw_footprint(ground, model, b, r, foot)


class TeamEstimator:
    """Beliefs and maps of B teams of the same robots; launches are recorded once and replayed."""

    def __init__(
        self,
        team: Team,
        measurements: Measurements,
        command: Command,
        filter_model: FilterModel,
        stuck_model: StuckModel,
        map_model: MapModel,
        prior: Prior,
        running: wp.array,
        teams: int,
        device: str,
    ) -> None:
        n = len(team.members)
        self.device, self.teams, self.map_model = device, teams, map_model
        self.members = member_models(team, device)
        self.belief = allocate_belief(team, teams, device)
        reach_m = map_model.mark_radius + max(member.robot.body_radius_m for member in team.members)
        self.map = allocate_map(teams, n, map_model, reach_m, device)
        self.prior = prior
        self.prior.start = wp.zeros((teams, n), dtype=wp.vec3, device=device)
        self.prior.dock = wp.zeros(teams, dtype=wp.vec3, device=device)
        self.prior.goal = wp.zeros(teams, dtype=wp.vec4, device=device)
        self.running = running
        rows = wp.zeros((teams, 6, self.belief.covariance.shape[1]), dtype=wp.float64, device=device)
        believed, seen = [self.belief], [self.belief, measurements]
        inputs = [*believed, command, measurements, self.prior, self.members, filter_model, self.running]
        self._launches = [
            self._record(propagate, inputs),
            self._record(fuse, [*seen, self.members, filter_model, rows, self.running]),
            self._record(declare, [*seen, self.members, stuck_model, self.running]),
            self._record(chart, [*believed, self.map, self.members, map_model, self.running]),
        ]

    def _record(self, kernel: wp.Kernel, inputs: list[object]) -> wp.Launch:
        return wp.launch(kernel, self.teams, inputs=inputs, device=self.device, record_cmd=True)

    def reset(self, chosen: NDArray[np.int32], plan: Plan) -> None:
        """Start the beliefs and maps of the teams with ``chosen`` 1 (B,) anew."""
        self.prior.start.assign(plan.start)
        self.prior.dock.assign(plan.dock)
        self.prior.goal.assign(plan.goal)
        mask = wp.array(chosen, dtype=int, device=self.device)
        corner = wp.array(plan.corner, dtype=wp.vec2, device=self.device)
        wp.launch(begin, self.teams, inputs=[self.belief, self.prior, self.members, mask], device=self.device)
        wp.launch(clear_map, self.teams, inputs=[self.map, corner, mask], device=self.device)

    def step(self) -> None:
        """Take in one decision's measurements and the command under which they were made."""
        for launch in self._launches:
            launch.launch()

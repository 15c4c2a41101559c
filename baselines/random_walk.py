"""Random walk: pickets alternate right, forward, left and backward for random times at constant speeds.

Source: thesis 2.2.3.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from baselines.atlas import Atlas
from baselines.driving import Drive, PathFollower, ScoutDriver
from baselines.expedition import Expedition
from baselines.prospect import Prospect, scouting_way
from baselines.team_view import RobotView, TeamView
from coop_envs.agents.team import Member
from coop_envs.mapping.planning import Footprint
from coop_envs.policy import Actions, Observations, TeamDescription, TeamNeeds

PHASES = ("right", "forward", "left", "backward")
TURN_S, DRIVE_S = (0.2, 0.6), (0.4, 2.0)  # least and most time of a phase
OUT_OF_VIEW_S, HOME_M = 1.0, 0.40
LOOK_AHEAD_M = 0.12
STUCK_HERE = 20  # P(ground carries robots) in 255ths up to which a robot was stuck right there
LOOKAHEAD_M, DETOUR_M, OFF_M = 0.06, 0.5, 0.06


class RandomWalk:
    """The thesis's random walk, then the observer's crossing."""

    name = "random_walk"
    needs = TeamNeeds(cameras=1, hats=1)

    def reset(self, team: TeamDescription, seed: int) -> None:
        self._expedition = Expedition(team, WalkScouting(team, seed), seed)

    def act(self, observations: Observations) -> Actions:
        return self._expedition.act(observations)


class WalkScouting:
    """Four phases for each picket, each for a uniformly random time.

    Beyond the thesis: (1) a picket that has been out of view for ``OUT_OF_VIEW_S`` drives back over known ground to
    before the observer (the thesis's pickets stay in view by assumption); (2) a phase ends before ground on which a
    robot got stuck, so that pickets are not lost at the very same place again.
    """

    def __init__(self, team: TeamDescription, seed: int) -> None:
        rngs = np.random.default_rng([seed, 1]).spawn(2 * len(team.names))
        members = dict(zip(team.names, team.members, strict=True))
        self._decision_s = team.decision_s
        self._walks = {n: Walk(m, team.decision_s, rng) for (n, m), rng in zip(members.items(), rngs[::2], strict=True)}
        self._drivers = {
            n: ScoutDriver(m, team.decision_s, rng) for (n, m), rng in zip(members.items(), rngs[1::2], strict=True)
        }
        self._footprints = {n: Footprint(m.robot.contact_radius_m, m.robot.body_radius_m) for n, m in members.items()}
        self._unseen_s = dict.fromkeys(team.names, 0.0)
        self._way_home: dict[str, PathFollower] = {}

    def command(
        self,
        view: TeamView,
        atlas: Atlas,
        prospect: Prospect | None,  # noqa: ARG002  a random walk looks for nothing
    ) -> dict[str, Drive]:
        """One drive for each scout."""
        return {scout.name: self._drive(scout, view.leader, atlas) for scout in view.scouts}

    def move_on(self) -> None:
        """A random walk keeps nothing of where it has been."""

    def _drive(self, scout: RobotView, leader: RobotView, atlas: Atlas) -> Drive:
        self._unseen_s[scout.name] = 0.0 if scout.in_view else self._unseen_s[scout.name] + self._decision_s
        if self._unseen_s[scout.name] >= OUT_OF_VIEW_S:
            return self._go_home(scout, leader, atlas)
        self._way_home.pop(scout.name, None)
        walk = self._walks[scout.name]
        drive = walk.step()
        if drive.forward_m_s and self._hazard_ahead(scout, math.copysign(LOOK_AHEAD_M, drive.forward_m_s), atlas):
            drive = walk.next_phase()
        return drive

    def _go_home(self, scout: RobotView, leader: RobotView, atlas: Atlas) -> Drive:
        driver, way = self._drivers[scout.name], self._way_home.get(scout.name)
        if way is None or driver.blocked or way.off_m > OFF_M:
            home = (leader.x + HOME_M * math.cos(leader.yaw), leader.y + HOME_M * math.sin(leader.yaw))
            survey = atlas.survey_around([scout.xy, home], DETOUR_M)
            way = PathFollower(scouting_way(survey, scout.xy, home, self._footprints[scout.name], None), LOOKAHEAD_M)
            self._way_home[scout.name] = way
        return driver.go(scout, way.target(scout.xy))

    def _hazard_ahead(self, scout: RobotView, way_m: float, atlas: Atlas) -> bool:
        ahead = (scout.x + way_m * math.cos(scout.yaw), scout.y + way_m * math.sin(scout.yaw))
        return bool(atlas.at(np.array([ahead]))[0, 0] <= STUCK_HERE)


class Walk:
    """The endless sequence of one picket's drives."""

    def __init__(self, member: Member, decision_s: float, rng: np.random.Generator) -> None:
        speed, turn = member.cruise_speed_m_s, member.cruise_yaw_rate_rad_s
        self._phases = itertools.cycle((Drive(0.0, -turn), Drive(speed, 0.0), Drive(0.0, turn), Drive(-speed, 0.0)))
        self._decision_s, self._rng, self._left = decision_s, rng, 0

    def step(self) -> Drive:
        """The drive of the next decision."""
        if self._left == 0:
            return self.next_phase()
        self._left -= 1
        return self._drive

    def next_phase(self) -> Drive:
        """End the phase; the first drive of the next one."""
        self._drive = next(self._phases)
        least, most = DRIVE_S if self._drive.forward_m_s else TURN_S
        self._left = max(1, round(self._rng.uniform(least, most) / self._decision_s)) - 1
        return self._drive

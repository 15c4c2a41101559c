"""Random walk: pickets alternate right, forward, left and backward for random times at constant speeds.

Source: thesis 2.2.3.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from baselines.driving import Drive
from baselines.expedition import Expedition
from baselines.atlas import Atlas
from baselines.prospect import Prospect
from baselines.team_view import TeamView
from coop_envs.agents.team import Member
from coop_envs.policy import Actions, Observations, TeamDescription, TeamNeeds

PHASES = ("right", "forward", "left", "backward")
MIN_PHASE_S, MAX_PHASE_S = 0.4, 3.0


class RandomWalk:
    """The thesis's random walk, then the observer's crossing."""

    name = "random_walk"
    needs = TeamNeeds(cameras=1, hats=1)

    def reset(self, team: TeamDescription, seed: int) -> None:
        self._expedition = Expedition(team, WalkScouting(team, seed), seed)

    def act(self, observations: Observations) -> Actions:
        return self._expedition.act(observations)


class WalkScouting:
    """Four phases for each picket, each for a uniformly random time; what the robots meet changes nothing."""

    def __init__(self, team: TeamDescription, seed: int) -> None:
        rngs = np.random.default_rng([seed, 1]).spawn(len(team.names))
        self._walks = {
            name: walk(member, team.decision_s, rng)
            for name, member, rng in zip(team.names, team.members, rngs, strict=True)
        }

    def command(self, view: TeamView, atlas: Atlas, prospect: Prospect | None) -> dict[str, Drive]:
        """One drive for each scout."""
        return {scout.name: next(self._walks[scout.name]) for scout in view.scouts}

    def move_on(self) -> None:
        """A random walk keeps nothing of where it has been."""


def walk(member: Member, decision_s: float, rng: np.random.Generator) -> Iterator[Drive]:
    """The endless sequence of one picket's drives, one a decision."""
    speed, turn = member.cruise_speed_m_s, member.cruise_yaw_rate_rad_s
    drives = (Drive(0.0, -turn), Drive(speed, 0.0), Drive(0.0, turn), Drive(-speed, 0.0))
    for drive in itertools.cycle(drives):
        yield from itertools.repeat(drive, max(1, round(rng.uniform(MIN_PHASE_S, MAX_PHASE_S) / decision_s)))

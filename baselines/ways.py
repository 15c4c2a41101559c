"""What strategies of a survey are asked: who goes where, given where everybody stands and could get to."""

from __future__ import annotations

from typing import Protocol

from baselines.atlas import Survey
from baselines.next_view import Move
from baselines.rasters import Tries, Watcher
from baselines.scanned import ScannedRoutes, going
from coop_envs.mapping.planning import Disc

GAP_M = 0.03  # between two bodies


class Ways:
    """Where the robots stand and how each could get about on ground seen free, worked out when asked for.

    Routes keep clear of mates; observers rather go where robots have been.
    """

    def __init__(self, watchers: list[Watcher], survey: Survey, trusted: tuple[Disc, ...]) -> None:
        self.watchers, self.survey, self.trusted = watchers, survey, trusted
        self._routes: dict[str, ScannedRoutes] = {}

    def routes(self, mover: Watcher) -> ScannedRoutes:
        """All ways of a robot."""
        name = mover.robot.name
        if name not in self._routes:
            others = tuple(
                (*other.robot.xy, mover.member.robot.body_radius_m + other.member.robot.body_radius_m + GAP_M)
                for other in self.watchers
                if other is not mover
            )
            go = going(mover.member, self.survey.grid.cell_m, self.trusted, self.survey.losses)
            self._routes[name] = ScannedRoutes(self.survey, mover.robot.xy, go, others)
        return self._routes[name]


class Strategy(Protocol):
    """Which robot goes where."""

    def choose(self, ways: Ways, tries: Tries, last: str | None) -> Move | None:
        """The next move; None when there is nothing left to gain. ``last`` is who moved last."""
        ...

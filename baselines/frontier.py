"""Frontier: robots take turns to go to the nearest edge between ground seen free and unknown ground, and scan there.

Source: Yamauchi, "A frontier-based approach for autonomous exploration", 1997; nearest first, by the way to get there.
"""

from __future__ import annotations

import math

import numpy as np

from baselines.atlas import Point, Survey
from baselines.common_view import GOOD_PARALLAX, GROUND_RANGE_M, hidden, parallax
from baselines.next_view import Move
from baselines.rasters import Tries, Watcher
from baselines.scanned import ScannedRoutes, frontier
from baselines.surveying import Surveying
from baselines.ways import Ways
from coop_envs.mapping.planning import Points
from coop_envs.policy import Actions, Observations, TeamDescription, TeamNeeds

AWAY_M = 0.4  # how far from the frontier a robot may stop: cameras do not see what is right before them
NEIGHBOURS = 32  # frontier cells near a place that are looked at
BESIDE_M = 0.2  # what lies so near to a frontier counts as tried with it
HOPEFUL = 0.1  # a frontier that was aimed at so often that less of its worth is left is given up


class Frontier:
    """Nearest-frontier exploration for teams that scan."""

    name = "frontier"
    needs = TeamNeeds(cameras=2, hats=2, lasers=1)

    def reset(self, team: TeamDescription, seed: int) -> None:
        self._surveying = Surveying(team, NearestFrontier(), seed)

    def act(self, observations: Observations) -> Actions:
        return self._surveying.act(observations)


class NearestFrontier:
    """Sends one robot after the other, in the team's order, to the frontier nearest to it.

    With ``pickets_first`` observers only go where no picket has anywhere to go.
    """

    def __init__(self, pickets_first: bool = False) -> None:
        self._pickets_first = pickets_first
        self._visits = Tries()

    def choose(self, ways: Ways, tries: Tries, last: str | None) -> Move | None:  # noqa: ARG002  it counts its own visits
        """The next robot's move to its nearest frontier; if it has none, the next one's."""
        names = [watcher.robot.name for watcher in ways.watchers]
        after = names.index(last) + 1 if last in names else 0
        mask = frontier(ways.survey, ways.trusted)
        edge, shown = ways.survey.grid.centres(mask), ways.survey.shown[mask] > 0
        hopeful = self._visits.worth(edge) > HOPEFUL
        edge, shown = edge[hopeful], shown[hopeful]
        movers = [*ways.watchers[after:], *ways.watchers[:after]]
        if self._pickets_first:
            movers.sort(key=lambda mover: mover.member.role == "observer")
        for mover in movers:
            found = nearest(ways.routes(mover), mover, edge[shown], edge[~shown])
            if found is not None:
                self._visits.add(self._visits.around(found[1], BESIDE_M), 1.0)
                return self._to(*found, mover, ways)
        self._visits.forget()
        return None

    def _to(self, path: Points | None, target: Point, mover: Watcher, ways: Ways) -> Move:
        stand = mover.robot.xy if path is None else (float(path[-1, 0]), float(path[-1, 1]))
        partner = best_partner([w for w in ways.watchers if w is not mover], stand, target, ways.survey)
        headings = direction(stand, target), direction(partner.robot.xy, target)
        return Move(mover.robot.name, path, headings[0], partner.robot.name, headings[1], 0.0, np.array([target]))


def nearest(routes: ScannedRoutes, mover: Watcher, known: Points, beyond: Points) -> tuple[Points | None, Point] | None:
    """The way (None: none needed) to the nearest frontier cell, and the cell.

    Of ``known`` (k, 2) cells it stops a little before; those ``beyond`` (m, 2) what was ever shown have to be neared.
    """
    from scipy.spatial import KDTree

    nodes = np.argwhere(np.isfinite(routes.cost_m))
    stands = np.vstack([[mover.robot.xy], routes.positions(nodes)])
    cost_m = np.array([0.0, *routes.cost_m[tuple(nodes.T)]])
    best: tuple[float, int, Point] | None = None  # cost, number of the stand, cell
    near_m = mover.member.robot.body_radius_m + 3.0 * routes.grid.cell_m
    for edge, least_m, most_m in ((known, mover.sector.nearest_m, AWAY_M), (beyond, 0.0, near_m)):
        if len(edge):
            found = KDTree(edge).query(stands, min(NEIGHBOURS, len(edge)), distance_upper_bound=most_m)
            distance, which = (np.asarray(part).reshape(len(stands), -1) for part in found)
            fits = (distance > least_m) & np.isfinite(distance)
            total = np.where(fits.any(axis=1), cost_m, np.inf)
            k = int(np.argmin(total))
            if np.isfinite(total[k]) and (best is None or total[k] < best[0]):
                x, y = edge[which[k, int(np.argmax(fits[k]))]].tolist()
                best = (float(total[k]), k, (x, y))
    if best is None:
        return None
    _, k, target = best
    if k == 0:
        return None, target
    return routes.path_to((int(nodes[k - 1, 0]), int(nodes[k - 1, 1]))), target


def best_partner(others: list[Watcher], stand: Point, target: Point, survey: Survey) -> Watcher:
    """The mate that sees the target, from another side than a robot at ``stand`` if possible, and then the nearest."""

    def unfit(other: Watcher) -> tuple[bool, bool, float]:
        place, points = np.array([other.robot.xy]), np.array([target])
        away_m = math.dist(other.robot.xy, target)
        out = away_m > GROUND_RANGE_M or away_m < other.sector.nearest_m or bool(hidden(survey.grid, place, points))
        flat = float(parallax(place, np.array(stand), points)[0, 0]) < GOOD_PARALLAX
        return out, flat, away_m

    return min(others, key=unfit)


def direction(start: Point, end: Point) -> float:
    """Direction (team frame) from one point to another."""
    return math.atan2(end[1] - start[1], end[0] - start[0])

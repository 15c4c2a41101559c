"""Probabilistic goal grid: pickets are sent to random places in the observer's view; failures make places rarer.

Source: thesis 2.2.3, algorithms 2.1 and 2.2. Algorithm 2.2 is printed with a counter that never counts and calls the
cumulative distribution a pdf; here the cumulative distribution is searched.

Beyond the thesis: (1) the atlas scales a cell's probability (known hazards and obstacles by ``HAZARD_SHARE``, ground
near a lost robot by its suspicion, proven ground by ``PROVEN_SHARE``, and by a half for each failure to get there),
so time goes to unknown ground; (2) if the task names a goal, only cells that the observer's way there would need are
drawn while there are any in view; (3) a goal lies anywhere in its cell, not at its centre; (4) pickets travel over
proven and needed ground as far as it leads, slowly where it is not proven; (5) a try ends when the picket is blocked,
and a goal also fails when its time is up or its picket is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.atlas import Atlas, Point
from baselines.bumping import note_bump
from baselines.driving import SAMPLE_M, Drive, PathFollower, ScoutDriver
from baselines.expedition import Expedition
from baselines.ground_view import GroundView
from baselines.prospect import Prospect, scouting_way, suspicion
from baselines.team_view import RobotView, TeamView
from baselines.vantage import RANGE_M
from coop_envs.mapping.planning import BLOCKED, HAZARD, PROVEN, Footprint
from coop_envs.policy import Actions, Observations, TeamDescription, TeamNeeds

ROWS, COLUMNS = 12, 16
NEAR_ENOUGH_M = 0.05  # epsilon of algorithm 2.1
TRIES = 2  # T of algorithm 2.1
EDGE_PX = 24.0
HAZARD_SHARE, PROVEN_SHARE = 0.02, 0.1
EXACTLY_M, INWARD_M = 0.015, 0.02
CAREFUL, CAREFUL_M = 0.5, 0.25  # of the cruise speed, over ground that is not proven or this near to a lost robot
LOOKAHEAD_M, DETOUR_M = 0.06, 0.5
OFF_M = 0.06  # off its way by more, something keeps a picket from it


class GoalGrid:
    """The thesis's probabilistic exploration, then the observer's crossing."""

    name = "goal_grid"
    needs = TeamNeeds(cameras=1, hats=1)

    def reset(self, team: TeamDescription, seed: int) -> None:
        self._expedition = Expedition(team, GridScouting(team, seed), seed)

    def act(self, observations: Observations) -> Actions:
        return self._expedition.act(observations)


class CameraGrid:
    """An N x M grid over the part of the image that shows ground within range, with a probability for each cell.

    ``probability`` (N * M,) sums to 1, row by row from the top.
    """

    def __init__(self, view: GroundView, range_m: float = RANGE_M, rows: int = ROWS, columns: int = COLUMNS) -> None:
        camera = view.camera
        self.probability = np.full(rows * columns, 1.0 / (rows * columns))
        top = max(EDGE_PX, view.row_of(min(range_m, camera.max_range_m)))
        self._corner = np.array([EDGE_PX, top])
        extent = np.array([camera.width_px - EDGE_PX, camera.height_px - EDGE_PX]) - self._corner
        self._size = extent / (columns, rows)
        self._columns, self._view = columns, view
        self.centres = self.ground_of(np.arange(rows * columns), np.full((rows * columns, 2), 0.5))

    def pixels_of(self, cells: NDArray[np.intp], places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels (k, 2) at places (k, 2), 0..1 each way, within cells (k,)."""
        row, column = np.divmod(cells, self._columns)
        return self._corner + (np.stack([column, row], axis=-1) + places) * self._size

    def ground_of(self, cells: NDArray[np.intp], places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Ground points (k, 2), forward and left of the observer, likewise."""
        return self._view.to_ground(self.pixels_of(cells, places))

    def cells_of(self, points: NDArray[np.float64]) -> NDArray[np.intp]:
        """The cell (k,) in which the observer sees each ground point (k, 2), -1 where out of view.

        What lies too near for the image counts to the bottom row: the hat of a robot there is seen all the same.
        """
        place = (self._view.to_pixels(points) - self._corner) / self._size
        rows = len(self.probability) // self._columns
        seen = (place[:, 0] >= 0) & (place[:, 0] < self._columns) & (place[:, 1] >= 0)
        column, row = np.where(seen[:, None], place, 0.0).astype(np.intp).T
        return np.where(seen, np.minimum(row, rows - 1) * self._columns + column, -1)

    def failed(self, cell: int) -> None:
        """Halve a cell's probability and renormalise."""
        self.probability[cell] *= 0.5
        self.probability /= self.probability.sum()


def assign_goal(weights: NDArray[np.float64], uniform: float) -> int:
    """The first cell whose cumulative share of the weights reaches a number drawn from [0, 1). Algorithm 2.2."""
    cumulative = np.cumsum(weights)
    return min(int(np.searchsorted(cumulative, uniform * cumulative[-1], side="right")), len(weights) - 1)


@dataclass
class Errand:
    """One picket on its way: the grid's cell, what is to be proven, where to go for it, its way, tries and time left.

    ``near_m`` is how near to ``goal`` counts as there.
    """

    cell: int
    target: Point
    goal: Point
    near_m: float
    route: PathFollower
    decisions_left: int
    tries: int = 0


class GridScouting:
    """Algorithm 2.1 for every picket at once, on one grid."""

    def __init__(self, team: TeamDescription, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 2])
        self._team, self._view = team, GroundView(team.members[0])
        self._members = dict(zip(team.names, team.members, strict=True))
        self._drivers = {
            name: ScoutDriver(member, team.decision_s, rng)
            for (name, member), rng in zip(self._members.items(), self._rng.spawn(len(team.names)), strict=True)
        }
        touch_m = min(member.robot.contact_radius_m for member in team.members)
        self._scatter_m = max(0.0, 0.5 * (team.cell_m - touch_m))
        self._errands: dict[str, Errand] = {}
        self.grid = CameraGrid(self._view)

    def move_on(self) -> None:
        """Forget the grid: the observer looks at other ground now."""
        self.grid = CameraGrid(self._view)
        self._errands.clear()

    def command(self, view: TeamView, atlas: Atlas, prospect: Prospect | None) -> dict[str, Drive]:
        """One drive for each scout."""
        self._write_off({scout.name for scout in view.scouts}, atlas)
        return {scout.name: self._pursue(scout, view, atlas, prospect) for scout in view.scouts}

    def _write_off(self, live: set[str], atlas: Atlas) -> None:
        for name in [name for name in self._errands if name not in live]:
            self._fail(self._errands.pop(name), atlas)

    def _fail(self, errand: Errand, atlas: Atlas) -> None:
        self.grid.failed(errand.cell)
        atlas.failed(errand.target)

    def _pursue(self, scout: RobotView, view: TeamView, atlas: Atlas, prospect: Prospect | None) -> Drive:
        errand = self._errands.get(scout.name)
        if errand is None or self._ended(scout, errand, atlas):
            errand = self._errands[scout.name] = self._assign(scout, view, atlas, prospect)
        driver = self._drivers[scout.name]
        proven = atlas.at(np.array([scout.xy]))[0, 0] >= PROVEN
        near_loss = any(scout.distance_to(loss) < CAREFUL_M for loss in atlas.losses)
        aim = errand.route.target(scout.xy)
        drive = driver.go(scout, aim, 1.0 if proven and not near_loss else CAREFUL)
        errand.decisions_left -= 1
        if driver.blocked or errand.route.off_m > OFF_M:
            errand.tries += 1
            note_bump(scout, aim, self._members[scout.name].robot.body_radius_m, view.bodies, atlas)
            errand.route = self._route(scout, errand.goal, atlas, prospect)
        return drive

    def _ended(self, scout: RobotView, errand: Errand, atlas: Atlas) -> bool:
        """Whether an errand is over; failures are entered."""
        proven = atlas.at(np.array([errand.target]))[0, 0] >= PROVEN
        there = scout.distance_to(errand.goal) < errand.near_m
        if there and (proven or errand.near_m == NEAR_ENOUGH_M or self._scatter_m > EXACTLY_M):
            return True
        if not there and errand.tries < TRIES and errand.decisions_left > 0:
            return False
        self._fail(errand, atlas)
        return True

    def _assign(self, scout: RobotView, view: TeamView, atlas: Atlas, prospect: Prospect | None) -> Errand:
        drawn = None if prospect is None else self._draw_needed(view.leader, atlas, prospect)
        near_m = NEAR_ENOUGH_M if drawn is None else EXACTLY_M
        cell, target, goal = drawn or self._draw(view.leader, atlas)
        route = self._route(scout, goal, atlas, prospect)
        speed = CAREFUL * self._members[scout.name].cruise_speed_m_s
        time_s = 4.0 + 1.5 * SAMPLE_M * len(route.points) / speed
        return Errand(cell, target, goal, near_m, route, math.ceil(time_s / self._team.decision_s))

    def _draw(self, leader: RobotView, atlas: Atlas) -> tuple[int, Point, Point]:
        """A cell of the grid and a point in it, twice: to be proven, and to go to."""
        cell = assign_goal(self.grid.probability * self._shares(leader, atlas), self._rng.random())
        x, y = _from_body(leader, self.grid.ground_of(np.array([cell]), self._rng.random((1, 2))))[0].tolist()
        return cell, (x, y), (x, y)

    def _draw_needed(self, leader: RobotView, atlas: Atlas, prospect: Prospect) -> tuple[int, Point, Point] | None:
        """A cell of the grid with needed ground, one such place, and where to go to prove it; None if none is in view.

        To prove ground beside the observer's way a picket goes a little nearer to the way than that, and no robot
        comes nearer to what may lie beyond than the observer would. Cells wider than a robot's touch are proven bit by
        bit: goals are scattered over them.
        """
        cells = self.grid.cells_of(_to_body(leader, prospect.needed))
        weight = np.where(cells >= 0, np.exp2(-atlas.at(prospect.needed)[2].astype(float)), 0.0)
        if not weight.any():
            return None
        share = np.bincount(cells[cells >= 0], weight[cells >= 0], len(self.grid.probability)).astype(np.float64)
        cell = assign_goal(self.grid.probability * share, self._rng.random())
        here = np.where(cells == cell, weight, 0.0)
        place = prospect.needed[assign_goal(here, self._rng.random())]
        offset = prospect.way[np.argmin(np.hypot(*(prospect.way - place).T))] - place
        goal = place + offset * min(1.0, INWARD_M / max(float(np.hypot(*offset)), 1e-9))
        goal += self._scatter_m * self._rng.uniform(-1.0, 1.0, 2)
        return cell, (float(place[0]), float(place[1])), (float(goal[0]), float(goal[1]))

    def _route(self, scout: RobotView, goal: Point, atlas: Atlas, prospect: Prospect | None) -> PathFollower:
        survey = atlas.survey_around([scout.xy, goal], DETOUR_M)
        robot = self._members[scout.name].robot
        footprint = Footprint(robot.contact_radius_m, robot.body_radius_m)
        return PathFollower(scouting_way(survey, scout.xy, goal, footprint, prospect), LOOKAHEAD_M)

    def _shares(self, leader: RobotView, atlas: Atlas) -> NDArray[np.float64]:
        """By how much (N * M,) the atlas scales each cell's probability."""
        places = _from_body(leader, self.grid.centres)
        ground, obstacle, doubt, bumps = atlas.at(places)
        shares = np.where(ground >= PROVEN, PROVEN_SHARE, np.exp2(-doubt.astype(float)))
        shares /= suspicion(places, atlas.losses)
        shares[(ground <= HAZARD) | (np.maximum(obstacle, bumps) >= BLOCKED)] = HAZARD_SHARE
        return shares


def _from_body(robot: RobotView, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Team-frame points (k, 2) of points forward and left of a robot."""
    c, s = math.cos(robot.yaw), math.sin(robot.yaw)
    return points @ np.array([[c, s], [-s, c]]) + robot.xy


def _to_body(robot: RobotView, points: NDArray[np.float64]) -> NDArray[np.float64]:
    c, s = math.cos(robot.yaw), math.sin(robot.yaw)
    return (points - robot.xy) @ np.array([[c, -s], [s, c]])

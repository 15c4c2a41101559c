"""Probabilistic goal grid: pickets are sent to random places in the observer's view; failures make places rarer.

Source: thesis 2.2.3, algorithms 2.1 and 2.2. Algorithm 2.2 is printed with a counter that never counts and calls the
cumulative distribution a pdf; here the cumulative distribution is searched.

Beyond the thesis: (1) the atlas scales a cell's probability (hazards, obstacles and places where a picket bumped into
something by ``HAZARD_SHARE``, proven ground by ``PROVEN_SHARE``), so time goes to unknown ground; (2) if the task names
a goal, cells off the way there count less, by a factor e for each ``DETOUR_M``; (3) a picket's goal lies anywhere in its
cell, not at its centre; (4) pickets travel over proven ground as far as it leads; (5) a try ends when the picket is
blocked, and a goal also fails when its time is up or its picket is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.atlas import Atlas
from baselines.driving import Drive, PathFollower, ScoutDriver
from baselines.expedition import Expedition
from baselines.ground_view import GroundView
from baselines.team_view import RobotView, TeamView
from coop_envs.mapping.planning import BLOCKED, HAZARD, PROVEN, scouting_path
from coop_envs.policy import Actions, Observations, TeamDescription, TeamNeeds

ROWS, COLUMNS = 12, 16
NEAR_ENOUGH_M = 0.05  # epsilon of algorithm 2.1
TRIES = 2  # T of algorithm 2.1
RANGE_M = 1.2
EDGE_PX = 24.0
HAZARD_SHARE, PROVEN_SHARE = 0.02, 0.1
DETOUR_M = 0.15
ROBOT_M = 0.12  # a bump this near a robot's centre is the robot


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
    """One picket on its way: the grid's cell, the goal (team frame), its way there, tries and time left."""

    cell: int
    goal: tuple[float, float]
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
        self._errands: dict[str, Errand] = {}
        self.grid = CameraGrid(self._view)

    def move_on(self) -> None:
        """Forget the grid: the observer looks at other ground now."""
        self.grid = CameraGrid(self._view)
        self._errands.clear()

    def command(self, view: TeamView, atlas: Atlas) -> dict[str, Drive]:
        """One drive for each scout."""
        self._write_off({scout.name for scout in view.scouts})
        return {scout.name: self._pursue(scout, view, atlas) for scout in view.scouts}

    def _write_off(self, live: set[str]) -> None:
        for name in [name for name in self._errands if name not in live]:
            self.grid.failed(self._errands.pop(name).cell)

    def _pursue(self, scout: RobotView, view: TeamView, atlas: Atlas) -> Drive:
        errand = self._errands.get(scout.name)
        if errand is None or self._ended(scout, errand):
            errand = self._errands[scout.name] = self._assign(scout, view, atlas)
        driver = self._drivers[scout.name]
        drive = driver.go(scout, errand.route.target(scout.xy))
        errand.decisions_left -= 1
        if driver.blocked:
            self._note_bump(scout, view, atlas)
            errand.tries += 1
            errand.route = self._route(scout, errand.goal, atlas)
        return drive

    def _note_bump(self, scout: RobotView, view: TeamView, atlas: Atlas) -> None:
        """Mark what stopped a picket, unless it is another robot."""
        x, y = _from_body(scout, np.array([[self._members[scout.name].robot.body_radius_m, 0.0]]))[0].tolist()
        others = [view.leader, *view.landmarks, *(other for other in view.scouts if other is not scout)]
        if all(math.hypot(x - other.x, y - other.y) > ROBOT_M for other in others):
            atlas.bump((x, y))

    def _ended(self, scout: RobotView, errand: Errand) -> bool:
        if scout.distance_to(errand.goal) < NEAR_ENOUGH_M:
            return True
        if errand.tries < TRIES and errand.decisions_left > 0:
            return False
        self.grid.failed(errand.cell)
        return True

    def _assign(self, scout: RobotView, view: TeamView, atlas: Atlas) -> Errand:
        weights = self.grid.probability * self._shares(view, atlas)
        cell = assign_goal(weights, self._rng.random())
        forward, left = self.grid.ground_of(np.array([cell]), self._rng.random((1, 2)))[0].tolist()
        goal = _from_body(view.leader, np.array([[forward, left]]))[0]
        route = self._route(scout, goal, atlas)
        speed = self._members[scout.name].cruise_speed_m_s
        time_s = 4.0 + 2.0 * 0.01 * len(route.points) / speed
        return Errand(cell, (float(goal[0]), float(goal[1])), route, math.ceil(time_s / self._team.decision_s))

    def _route(self, scout: RobotView, goal: tuple[float, float] | NDArray[np.float64], atlas: Atlas) -> PathFollower:
        ends = np.array([scout.xy, goal])
        atlas.include(ends)
        contact = self._members[scout.name].robot.contact_radius_m
        path = scouting_path(atlas.grid_with_bumps.crop(ends, 8 * atlas.cell_m), scout.xy, goal, contact)
        return PathFollower(path, lookahead_m=0.10)

    def _shares(self, view: TeamView, atlas: Atlas) -> NDArray[np.float64]:
        """By how much (N * M,) the atlas and the task's goal scale each cell's probability."""
        places = _from_body(view.leader, self.grid.centres)
        ground, obstacle = atlas.at(places)
        shares = np.where(ground >= PROVEN, PROVEN_SHARE, 1.0)
        shares[(ground <= HAZARD) | (obstacle >= BLOCKED)] = HAZARD_SHARE
        if view.goal is not None:
            way = np.hypot(*(places - view.leader.xy).T) + np.hypot(*(places - view.goal).T)
            shares *= np.exp((view.leader.distance_to(view.goal) - way) / DETOUR_M)
        return shares


def _from_body(robot: RobotView, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Team-frame points (k, 2) of points forward and left of a robot."""
    c, s = math.cos(robot.yaw), math.sin(robot.yaw)
    return points @ np.array([[c, s], [-s, c]]) + robot.xy

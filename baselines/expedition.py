"""The course of an exploration that all baselines share; only how pickets scout differs.

Pickets scout while the observer holds. As soon as a safe path to the goal is known, they go to posts along it and hold,
and the observer crosses. While there is none (or no goal) and the pickets prove nothing new, the observer turns, or
drives over proven ground, to where more unknown ground is in view. When the time for exploring is over and no path was
found, the team stays where it is.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.atlas import Atlas, Point
from baselines.bumping import note_bump
from baselines.crossing import Crossing, ObserverPlanner
from baselines.driving import STILL, Drive, PathFollower, ScoutDriver, action, turn_to
from baselines.ground_view import GroundView
from baselines.posting import choose_posts
from baselines.prospect import Prospect, scouting_costs, scouting_way
from baselines.team_view import TeamView, read_team, wrapped
from baselines.vantage import RANGE_M, best_heading, best_stand, worth_exploring
from coop_envs.mapping.planning import PROVEN, Footprint
from coop_envs.policy import Actions, Observations, TeamDescription

EXPLORE_SHARE = 0.9  # of the time limit, if there is a goal; a crossing takes the rest
CAUTIOUS_SHARE = 0.6  # of the time limit, in which ways keep well away from hazards
PLAN_EVERY_S = 2.0
IDLE_S, IDLE_AREA_M2 = 24.0, 0.015  # pickets that prove less in this time have finished here
BLIND_PLANS = 5  # plans with none of the needed ground in view after which the observer looks elsewhere
SEARCH_EVERY = 4  # plans between two searches for a path that the prospect does not promise
POST_S, POST_TRIES, BOLD_TRIES, POST_NEAR_M, POSTS_M, OFF_M = 20.0, 5, 3, 0.04, 0.1, 0.06
SETTLE_S, TURN_S, FACING_RAD, TURN_RAD_S = 3.0, 12.0, 0.05, 1.0
FACED, SIGHT_S = 0.8, 1.0
CROSS_S = 180.0

Drives = dict[str, Drive]
HOLD: Drives = {}


class Scouting(Protocol):
    """How pickets explore."""

    def command(self, view: TeamView, atlas: Atlas, prospect: Prospect | None) -> Drives:
        """One drive for each scout; the prospect is what the observer's way to the goal still needs."""
        ...

    def move_on(self) -> None:
        """The observer has moved: it sees other ground now."""
        ...


class Expedition:
    """One episode of one team. The course is a generator: each step yields the drives of one decision."""

    def __init__(self, team: TeamDescription, scouting: Scouting, seed: int) -> None:
        self.atlas = Atlas(team.cell_m)
        self._team, self._scouting = team, scouting
        self._members = dict(zip(team.names, team.members, strict=True))
        self._footprints = {
            name: Footprint(member.robot.contact_radius_m, member.robot.body_radius_m, margin_m=0.0)
            for name, member in self._members.items()
        }
        self._planner = ObserverPlanner(team)
        self._half_view_rad = GroundView(team.members[0]).half_width_rad
        self._rng = np.random.default_rng([seed, 3])
        self._stands: list[Point] = []
        self._headings: list[float] = []
        self._prospect: Prospect | None = None
        self._course = self._whole_course()

    def act(self, observations: Observations) -> Actions:
        """One action for each live agent."""
        drives = HOLD
        view = read_team(observations, self._team)
        if view is not None:
            self._view = view
            for robot in (view.leader, *view.scouts):
                self.atlas.add(robot.window_m, observations[robot.name]["map"])
            for mark in view.landmarks:
                if mark.lost:
                    self.atlas.lost(mark.xy)
            drives = next(self._course)
        return {name: action(drives.get(name, STILL), self._members[name]) for name in observations}

    def _whole_course(self) -> Iterator[Drives]:
        if self._view.goal is not None:
            yield from self._face(self._view.goal)
        arrived = False
        while not arrived and self._may_explore():
            yield from self._scout()
            if self._goal_path(among_scouts=False) is None:
                yield from self._advance()
            else:
                arrived = yield from self._reach_goal()
        if not arrived:
            self._planner.dare(True)
            yield from self._reach_goal()
        while True:
            yield HOLD

    def _may_explore(self) -> bool:
        """Whether there is time, and somebody to explore."""
        share = 1.0 if self._view.goal is None else EXPLORE_SHARE
        in_time = self._view.time_left_s > (1.0 - share) * self._team.time_limit_s
        return in_time and bool(self._view.scouts or self._view.reserves_left)

    def _decisions(self, seconds: float) -> range:
        return range(max(1, round(seconds / self._team.decision_s)))

    # Scouting

    def _scout(self) -> Iterator[Drives]:
        """Let pickets explore until a path to the goal is known, nothing new is proven, or time is up."""
        proven: list[int] = []
        blind = 0
        idle_plans = round(IDLE_S / PLAN_EVERY_S)
        while self._may_explore():
            self._prospect = self._planner.prospect(self._view, self.atlas)
            for _ in self._decisions(PLAN_EVERY_S):
                yield self._scouting.command(self._view, self.atlas, self._prospect)
            proven.append(int(np.count_nonzero(self.atlas.grid.ground >= PROVEN)))
            fresh = proven[-1] - proven[-1 - idle_plans] if len(proven) > idle_plans else np.inf
            idle = fresh * self._team.cell_m**2 < IDLE_AREA_M2 and not self._needs_what_it_sees()
            needs = self._prospect is not None and len(self._prospect.needed) > 0
            blind = blind + 1 if needs and not self._needs_what_it_sees() else 0
            if idle or blind >= BLIND_PLANS or self._may_cross(len(proven)):
                return

    def _needs_what_it_sees(self) -> bool:
        """Whether ground that the observer needs lies in its view."""
        if self._prospect is None:
            return False
        offset = self._prospect.needed - self._view.leader.xy
        bearing = np.arctan2(offset[:, 1], offset[:, 0]) - self._view.leader.yaw
        in_view = np.cos(bearing) > math.cos(self._half_view_rad)
        return bool(np.any(in_view & (np.hypot(offset[:, 0], offset[:, 1]) < RANGE_M)))

    def _may_cross(self, plans: int) -> bool:
        """Whether a path to the goal is known; looked for when it seems likely, else only now and then.

        When time gets short, nearness to hazards is dared.
        """
        likely = self._prospect is not None and not len(self._prospect.needed)
        if not likely and plans % SEARCH_EVERY:
            return False
        self._planner.dare(self._view.time_left_s < (1.0 - CAUTIOUS_SHARE) * self._team.time_limit_s)
        return self._goal_path(among_scouts=False) is not None

    # Crossing

    def _goal_path(self, among_scouts: bool) -> NDArray[np.float64] | None:
        goal = self._view.goal
        if goal is None:
            return None
        routes = self._planner.routes(self._view, self.atlas, among_scouts)
        node = routes.nearest_to(goal, self._planner.goal_near_m)
        path = None if node is None else routes.path_to(node)
        if path is not None and routes.clearance.along(path[-1], np.array([goal]))[0] > 0.0:
            path = np.vstack([path, goal])
        return path

    def _reach_goal(self) -> Generator[Drives, None, bool]:
        """Post the pickets and cross; whether the goal was reached."""
        for attempt in range(POST_TRIES):
            path = self._goal_path(among_scouts=False)
            if path is None:
                return False
            posts = self._choose_posts(path, proven_only=attempt >= BOLD_TRIES)
            there = yield from self._post(posts)
            path = self._goal_path(among_scouts=True)
            if path is not None and (there or attempt == POST_TRIES - 1):
                yield from self._sight()
                return (yield from self._drive_observer(path))
        return False

    def _post(self, posts: dict[str, Point]) -> Generator[Drives, None, bool]:
        """Send the pickets to their posts; whether all got there."""
        if posts:
            yield from self._face(np.mean(list(posts.values()), axis=0))
            yield from self._send(posts)
        return all(scout.distance_to(posts.get(scout.name, scout.xy)) < POST_NEAR_M for scout in self._view.scouts)

    def _choose_posts(self, path: NDArray[np.float64], proven_only: bool) -> dict[str, Point]:
        scouts = [scout.xy for scout in self._view.scouts]
        survey = self.atlas.survey_around(np.vstack([self.atlas.grid.known(), path, *scouts]), POSTS_M)
        places = {
            scout.name: scouting_costs(survey, scout.xy, self._footprints[scout.name], proven_only)
            for scout in self._view.scouts
        }
        stations = PathFollower(path, 0.05).points[::5]
        clear_m = self._planner.apart_m + POST_NEAR_M
        return choose_posts(places, survey.grid, stations, self._half_view_rad, clear_m)

    def _sight(self) -> Iterator[Drives]:
        """Look at the pickets that the observer does not see, so that it knows well where its landmarks are."""
        for name in [scout.name for scout in self._view.scouts if not scout.in_view]:
            place = [scout.xy for scout in self._view.scouts if scout.name == name]
            if place:
                yield from self._face(place[0])
                for _ in self._decisions(SIGHT_S):
                    yield HOLD

    def _send(self, posts: dict[str, Point]) -> Iterator[Drives]:
        """Drive pickets to places, over proven ground where there is any, until each is there or something stops it."""
        drivers = {name: ScoutDriver(self._members[name], self._team.decision_s, self._rng) for name in posts}
        ways = {s.name: self._way(s.name, s.xy, posts[s.name]) for s in self._view.scouts if s.name in posts}
        for _ in self._decisions(POST_S):
            drives: Drives = {}
            for scout in [s for s in self._view.scouts if s.name in ways]:
                driver, way = drivers[scout.name], ways[scout.name]
                aim = way.target(scout.xy)
                drives[scout.name] = driver.go(scout, aim)
                if driver.blocked or way.off_m > OFF_M:
                    note_bump(scout, aim, self._members[scout.name].robot.body_radius_m, self._view.bodies, self.atlas)
                if driver.blocked or way.off_m > OFF_M or scout.distance_to(posts[scout.name]) < POST_NEAR_M:
                    del ways[scout.name], drives[scout.name]
            if not ways:
                return
            yield drives

    def _way(self, name: str, start: Point, end: Point) -> PathFollower:
        survey = self.atlas.survey_around([start, end], 0.5)
        return PathFollower(scouting_way(survey, start, end, self._footprints[name], None), 0.06)

    def _drive_observer(self, path: NDArray[np.float64]) -> Generator[Drives, None, bool]:
        """Drive the observer along a path while all others hold; whether it arrived."""
        crossing = Crossing(path, self._planner, self._team)
        for _ in self._decisions(CROSS_S):
            drive = crossing.drive(self._view, self.atlas)
            if crossing.arrived or crossing.blocked:
                break
            yield {self._team.names[0]: drive}
        yield HOLD
        return crossing.arrived

    # Moving on

    def _face(self, point: Point | NDArray[np.float64]) -> Iterator[Drives]:
        """Turn the observer until a point is well within its view."""
        bearing = self._view.leader.bearing_to((float(point[0]), float(point[1])))
        if abs(bearing) > FACED * self._half_view_rad:
            yield from self._turn(self._view.leader.yaw + bearing)

    def _advance(self) -> Iterator[Drives]:
        """Turn to where more unknown or needed ground is in view, or go where there would be more."""
        leader, routes = self._view.leader, self._planner.routes(self._view, self.atlas, among_scouts=True)
        needed = None if self._prospect is None else self._prospect.needed
        worth = worth_exploring(routes.grid, needed)
        self._headings.append(leader.yaw)
        heading, gain = best_heading(routes.grid, worth, leader.xy, self._half_view_rad, self._headings)
        node, around = best_stand(routes, worth, [*self._stands, leader.xy])
        in_view = 1.0 if needed is not None else self._half_view_rad / math.pi
        path = None if node is None else routes.path_to(node)
        if path is not None and around * in_view > gain:
            self._stands.append(leader.xy)
            self._headings.clear()
            yield from self._drive_observer(path)
            heading, gain = best_heading(routes.grid, worth, self._view.leader.xy, self._half_view_rad, [])
        if gain > 0.0:
            yield from self._turn(heading)
        self._scouting.move_on()

    def _turn(self, heading: float) -> Iterator[Drives]:
        """Turn the observer in place once all others stand still."""
        for _ in self._decisions(SETTLE_S):
            if all(scout.stationary for scout in self._view.scouts):
                break
            yield HOLD
        for _ in self._decisions(TURN_S):
            bearing = wrapped(heading - self._view.leader.yaw)
            if abs(bearing) < FACING_RAD:
                break
            yield {self._team.names[0]: turn_to(bearing, TURN_RAD_S)}
        yield HOLD

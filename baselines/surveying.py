"""The course of a survey by robots with cameras and lasers: stop, scan what two cameras see, move one robot, again.

Hats are lit while anybody moves, and until each pose is fixed; one robot moves at a time, the others hold still. It
goes only where scans or bodies have shown the ground to be free, and where to is what strategies differ in.

Source: thesis section 6.2.1.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from baselines.atlas import Atlas, Survey
from baselines.bumping import note_bump
from baselines.common_view import sector_of
from baselines.driving import DARK_HOLD, STILL, Drive, PathFollower, Scan, ScoutDriver, action, scan_action, turn_to
from baselines.next_view import Move, unmeasured
from baselines.rasters import Tile, Tries, Watcher, best_tile, in_common_view, tiles_of
from baselines.scanned import SCANNED, going
from baselines.team_view import Landmark, RobotView, read_robots, wrapped
from baselines.ways import Strategy, Ways
from coop_envs.mapping.planning import Disc, Points
from coop_envs.policy import Actions, Observations, TeamDescription

FIX_S, SETTLE_S = 1.0, 2.0  # least and most time at rest for poses to be fixed
SCAN_S, RASTER_S = 60.0, 12.0  # of scanning in one stop, and of one raster, at most
LEAST_RATE_M2_S = 0.02  # a raster that promises less is not drawn
BARREN, PASSES = 6, 2  # stops in a row that show nothing new, after which all is tried afresh, and how often that is
FAILURE = 1.0  # of a try: what it counts to have stood in view of ground that was not measured
SPEED_M_S, TURN_RAD_S, FACING_RAD = 0.15, 1.0, 0.06
LOOKAHEAD_M, OFF_M, NEAR_M, TOLERANCE_M, CHECK_EVERY = 0.05, 0.06, 0.03, 0.01, 3
DRIVE_S, TURN_S, STALLS = 90.0, 12.0, 3
MARGIN_M = 3.5
SET_DOWN_M = 0.22  # round where a robot was set down the ground is trusted

Orders = dict[str, Drive | Scan]
HOLD: Orders = {}


class Surveying:
    """One episode of one team. The course is a generator: each step yields the orders of one decision."""

    def __init__(self, team: TeamDescription, strategy: Strategy, seed: int, view_rad: float | None = None) -> None:
        self.atlas, self.tries = Atlas(team.cell_m), Tries()
        self._team, self._strategy = team, strategy
        self._members = dict(zip(team.names, team.members, strict=True))
        self._sectors = {m.name: sector_of(m, view_rad) for m in team.members if m.camera is not None}
        rngs = np.random.default_rng([seed, 4]).spawn(len(team.names))
        self._rngs = dict(zip(team.names, rngs, strict=True))
        self._robots: dict[str, RobotView] = {}
        self._lost: tuple[Landmark, ...] = ()
        self._trusted: tuple[Disc, ...] = ()
        self._last: str | None = None
        self._move: Move | None = None
        self._ended = False
        self._course = self._whole_course()

    def act(self, observations: Observations) -> Actions:
        """One action for each live agent."""
        robots, self._lost = read_robots(observations, self._team)
        self._robots = {robot.name: robot for robot in robots}
        for robot in robots:
            self.atlas.add(robot.window_m, observations[robot.name]["map"])
        for mark in self._lost:
            self.atlas.lost(mark.xy)
        if not self._trusted:
            self._trusted = tuple((*robot.xy, SET_DOWN_M) for robot in robots)
        self._ended = self._ended or len(self._watchers()) < 2
        orders = HOLD if self._ended else next(self._course)
        return {name: self._action(name, orders.get(name, STILL)) for name in observations}

    def _action(self, name: str, order: Drive | Scan) -> NDArray[np.float32]:
        if isinstance(order, Scan):
            return scan_action(order, self._members[name])
        return DARK_HOLD if self._ended else action(order, self._members[name])

    def _decisions(self, seconds: float) -> range:
        return range(max(1, round(seconds / self._team.decision_s)))

    def _whole_course(self) -> Iterator[Orders]:
        barren = passes = 0
        yield from self._fix_poses()
        while len(self._watchers()) >= 2:
            before = self._free_cells()
            yield from self._scan()
            self._note_failures(in_vain=self._free_cells() == before)
            barren = barren + 1 if self._free_cells() == before else 0
            watchers = self._watchers()
            if len(watchers) < 2:
                break
            ways = Ways(watchers, self.survey(), self._trusted)
            move = None if barren == BARREN else self._strategy.choose(ways, self.tries, self._last)
            if move is not None:
                self._move, self._last = move, move.mover
                yield from self._make(move)
                yield from self._fix_poses()
                yield from self._find(move)
            elif passes == PASSES:
                break
            else:
                barren, passes = 0, passes + 1
                self.tries.forget()
        self._ended = True
        while True:
            yield HOLD

    def _watchers(self) -> list[Watcher]:
        """Robots with cameras, as they stand now."""
        return [
            Watcher(robot, self._members[name], self._sectors[name])
            for name, robot in self._robots.items()
            if name in self._sectors
        ]

    def _free_cells(self) -> int:
        return int(np.count_nonzero(self.atlas.grid.obstacle <= SCANNED))

    def survey(self) -> Survey:
        """What is known around the robots, as far as they may soon see."""
        return self.atlas.survey_around([robot.xy for robot in self._robots.values()], MARGIN_M)

    # Scanning

    def _scan(self) -> Iterator[Orders]:
        """Draw the rasters that promise most for their time, one after the other, while any is worth it."""
        watchers, grid = self._watchers(), self.survey().grid
        tiles = [tile for watcher in watchers for tile in tiles_of(watcher, watchers, grid, self.tries)]
        left = len(self._decisions(SCAN_S))
        last: Tile | None = None
        while left > 0:
            tile, rate = best_tile(tiles, self.tries, last)
            if tile is None or rate < LEAST_RATE_M2_S or tile.name not in self._robots:
                return
            for orders in self._draw(tile):
                left -= 1
                yield orders
            last = tile

    def _draw(self, tile: Tile) -> Iterator[Orders]:
        """One raster; where it aimed then counts as tried."""
        for _ in self._decisions(RASTER_S):
            yield {tile.name: tile.scan}
            robot = self._robots.get(tile.name)
            if robot is None:
                return
            if robot.scanned >= 1.0:
                break
        self.tries.add(tile.squares, 1.0)

    def _note_failures(self, in_vain: bool) -> None:
        """What is in common view and not measured will hardly be from here; nor what a stop ``in_vain`` was for."""
        watchers, survey = self._watchers(), self.survey()
        if len(watchers) < 2:
            return
        points = unmeasured(survey, watchers, self.tries).points
        points = points[in_common_view(points, watchers, survey.grid).any(axis=0)]
        if in_vain and self._move is not None:
            points = np.vstack([points, self._move.aim])
        squares = {square for half in (0, 1) for square in self.tries.squares(points, half)}
        self.tries.add(frozenset(squares), FAILURE)

    # Moving

    def _make(self, move: Move) -> Iterator[Orders]:
        """The partner watches, the mover goes, both turn to look at common ground."""
        if move.path is not None:
            end = (float(move.path[-1, 0]), float(move.path[-1, 1]))
            yield from self._watch(move, end)
            yield from self._drive(move.mover, move.path)
        headings = {move.mover: move.heading, move.partner: move.partner_heading}
        if len(self._robots) > len(headings):
            yield from self._turn(headings)
        else:
            yield from self._turn({move.mover: move.heading})
            yield from self._turn({move.partner: move.partner_heading})

    def _watch(self, move: Move, end: tuple[float, float]) -> Iterator[Orders]:
        """Turn the partner so that it sees where the mover will stop, to its final heading if that will do."""
        partner = self._robots.get(move.partner)
        if partner is None:
            return
        towards = partner.yaw + partner.bearing_to(end)
        half_rad = self._sectors[partner.name].half_rad
        if abs(wrapped(towards - move.partner_heading)) < half_rad:
            yield from self._turn({move.partner: move.partner_heading})
        elif abs(wrapped(towards - partner.yaw)) > half_rad:
            yield from self._turn({move.partner: towards})

    def _turn(self, headings: dict[str, float]) -> Iterator[Orders]:
        """Turn robots in place while all others hold."""
        for _ in self._decisions(TURN_S):
            orders: Orders = {}
            for name, heading in headings.items():
                robot = self._robots.get(name)
                error = 0.0 if robot is None else wrapped(heading - robot.yaw)
                if abs(error) > FACING_RAD:
                    orders[name] = turn_to(error, min(TURN_RAD_S, self._members[name].cruise_yaw_rate_rad_s))
            if not orders:
                return
            yield orders

    def _drive(self, name: str, path: Points) -> Iterator[Orders]:
        """Drive a robot along a path over ground seen free while all others hold; failures are remembered."""
        driver = ScoutDriver(self._members[name], self._team.decision_s, self._rngs[name])
        way = PathFollower(path, LOOKAHEAD_M)
        pace = min(1.0, SPEED_M_S / self._members[name].cruise_speed_m_s)
        stalls = 0
        for decision in self._decisions(DRIVE_S):
            robot = self._robots.get(name)
            if robot is None or robot.distance_to(way.end) < NEAR_M:
                return
            aim = way.target(robot.xy)
            if way.off_m > OFF_M or (decision % CHECK_EVERY == 0 and not self._safe(robot, way)):
                break
            drive = driver.go(robot, aim, pace)
            if driver.blocked:
                note_bump(robot, aim, self._members[name].robot.body_radius_m, self._bodies(), self.atlas)
                self.atlas.failed(aim)
                stalls += 1
                if stalls == STALLS:
                    break
            yield {name: drive}
        self.atlas.failed(way.end)

    def _bodies(self) -> list[RobotView | Landmark]:
        return [*self._robots.values(), *self._lost]

    def _safe(self, robot: RobotView, way: PathFollower) -> bool:
        """Whether the next of the way still is free, or no worse than where the robot is."""
        ahead = way.remaining[5:40:3]
        if not len(ahead):
            return True
        survey = self.atlas.survey_around(np.vstack([ahead, [robot.xy]]), 0.4)
        member = self._members[robot.name]
        clearance = going(member, self._team.cell_m, self._trusted, self.atlas.losses).clearance(survey)
        here = min(0.0, float(clearance(np.array([robot.xy]))[0]))
        return bool(clearance(ahead).min() > here - TOLERANCE_M)

    def _find(self, move: Move) -> Iterator[Orders]:
        """If, against expectation, neither of the two is in view, have each look at the other and back."""
        for looker, other, heading in (
            (move.mover, move.partner, move.heading),
            (move.partner, move.mover, move.partner_heading),
        ):
            pair = [self._robots[name] for name in (looker, other) if name in self._robots]
            if len(pair) < 2 or any(robot.in_view for robot in pair):
                return
            yield from self._turn({looker: pair[0].yaw + pair[0].bearing_to(pair[1].xy)})
            yield from self._fix_poses()
            yield from self._turn({looker: heading})

    def _fix_poses(self) -> Iterator[Orders]:
        """Hold with hats lit until everybody stands and, if somebody sees anybody, poses have been fixed."""
        least = len(self._decisions(FIX_S))
        for decision in self._decisions(SETTLE_S):
            stand = all(robot.stationary for robot in self._robots.values())
            if stand and decision >= least:
                return
            yield HOLD

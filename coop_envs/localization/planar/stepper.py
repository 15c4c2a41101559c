"""`PlanarStepper`: plays windows of events to the filters of planar teams, and keeps what they say of every robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from coop_envs.localization.logs.events import Event, Fix, RangeBearing
from coop_envs.localization.planar.driving import STILL, Drivers, DriversSnapshot
from coop_envs.localization.planar.filter import PlanarFix
from coop_envs.localization.planar.meeting import Meeting, Now
from coop_envs.localization.planar.se2 import Array
from coop_envs.localization.planar.settings import PlanarSettings
from coop_envs.localization.planar.sightings import KNOWN, sightings_now
from coop_envs.localization.planar.teams import TEAM, WORLD, PlanarTeams, TeamsSnapshot, United
from coop_envs.localization.result import Happening, Kind
from coop_envs.localization.timeline import Window


@dataclass(frozen=True, slots=True, eq=False)
class PlanarEstimate:
    """Poses (N, 3) of robots at a time and their covariances (N, 3, 3) of yaw, x, y; which frame (N,), "" for none."""

    time_s: float
    frame: tuple[str, ...]
    pose: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False)
class PlanarState:
    """Everything that later steps depend on; estimates and happenings only grow, so their number is enough."""

    teams: TeamsSnapshot
    drivers: DriversSnapshot
    outliers: int
    estimates: int
    happenings: int


class PlanarStepper:
    """The filters of one log's robots, as a timeline plays them.

    ``usual_s`` (N,) is how often each robot's odometry usually comes, ``world`` whether places in the world are told.
    """

    def __init__(
        self,
        robots: tuple[str, ...],
        starts: Mapping[str, tuple[float, float, float]],
        landmarks: Mapping[str, tuple[float, float]],
        usual_s: Array,
        world: bool,
        settings: PlanarSettings,
        start_s: float,
    ) -> None:
        self.robots, self.landmarks, self.settings = robots, landmarks, settings
        self.index = {name: k for k, name in enumerate(robots)}
        self.teams = PlanarTeams(robots, starts, world, settings)
        self.estimates: list[PlanarEstimate] = []
        self.happenings: list[Happening] = []
        self.outliers = 0
        self._drivers = Drivers(robots, usual_s, settings, start_s, self._happen)

    def snapshot(self) -> PlanarState:
        """The whole state."""
        told = len(self.estimates), len(self.happenings)
        return PlanarState(self.teams.snapshot(), self._drivers.snapshot(), self.outliers, *told)

    def restore(self, snapshot: PlanarState) -> None:
        """Go back to a state."""
        self.teams.restore(snapshot.teams)
        self._drivers.restore(snapshot.drivers)
        self.outliers = snapshot.outliers
        del self.estimates[snapshot.estimates :]
        del self.happenings[snapshot.happenings :]

    def step(self, window: Window[Event]) -> None:
        """Take in a window."""
        moves, gone = self._drivers.drive(window)
        for move in moves:
            self.teams.move([self.robots[k] for k in move.robots], move.step, move.noise)
        for name in gone:
            self.teams.expel(name)
        told = [event for event in window.events if not self._drivers.left(event.robot)]
        self._see([event for event in told if isinstance(event, RangeBearing)])
        for event in told:
            if isinstance(event, Fix):
                self._fix(event)
        self._note(window.end_s)

    def _see(self, events: Sequence[RangeBearing]) -> None:
        """Fuse what robots saw of their own team, keep what they saw of others."""
        within: dict[str, list[RangeBearing]] = {}
        for event in events:
            frame = self.teams.home[event.robot]
            known = event.subject in self.landmarks
            other = WORLD if known else self.teams.home.get(event.subject)
            if other is None:
                self.teams.discover(event.subject, event.robot, *_measured(event))
            elif other == frame:
                within.setdefault(frame, []).append(event)
            elif not self._drivers.left(event.subject):
                self.teams.meetings.append(self._meeting(event))
        for frame, seen in within.items():
            self._update(frame, seen)
        if events:
            self._unite(events[0].time_s)

    def _update(self, frame: str, seen: Sequence[RangeBearing]) -> None:
        team = self.teams.filters[frame]
        updated = team.update(
            sightings_now(
                np.array([team.index[event.robot] for event in seen]),
                np.array([team.index.get(event.subject, KNOWN) for event in seen]),
                np.array([self.landmarks.get(event.subject, (0.0, 0.0)) for event in seen]),
                *(np.array(part) for part in zip(*map(_measured, seen), strict=True)),
            )
        )
        for event, accepted in zip(seen, updated.accepted, strict=True):
            if not accepted:
                self._refuse(event.time_s, event.robot, f"its sighting of {event.subject}")
        for name in updated.doubted:
            self._happen(seen[0].time_s, Kind.DEMOTED, name)

    def _refuse(self, time_s: float, robot: str, what: str) -> None:
        self.outliers += 1
        self._happen(time_s, Kind.OUTLIER, robot, what)

    def _meeting(self, event: RangeBearing) -> Meeting:
        place = np.array(self.landmarks[event.subject]) if event.subject in self.landmarks else None
        then = self._drivers.reckoned(event.robot), self._drivers.reckoned(event.subject)
        measured, sigma = _measured(event)
        return Meeting(event.time_s, event.robot, event.subject, measured, sigma, np.zeros((2, 2)), place, *then)

    def _fix(self, event: Fix) -> None:
        """Fuse a fix, or keep it until the robot's team is placed in the world; a pose places it at once."""
        fix = planar_fix(event)
        if self.teams.home[event.robot] == WORLD:
            if not self.teams.of(event.robot).fix(event.robot, fix):
                self._refuse(event.time_s, event.robot, "its fix")
        elif fix.yaw_rad is not None:
            self._tell(event.time_s, self.teams.place(event.robot, fix))
        else:
            told = fix.position, np.zeros(2), fix.covariance
            then = self._drivers.reckoned(event.robot)
            self.teams.meetings.append(Meeting(event.time_s, event.robot, None, *told, None, then, STILL))
            self._unite(event.time_s)

    def _unite(self, time_s: float) -> None:
        now: Now = {name: self._drivers.reckoned(name) for name in self.robots} if self.teams.meetings else {}
        for united in self.teams.unite(time_s, now):
            self._tell(time_s, united)

    def _tell(self, time_s: float, united: United) -> None:
        kind = Kind.PLACED if united.host == WORLD else Kind.JOINED
        for robot in united.robots:
            self._happen(time_s, kind, robot, "" if united.host in (WORLD, TEAM) else f"with {united.host}")

    def _note(self, time_s: float) -> None:
        if self.estimates and time_s - self.estimates[-1].time_s < self.settings.record_s - 1e-6:
            return
        pose, covariance = np.full((len(self.robots), 3), np.nan), np.full((len(self.robots), 3, 3), np.nan)
        homes = [self.teams.home[name] for name in self.robots]
        frames = tuple(home if home in (WORLD, TEAM) else "" for home in homes)
        for k, (name, frame) in enumerate(zip(self.robots, frames, strict=True)):
            if frame:
                team = self.teams.filters[frame]
                pose[k], covariance[k] = team.pose[team.index[name]], team.covariance_of(name)
        self.estimates.append(PlanarEstimate(time_s, frames, pose, covariance))

    def _happen(self, time_s: float, kind: Kind, robot: str, detail: str = "") -> None:
        self.happenings.append(Happening(time_s, kind, robot, detail))


def _measured(event: RangeBearing) -> tuple[Array, Array]:
    measured = np.array([event.range_m, event.bearing_rad])
    return measured, np.array([event.range_sigma_m, event.bearing_sigma_rad])


def planar_fix(event: Fix) -> PlanarFix:
    """What a fix tells in the plane."""
    if event.rotation is None:
        return PlanarFix(event.position[:2], None, event.covariance[:2, :2])
    kept = np.array([2, 3, 4])
    yaw_rad = float(np.arctan2(event.rotation[1, 0], event.rotation[0, 0]))
    return PlanarFix(event.position[:2], yaw_rad, event.covariance[np.ix_(kept, kept)])

"""`PlanarTeams`: filters of planar teams that do not know each other's frames, until sightings or fixes unite them.

Robots whose places people told belong to one team from the start; every other robot is a team of its own until
sightings tell where its frame lies in another's. Known landmarks and fixes make up the world, a team like any other
that the rest may be found to lie in.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.filter import PlanarFilter, PlanarFix, PlanarSnapshot
from coop_envs.localization.planar.meeting import FIX_WEIGHT, OPEN, Meeting, Now, agreed, fuse_meetings, points
from coop_envs.localization.planar.se2 import Array
from coop_envs.localization.planar.settings import PlanarSettings

WORLD, TEAM, ORIGIN = "/world", "/team", "/origin"
"""Names of frames, and of the team's frame as a filter holds it; other frames are named like their robot."""
MOST_MEETINGS = 30


@dataclass(frozen=True, slots=True, eq=False)
class TeamsSnapshot:
    """Everything that a `PlanarTeams` holds."""

    filters: Mapping[str, PlanarSnapshot]
    home: Mapping[str, str]
    meetings: tuple[Meeting, ...]
    placed: tuple[Array, Array] | None


@dataclass(frozen=True, slots=True)
class United:
    """Robots whose frame was found to lie in that of ``host``."""

    host: str
    robots: tuple[str, ...]


class PlanarTeams:
    """Filters by frame; ``home`` is the frame of every robot and of every landmark that is not a known place.

    ``placed`` is where the team's frame was found to lie in the world, (3,), and the covariance (3, 3) of its error,
    from the left.
    """

    def __init__(
        self,
        robots: tuple[str, ...],
        starts: Mapping[str, tuple[float, float, float]],
        world: bool,
        settings: PlanarSettings,
    ) -> None:
        self.robots, self.settings = robots, settings
        self.filters = {WORLD: PlanarFilter(settings)} if world else {}
        self.home: dict[str, str] = {}
        self.meetings: list[Meeting] = []
        self.placed: tuple[Array, Array] | None = None
        if starts:
            self._start(starts)
        for name in robots:
            if name not in self.home:
                self._let_alone(name)

    def snapshot(self) -> TeamsSnapshot:
        """The whole state."""
        filters = {frame: team.snapshot() for frame, team in self.filters.items()}
        return TeamsSnapshot(filters, dict(self.home), tuple(self.meetings), self.placed)

    def restore(self, state: TeamsSnapshot) -> None:
        """Go back to a state."""
        self.filters = {frame: PlanarFilter(self.settings) for frame in state.filters}
        for frame, team in state.filters.items():
            self.filters[frame].restore(team)
        self.home, self.meetings, self.placed = dict(state.home), list(state.meetings), state.placed

    def _start(self, starts: Mapping[str, tuple[float, float, float]]) -> None:
        """Enter the robots that people set down; the first of them defines the frame."""
        team, s = PlanarFilter(self.settings), self.settings
        sigma = np.array([s.start_yaw_rad, s.start_position_m, s.start_position_m])
        for k, name in enumerate(name for name in self.robots if name in starts):
            team.add(name, np.array(starts[name]), np.diag((sigma if k else np.full(3, 1e-5)) ** 2))
            self.home[name] = TEAM
        team.add(ORIGIN, np.zeros(3), np.zeros((3, 3)))
        self.filters[TEAM] = team

    def _let_alone(self, name: str) -> None:
        """Let a robot be a team of its own, its frame where it stands now."""
        self.filters[name] = PlanarFilter(self.settings)
        self.filters[name].add(name, np.zeros(3), np.zeros((3, 3)))
        self.home[name] = name

    def of(self, name: str) -> PlanarFilter:
        """The filter that holds a robot or landmark."""
        return self.filters[self.home[name]]

    def landmarks(self, frame: str) -> dict[str, tuple[float, float]]:
        """Places (x, y) of the landmarks that a frame's filter holds."""
        team = self.filters[frame]
        places = dict(zip(team.names, team.pose.tolist(), strict=True))
        return {name: (x, y) for name, (x, y, _) in places.items() if name not in self.robots and name != ORIGIN}

    def move(self, names: Sequence[str], step: Array, noise: Array) -> None:
        """Move robots (M) by steps (M, 3) with noise (M, 3, 3), as `PlanarFilter.move`, each in its team."""
        homes = [self.home[name] for name in names]
        for frame in dict.fromkeys(homes):
            own = np.array([home == frame for home in homes])
            index = self.filters[frame].index
            places = np.array([index[name] for name, chosen in zip(names, own, strict=True) if chosen])
            self.filters[frame].move(places, step[own], noise[own])

    def expel(self, name: str) -> None:
        """Take a robot out of its team; from then on it is alone."""
        frame = self.home[name]
        self.filters[frame].remove(name)
        self.meetings = [meeting for meeting in self.meetings if name not in meeting.names]
        if frame not in (WORLD, TEAM) and not any(robot in self.filters[frame].index for robot in self.robots):
            self.home = {other: home for other, home in self.home.items() if home != frame}
            self.meetings = [meeting for meeting in self.meetings if set(meeting.names) <= set(self.home)]
            del self.filters[frame]
        self._let_alone(name)

    def discover(self, landmark: str, seer: str, measured: Array, sigma: Array) -> None:
        """Enter a landmark of unknown place where a robot sees it."""
        self.of(seer).add_landmark(landmark, seer, measured, sigma)
        self.home[landmark] = self.home[seer]

    def place(self, robot: str, fix: PlanarFix) -> United:
        """Place a robot's team in the world by the robot's pose there."""
        assert fix.yaw_rad is not None
        guest, team = self.home[robot], self.of(robot)
        pose = np.array([*fix.position, fix.yaw_rad])
        united = self._absorb(WORLD, guest, se2.composed(pose, se2.inverse(team.pose[team.index[robot]])))
        self.filters[WORLD].fix(robot, fix)
        self._settle(guest)
        return united

    def _frames(self, meeting: Meeting) -> frozenset[str]:
        other = meeting.names[1] if len(meeting.names) > 1 else None
        return frozenset({self.home[meeting.seer], WORLD if other is None else self.home[other]})

    def unite(self, time_s: float, now: Now) -> Iterator[United]:
        """Bring together teams on whose frames enough meetings agree; forget old meetings."""
        self.meetings = [m for m in self.meetings if time_s - m.time_s <= self.settings.meet_s]
        while (united := self._unite_two(now)) is not None:
            yield united

    def _unite_two(self, now: Now) -> United | None:
        order = {frame: k for k, frame in enumerate((WORLD, TEAM, *self.robots))}
        waiting: dict[frozenset[str], list[Meeting]] = {}
        for meeting in self.meetings:
            waiting.setdefault(self._frames(meeting), []).append(meeting)
        pairs = sorted((sorted(pair, key=order.__getitem__) for pair in waiting), key=lambda p: [order[f] for f in p])
        for host, guest in pairs:
            if (united := self._try(host, guest, waiting[frozenset({host, guest})][-MOST_MEETINGS:], now)) is not None:
                return united
        return None

    def _try(self, host: str, guest: str, meetings: list[Meeting], now: Now) -> United | None:
        """Take a team into another if meetings tell where it lies."""
        told = [points(self.filters[host], self.filters[guest], meeting, now) for meeting in meetings]
        here, there, sigma = (np.array(part) for part in zip(*told, strict=True))
        weight = np.array([FIX_WEIGHT if meeting.subject is None else 1.0 for meeting in meetings])
        found = agreed(here, there, sigma, weight)
        if found is None:
            return None
        united = self._absorb(host, guest, found[0])
        agreeing = [meeting for meeting, agrees in zip(meetings, found[1], strict=True) if agrees]
        fuse_meetings(self.filters[host], agreeing, now)
        self._settle(guest)
        return united

    def _absorb(self, host: str, guest: str, pose: Array) -> United:
        """Take in a team whose frame lies about at a pose."""
        team = self.filters.pop(guest)
        self.filters[host].absorb(team, pose, OPEN)
        self.home.update({name: host for name in team.names if name != ORIGIN})
        self.meetings = [meeting for meeting in self.meetings if len(self._frames(meeting)) > 1]
        return United(host, tuple(name for name in team.names if name in self.robots))

    def _settle(self, guest: str) -> None:
        """Keep where the team's own frame was found to lie, for what was noted before."""
        if guest == TEAM:
            world = self.filters[WORLD]
            k = world.index[ORIGIN]
            self.placed = world.pose[k].copy(), world.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3].copy()
            world.remove(ORIGIN)

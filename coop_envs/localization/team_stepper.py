"""`TeamStepper`: plays windows of events to the team filter, and keeps what it says of every robot."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.command import allocate_command
from coop_envs.agents.team import Team
from coop_envs.estimation.team_filter import Snapshot, TeamFilter
from coop_envs.localization.hearing import Ear, Heard, Listening, hear
from coop_envs.localization.logs.events import Event, Fix, ImuSample, Odometry, PoseSighting
from coop_envs.localization.presence import (
    Views,
    adrift,
    camera_mounts,
    forget_pose,
    lost_sight_of,
    place_by_sighting,
    widen_for_bridge,
)
from coop_envs.localization.result import Estimate, Happening, Kind, Path, path_of
from coop_envs.localization.settings import Localization
from coop_envs.localization.telling import Told
from coop_envs.localization.timeline import Window
from coop_envs.localization.world_fixes import Anchor, FixTaker
from coop_envs.sensing.measurements import allocate_measurements

Array = NDArray[np.float64]

UNSEEN_S = 1.0
"""A robot is not lost that was seen so shortly ago, nor one that has not been heard at so early a time."""
TOLD_S = 0.1
"""Shorter bridges are not worth a word."""


@dataclass(frozen=True, slots=True)
class Standing:
    """How it stands with a robot: what was heard of it, whether it is in the filter, and since when it lacks what."""

    ear: Ear = field(default_factory=Ear)
    present: bool = False
    joined: bool = False
    unheard_s: float = 0.0
    adrift_s: float = 0.0
    unseen_s: float = 0.0
    resting: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class StepperSnapshot:
    """Everything that later steps depend on; estimates and happenings only grow, so their number is enough."""

    belief: Snapshot
    robots: tuple[Standing, ...]
    anchor: Anchor
    estimates: int
    happenings: int


class TeamStepper:
    """One team's filter, as a timeline plays it; ``names`` are what the log calls the team's members, in order.

    Robots without a start join where they are first seen.
    """

    def __init__(
        self,
        team: Team,
        names: tuple[str, ...],
        starts: Mapping[str, tuple[float, float, float]],
        listening: tuple[Listening, ...],
        settings: Localization,
        ticks: int,
        start_s: float,
    ) -> None:
        members = tuple(dataclasses.replace(member, reserve=False) for member in team.members)
        self._members, self._names, self._settings, self._listening = members, names, settings, listening
        self._start_s = start_s
        self._index = {name: i for i, name in enumerate(names)}
        self._mounts = camera_mounts(team)
        measurements = allocate_measurements(1, len(names), ticks, "cpu")
        command = allocate_command(1, len(names), ticks, "cpu")
        self.filter = TeamFilter(dataclasses.replace(team, members=members), settings.estimation, measurements, command)
        self.filter.reset(np.array([[starts.get(name, (0.0, 0.0, 0.0)) for name in names]]))
        self.views = Views.of(self.filter)
        self._told = Told(measurements, command, self.filter.members.numpy()["odometry"])
        self._bias = self.filter.belief.gyro_bias.numpy()[0]
        placed = {name for k, name in enumerate(names) if name in starts or k == 0}
        self._robots = tuple(Standing(present=name in placed, joined=name in placed) for name in names)
        self._fixes, self.anchor = FixTaker(self.filter, self._index), Anchor()
        self.estimates: list[Estimate] = []
        self.happenings: list[Happening] = []

    def snapshot(self) -> StepperSnapshot:
        """The whole state."""
        return StepperSnapshot(
            self.filter.snapshot(), self._robots, self.anchor, len(self.estimates), len(self.happenings)
        )

    def restore(self, snapshot: StepperSnapshot) -> None:
        """Go back to a state."""
        self.filter.restore(snapshot.belief)
        self._robots, self.anchor = snapshot.robots, snapshot.anchor
        del self.estimates[snapshot.estimates :]
        del self.happenings[snapshot.happenings :]

    def step(self, window: Window[Event]) -> None:
        """Take in a window."""
        by_robot: dict[str, list[Event]] = {name: [] for name in self._names}
        for event in window.events:
            if isinstance(event, ImuSample | Odometry):
                by_robot[event.robot].append(event)
        robots = zip(self._robots, self._names, strict=True)
        self._robots = tuple(self._listen(i, robot, window, by_robot[name]) for i, (robot, name) in enumerate(robots))
        sightings = [event for event in window.events if isinstance(event, PoseSighting)]
        self._admit(sightings, window.end_s)
        shown = self._between_known(sightings)
        self._told.sightings(shown)
        self.filter.step(window.end_s - window.start_s)
        fixes = [event for event in window.events if isinstance(event, Fix)]
        held = [fix for fix in fixes if self._robots[self._index[fix.robot]].present]
        self.anchor, news = self._fixes.take(self.anchor, held, self.views.stationary, window.end_s)
        self.happenings += news
        self._note(shown, window.end_s)

    def _listen(self, i: int, robot: Standing, window: Window[Event], events: Sequence[Event]) -> Standing:
        """Tell the filter of a robot's IMU and wheels over the window."""
        name, model = self._names[i], self._members[i].robot
        edges_s = np.linspace(window.start_s, window.end_s, self.filter.ticks + 1)
        own = [event for event in events if isinstance(event, ImuSample | Odometry)]
        after = window.after.get(("imu", name))
        after = after if isinstance(after, ImuSample) else None
        heard = hear(robot.ear, own, after, edges_s, model, self._listening[i], self._bias[i])
        length_s = window.end_s - window.start_s
        lacking = not heard.means.heard and (robot.ear.imu is not None or window.start_s > self._start_s + UNSEEN_S)
        self._told.motion(i, robot.present, heard, self._settings.estimation.wheels)
        self._say_heard(name, robot, heard, lacking, window)
        if robot.present and lacking:
            adrift(self.views, i, model, robot.adrift_s, length_s)
        if robot.present and heard.means.bridge is not None and not heard.still:
            widen_for_bridge(self.views, i, heard.means.bridge)
        return dataclasses.replace(
            robot,
            ear=heard.ear,
            unheard_s=robot.unheard_s + length_s if lacking else 0.0,
            adrift_s=robot.adrift_s + length_s if lacking else 0.0,
            unseen_s=robot.unseen_s + length_s,
        )

    def _say_heard(self, name: str, robot: Standing, heard: Heard, lacking: bool, window: Window[Event]) -> None:
        if not robot.joined:
            return
        if not lacking and robot.unheard_s > 0.0:
            self._say(window.end_s, Kind.BACK, name, f"heard again after {robot.unheard_s:.2f} s")
        elif lacking and robot.unheard_s == 0.0:
            self._say(window.start_s, Kind.GAP, name, "not heard")
        bridge = heard.means.bridge
        if bridge is not None and bridge.length_s > TOLD_S and window.start_s < bridge.end_s <= window.end_s:
            self._say(window.end_s, Kind.BRIDGED, name, f"{bridge.length_s:.3f} s")

    def _admit(self, sightings: list[PoseSighting], now_s: float) -> None:
        """Robots that are seen by, or see, one whose place is known enter where the sighting puts them."""
        robots = list(self._robots)
        entered = True
        while entered:
            entered = False
            for sighting in sightings:
                i, j = self._index[sighting.camera], self._index[sighting.robot]
                mount = self._mounts[i]
                if robots[i].present == robots[j].present or mount is None:
                    continue
                known, new = (i, j) if robots[i].present else (j, i)
                self._enter(sighting, i, j, mount, known, robots[new].ear.still)
                robots[new] = self._entered(robots[new], now_s, self._names[new], self._names[known])
                entered = True
        self._robots = tuple(robots)

    def _enter(
        self, sighting: PoseSighting, i: int, j: int, mount: tuple[Array, Array], known: int, still: bool
    ) -> None:
        new = j if known == i else i
        model = self._members[new].robot
        biases = (model.imu.gyro_bias_rad_s, model.imu.accel_bias_m_s2)
        forget_pose(self.views, new, 0.0 if still else model.max_speed_m_s, biases)
        place_by_sighting(self.views, sighting, i, j, mount, known)
        self._told.nothing_heard(new)

    def _entered(self, robot: Standing, now_s: float, name: str, by: str) -> Standing:
        self._say(now_s, Kind.BACK if robot.joined else Kind.JOINED, name, f"placed from {by}")
        return dataclasses.replace(robot, present=True, joined=True, adrift_s=0.0, unseen_s=0.0)

    def _between_known(self, sightings: list[PoseSighting]) -> list[tuple[int, int, PoseSighting]]:
        """Sightings between robots whose places the filter holds: whose camera, whom it saw, what it saw."""
        found = [(self._index[one.camera], self._index[one.robot], one) for one in sightings]
        return [one for one in found if self._robots[one[0]].present and self._robots[one[1]].present]

    def _note(self, shown: list[tuple[int, int, PoseSighting]], now_s: float) -> None:
        """Keep what the filter holds after a step, and say what is new."""
        views = self.views
        for i, j, sighting in shown:
            if not views.seen[i, j]:
                self._say(now_s, Kind.OUTLIER, sighting.robot, f"seen by {sighting.camera}")
        seen = np.logical_or(views.seen.any(axis=0), views.seen.any(axis=1)).reshape(-1)
        self._robots = tuple(self._after(i, robot, bool(seen[i]), now_s) for i, robot in enumerate(self._robots))
        self._let_go(now_s)
        present = np.array([robot.present for robot in self._robots])
        poses = np.array([views.pose_covariance(i) for i in range(len(self._names))])
        self.estimates.append(
            Estimate(now_s, present, views.position.copy(), views.rotation.copy(), poses, self.anchor.placed)
        )

    def _after(self, i: int, robot: Standing, seen: bool, now_s: float) -> Standing:
        """A robot's standing after a step."""
        if not robot.present:
            return robot
        resting, name = bool(self.views.stationary[i]), self._names[i]
        if self.views.demoted[i]:
            self._say(now_s, Kind.DEMOTED, name, "seen elsewhere: pushed, slipped or dead-reckoned astray")
        if resting != robot.resting:
            self._say(now_s, Kind.REST_BEGINS if resting else Kind.REST_ENDS, name)
        if seen:
            return dataclasses.replace(robot, resting=resting, adrift_s=0.0, unseen_s=0.0)
        return dataclasses.replace(robot, resting=resting)

    def _let_go(self, now_s: float) -> None:
        """Robots that are lost leave, as long as one is left that others can be placed by."""
        robots = list(self._robots)
        for i, robot in enumerate(robots):
            others = sum(other.present for other in robots) > 1
            if not (robot.present and others and robot.unseen_s > UNSEEN_S):
                continue
            if lost_sight_of(self.views, i, self._settings.lost_m, self._settings.lost_rad):
                self._say(now_s, Kind.LEFT, self._names[i], f"not seen for {robot.unseen_s:.1f} s")
                robots[i] = dataclasses.replace(robot, present=False, resting=False)
        self._robots = tuple(robots)

    def _say(self, time_s: float, kind: Kind, robot: str, detail: str = "") -> None:
        self.happenings.append(Happening(time_s, kind, robot, detail))

    def paths(self) -> dict[str, Path]:
        """The path of each robot that ever was in the filter, by its name in the log."""
        paths = {name: path_of(self.estimates, i) for i, name in enumerate(self._names)}
        return {name: path for name, path in paths.items() if len(path.time_s)}

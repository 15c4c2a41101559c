"""`localize`: a log in, the paths of its robots out; `Localizer` does the same for events as they come."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from coop_envs.agents.team import Team
from coop_envs.errors import ConfigError, require
from coop_envs.localization.calibrations import calibrations
from coop_envs.localization.clocks.streams import ArrivalClock, Clock, OffsetClock, have_arrivals, stamps_agree
from coop_envs.localization.clocks.turns import clock_offsets
from coop_envs.localization.hearing import Listening
from coop_envs.localization.logs.events import Event, Fix, ImuSample, Log, Odometry, PoseSighting, RangeBearing
from coop_envs.localization.rest_detector import noise_of, specified_noise
from coop_envs.localization.result import Result
from coop_envs.localization.settings import Localization
from coop_envs.localization.team_stepper import StepperSnapshot, TeamStepper
from coop_envs.localization.timeline import Order, Timeline
from coop_envs.localization.windows import Reach

Progress = Callable[[float], None]

MOST_TICKS = 16
USUAL_INTERVAL_S = 1.0 / 30.0
ADVANCE_S = 0.25


class Localizer:
    """Localizes a team from events as they come: `add` each, `advance` now and then, read `result` at any time.

    Raises:
        ConfigError: an event of a robot or a camera that the team does not have, or whose numbers are not finite.
    """

    def __init__(
        self,
        team: Team,
        names: tuple[str, ...],
        starts: Mapping[str, tuple[float, float, float]],
        listening: tuple[Listening, ...],
        settings: Localization,
        start_s: float,
    ) -> None:
        require(len(names) == len(team.members), "robots", names, f"one for each of {len(team.members)} members")
        shortest_s = min(one.reach.interval_s for one in listening)
        ticks = min(max(math.ceil(settings.longest_s / shortest_s - 0.01), 1), MOST_TICKS)
        self.stepper = TeamStepper(team, names, starts, listening, settings, ticks, start_s)
        reach_s = {f"{name}": one.reach.bridge_s for name, one in zip(names, listening, strict=True)}
        order: Order[Event] = Order(
            time_s=lambda event: event.time_s,
            stream=stream_key,
            marks=lambda event: isinstance(event, PoseSighting | Fix),
            reach_s=lambda event: reach_s[event.robot] if isinstance(event, ImuSample) else 0.0,
            longest_s=settings.longest_s,
            horizon_s=settings.horizon_s,
        )
        self.timeline: Timeline[Event, StepperSnapshot] = Timeline(self.stepper, order, start_s)
        self._team, self._names, self._estimation = team, names, settings.estimation
        self._cameras = {name for name, m in zip(names, team.members, strict=True) if m.camera is not None}

    def add(self, event: Event) -> bool:
        """Take in an event, in order of arrival; False where it came too late or a second time."""
        require(event.robot in self._names, "robot", event.robot, f"one of {', '.join(sorted(self._names))}")
        if isinstance(event, PoseSighting):
            expected = f"a robot with a camera: {', '.join(sorted(self._cameras))}"
            require(event.camera in self._cameras, "poses.camera", event.camera, expected)
            require(event.camera != event.robot, "poses.robot", event.robot, "another robot than the camera's")
        for field in dataclasses.fields(event):
            value = getattr(event, field.name)
            if isinstance(value, float):
                require(math.isfinite(value), f"{stream_key(event)[0]}.{field.name}", value, "a finite number")
            elif isinstance(value, np.ndarray) and not np.isfinite(value).all():
                raise ConfigError(f"{stream_key(event)[0]}.{field.name}", value, "finite numbers")
        return self.timeline.add(event)

    def advance(self, now_s: float) -> None:
        """Play what happened up to a time."""
        self.timeline.advance(now_s)

    def result(self) -> Result:
        """What is known so far."""
        happenings = tuple(sorted(self.stepper.happenings, key=lambda one: one.time_s))
        frame = "world" if self.stepper.anchor.placed else "team"
        found = calibrations(self._team, self._names, self._estimation, self.stepper.filter)
        counts = dict(vars(self.timeline.counts))
        return Result(self.stepper.paths(), happenings, frame, counts=counts, calibration=found)


def stream_key(event: Event) -> tuple[str, ...]:
    """The stream of an event."""
    match event:
        case ImuSample():
            return "imu", event.robot
        case Odometry():
            return "odometry", event.robot
        case PoseSighting():
            return "pose", event.camera, event.robot
        case RangeBearing():
            return "range", event.robot, event.subject
        case Fix():
            return "fix", event.robot


def localize(log: Log, settings: Localization | None = None, progress: Progress | None = None) -> Result:
    """The paths of a log's robots. Logs without a team, or with neither IMU nor poses, are planar.

    ``progress`` is told the share that is done.

    Raises:
        ConfigError: the log holds nothing to localize by.
    """
    settings = settings or Localization()
    spatial = [event for event in log.events if not isinstance(event, RangeBearing)]
    posed, ranged = (any(isinstance(event, kind) for event in log.events) for kind in (PoseSighting, RangeBearing))
    if log.team is None and posed and not ranged:
        raise ConfigError("team", None, "a team (team.yaml or --team): poses need to know where cameras are")
    if log.team is None or not (posed or any(isinstance(event, ImuSample) for event in log.events)):
        from coop_envs.localization.planar.localizer import localize_planar

        return localize_planar(log, progress=progress)
    if not spatial:
        raise ConfigError("log", "no events", "IMU samples, odometry or sightings")
    clock, offset_s = chosen_clock(spatial, log, settings)
    events = [clock.align(event) for event in spatial]
    listening = tuple(_listening(log.team, i, name, events, settings) for i, name in enumerate(log.robots))
    first_s = min(event.time_s for event in events) - max(one.reach.interval_s for one in listening)
    one_wheel = settings.estimation.wheels and any(isinstance(event, Odometry) for event in events)
    estimation = dataclasses.replace(settings.estimation, wheels=one_wheel)
    settings = dataclasses.replace(settings, estimation=estimation)
    localizer = Localizer(log.team, log.robots, log.starts, listening, settings, first_s)
    _play(localizer, events, settings, progress)
    result = localizer.result()
    jumps = clock.jumps if isinstance(clock, ArrivalClock) else []
    happenings = tuple(sorted([*result.happenings, *jumps], key=lambda one: one.time_s))
    ignored = len(log.events) - len(spatial)
    left_out = (f"{ignored} rows of range and bearing left out: they are for planar teams",) if ignored else ()
    unplaced = tuple(f"{name}: never seen, so never placed" for name in log.robots if name not in result.paths)
    notes = (*log.notes, *left_out, *unplaced)
    return dataclasses.replace(result, happenings=happenings, clock_offset_s=offset_s, notes=notes)


def chosen_clock(events: Sequence[Event], log: Log, settings: Localization) -> tuple[Clock, dict[str, float]]:
    """The clock that the settings ask for, and the constant offsets it adds to streams."""
    kind = settings.clocks
    if kind == "arrivals" or (kind == "auto" and have_arrivals(events) and not stamps_agree(events)):
        require(have_arrivals(events), "clocks", "arrivals", "a log with arrival_s")
        return ArrivalClock(settings.horizon_s), {}
    offset_s = {} if kind == "stamps" else clock_offsets(events, log, significant=kind == "auto")
    return OffsetClock(offset_s), offset_s


def _play(localizer: Localizer, events: Sequence[Event], settings: Localization, progress: Progress | None) -> None:
    """Add events as they came, and go on now and then."""
    newest_s = played_s = -math.inf
    for k, event in enumerate(events):
        if localizer.add(event):
            newest_s = max(newest_s, event.time_s)
        if newest_s > played_s + ADVANCE_S:
            played_s = newest_s
            localizer.advance(newest_s - settings.patience_s)
            if progress is not None:
                progress((k + 1) / len(events))
    localizer.advance(_end_s(events, settings))
    if progress is not None:
        progress(1.0)


def _end_s(events: Sequence[Event], settings: Localization) -> float:
    """Until when all are heard who are heard at the end: later frames would find them silent."""
    last_s: dict[str, float] = {}
    for event in events:
        if isinstance(event, ImuSample):
            last_s[event.robot] = max(event.time_s, last_s.get(event.robot, -math.inf))
    end_s = max(last_s.values(), default=math.inf)
    return min((at for at in last_s.values() if at >= end_s - settings.bridge_s), default=math.inf)


def _listening(team: Team, i: int, name: str, events: Sequence[Event], settings: Localization) -> Listening:
    """How a robot's IMU speaks in a log: how often, how quietly."""
    model = team.members[i].robot
    samples = [event for event in events if isinstance(event, ImuSample) and event.robot == name]
    times = np.unique([sample.time_s for sample in samples])
    interval_s = float(np.median(np.diff(times))) if len(times) > 1 else USUAL_INTERVAL_S
    reach = Reach(interval_s=interval_s, bridge_s=max(settings.bridge_s, interval_s))
    noise = specified_noise(model.imu, 1.0 / interval_s)
    if samples:
        gyro, accel = (np.array([getattr(one, field) for one in samples]) for field in ("gyro", "accel"))
        noise = noise_of(gyro, accel, 1.0 / interval_s, noise)
    return Listening(reach, noise, has_imu=bool(samples))

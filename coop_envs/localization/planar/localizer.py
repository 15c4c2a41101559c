"""`localize_planar`: a log of robots in the plane in, their paths out.

Robots drive by odometry and tell range and bearing of each other, of landmarks whose places are known or not, and
absolute fixes; see `filter`, and `stepper` for how robots come, go and find each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from itertools import pairwise

import numpy as np

from coop_envs.errors import ConfigError, require
from coop_envs.localization.logs.events import Event, Fix, Log, Odometry, RangeBearing
from coop_envs.localization.planar import se2
from coop_envs.localization.planar.filter import PlanarSnapshot, carried, plain_jacobian
from coop_envs.localization.planar.se2 import Array
from coop_envs.localization.planar.settings import PlanarSettings
from coop_envs.localization.planar.stepper import PlanarEstimate, PlanarState, PlanarStepper
from coop_envs.localization.planar.teams import TEAM, WORLD
from coop_envs.localization.result import Path, Result
from coop_envs.localization.timeline import Order, Timeline

Progress = Callable[[float], None]


def localize_planar(log: Log, settings: PlanarSettings | None = None, progress: Progress | None = None) -> Result:
    """Paths of a planar log's robots, in the world if known landmarks or fixes tell of it, else in the team's frame.

    The events are played in their order, as they arrived. Without starts and world the first robot's first place is the
    frame. ``progress`` is told the share that is done.

    Raises:
        ConfigError: no odometry; an event of a robot that the log does not name, or that sees itself; numbers that are
            not finite, ranges and sigmas that are not positive.
    """
    settings = settings or PlanarSettings()
    events = [event for event in log.events if isinstance(event, Odometry | RangeBearing | Fix)]
    if not any(isinstance(event, Odometry) for event in events):
        raise ConfigError("odometry", "no row", "odometry, or a team (team.yaml or --team) whose IMUs and poses tell")
    for event in events:
        check(event, log.robots)
    player = _player(log, events, settings)
    newest_s = -math.inf
    for k, event in enumerate(events):
        player.add(event)
        if event.time_s > newest_s + settings.longest_s:
            newest_s = event.time_s
            player.advance(newest_s - settings.longest_s)
            if progress is not None:
                progress((k + 1) / len(events))
    player.finish()
    ignored = len(log.events) - len(events)
    notes = (f"{ignored} rows of IMUs and relative poses left out: this team is planar",) if ignored else ()
    return player.result((*log.notes, *notes))


class PlanarPlayer:
    """A stepper on its timeline: `add` events in any order, `advance`, `finish`, read the `result`."""

    def __init__(self, stepper: PlanarStepper, settings: PlanarSettings, start_s: float) -> None:
        self.stepper = stepper
        order: Order[Event] = Order(
            time_s=lambda event: event.time_s,
            stream=_stream,
            marks=lambda event: isinstance(event, RangeBearing | Fix),
            reach_s=lambda _: 0.0,
            longest_s=settings.longest_s,
            horizon_s=settings.horizon_s,
        )
        self.timeline: Timeline[Event, PlanarState] = Timeline(stepper, order, start_s)
        self.add, self.advance, self.finish = self.timeline.add, self.timeline.advance, self.timeline.finish

    def result(self, notes: tuple[str, ...] = ()) -> Result:
        """What is known so far."""
        stepper, filters = self.stepper, self.stepper.teams.filters
        frame = WORLD if WORLD in filters and filters[WORLD].names else TEAM
        landmarks = {} if frame not in filters else stepper.teams.landmarks(frame)
        evidence = "four sightings or two fixes" if WORLD in filters else "four sightings"
        unplaced = tuple(
            f"{name}: never placed, no {evidence} agreed on where it is"
            for k, name in enumerate(stepper.robots)
            if not any(estimate.frame[k] == frame for estimate in stepper.estimates)
        )
        return Result(
            paths={name: path for k, name in enumerate(stepper.robots) if len((path := self._path(k, frame)).time_s)},
            happenings=tuple(sorted(stepper.happenings, key=lambda one: one.time_s)),
            frame="world" if frame == WORLD else "team",
            planar=True,
            counts={**vars(self.timeline.counts), "outlier": stepper.outliers},
            landmarks=landmarks,
            notes=(*notes, *unplaced),
        )

    def _path(self, k: int, frame: str) -> Path:
        """The path of robot k in one frame; what was noted in the team's before that was placed is carried over."""
        placed = self.stepper.teams.placed if frame == WORLD else None
        rows: list[tuple[float, Array, Array]] = []
        for estimate in self.stepper.estimates:
            if estimate.frame[k] == frame:
                rows.append((estimate.time_s, estimate.pose[k], estimate.covariance[k]))
            elif estimate.frame[k] == TEAM and placed is not None:
                rows.append((estimate.time_s, *_carried(estimate, k, *placed)))
        return spatial([row[0] for row in rows], [row[1] for row in rows], [row[2] for row in rows])


def _player(log: Log, events: Sequence[Event], settings: PlanarSettings) -> PlanarPlayer:
    world = bool(log.landmarks) or any(isinstance(event, Fix) for event in events)
    starts = dict(log.starts)
    if not starts and not world:
        starts = {log.robots[0]: (0.0, 0.0, 0.0)}
    start_s = min(event.time_s for event in events)
    usual_s = np.array([_usual_s(events, name) for name in log.robots])
    stepper = PlanarStepper(log.robots, starts, log.landmarks, usual_s, world, settings, start_s)
    return PlanarPlayer(stepper, settings, start_s)


def _usual_s(events: Sequence[Event], robot: str) -> float:
    """How long a robot's odometry usually waits for its next row."""
    times = sorted(event.time_s for event in events if isinstance(event, Odometry) and event.robot == robot)
    return float(np.median([b - a for a, b in pairwise(times)])) if len(times) > 1 else 0.0


def check(event: Odometry | RangeBearing | Fix, robots: Sequence[str]) -> None:
    """Refuse an event that the filter must not hear of."""
    require(event.robot in robots, "robot", event.robot, f"one of {', '.join(robots)}")
    match event:
        case Odometry():
            numbers = {"forward_m_s": event.forward_m_s, "yaw_rate_rad_s": event.yaw_rate_rad_s}
        case RangeBearing():
            require(event.subject != event.robot, "range_bearing.subject", event.subject, "another than the seer")
            numbers = {"range_m": event.range_m, "bearing_rad": event.bearing_rad}
            for name in ("range_m", "range_sigma_m", "bearing_sigma_rad"):
                value = getattr(event, name)
                require(0 < value < math.inf, f"range_bearing.{name}", value, "a positive number")
        case Fix():
            numbers = {f"position[{k}]": float(x) for k, x in enumerate(event.position)}
            size = 3 if event.rotation is None else 6
            C = np.asarray(event.covariance)
            sound = C.shape == (size, size) and np.allclose(C, C.T) and bool(np.linalg.eigvalsh(C)[0] > 0)
            require(sound, "fixes.covariance", C.tolist(), f"a symmetric positive {size} x {size} matrix")
    for name, value in {"time_s": event.time_s, **numbers}.items():
        require(math.isfinite(value), name, value, "a finite number")


def _stream(event: Event) -> Hashable:
    match event:
        case RangeBearing():
            return "range", event.robot, event.subject
        case _:
            return type(event).__name__, event.robot


def _carried(estimate: PlanarEstimate, k: int, pose: Array, covariance: Array) -> tuple[Array, Array]:
    """A pose (3,) and covariance of yaw, x, y in the world, the team's frame lying at ``pose`` there."""
    back = np.linalg.inv(plain_jacobian(estimate.pose[k]))
    left = back @ estimate.covariance[k] @ back.T
    moved = carried(PlanarSnapshot(("",), estimate.pose[k][None], left, np.zeros(1)), pose, covariance)
    A = plain_jacobian(moved.pose[0])
    return moved.pose[0], A @ moved.covariance @ A.T


def spatial(time_s: Sequence[float], pose: Sequence[Array], covariance: Sequence[Array]) -> Path:
    """Poses (3,) and covariances (3, 3) of yaw, x, y as a path in space."""
    T = len(time_s)
    position, rotation, whole = np.zeros((T, 3)), np.tile(np.eye(3), (T, 1, 1)), np.zeros((T, 6, 6))
    if T:
        poses = np.array(pose)
        position[:, :2], rotation[:, :2, :2] = poses[:, :2], se2.rotation(poses[:, 2])
        whole[:, 2:5, 2:5] = np.array(covariance)
    return Path(np.array(time_s), position, rotation, whole)

"""Robots that drive by odometry: exact arcs, errors that grow on the way, gaps in which they may be anywhere near."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from coop_envs.localization.logs.events import Event, Odometry
from coop_envs.localization.planar import se2
from coop_envs.localization.planar.se2 import Array
from coop_envs.localization.planar.settings import PlanarSettings
from coop_envs.localization.result import Kind
from coop_envs.localization.timeline import Window

USUALS = 5.0
"""Odometry is missed after so many of its usual intervals."""


def driven(
    settings: PlanarSettings, forward_m_s: Array, yaw_rate_rad_s: Array, time_s: Array | float
) -> tuple[Array, Array]:
    """The poses (M, 3) reached along exact arcs, in the axes at their beginning, and the covariance (M, 3, 3) of what
    odometry misses, as errors at their end in the robot's own axes.
    """
    ahead, turn = np.abs(forward_m_s * time_s), np.abs(yaw_rate_rad_s * time_s)
    twist, variance = np.zeros((2, *ahead.shape, 3))
    twist[..., 0], twist[..., 1] = yaw_rate_rad_s * time_s, forward_m_s * time_s
    variance[..., 0] = settings.yaw_rad_rtm**2 * ahead + settings.yaw_rad_rtrad**2 * turn
    variance[..., 1] = settings.forward_m_rtm**2 * ahead + settings.turn_m_rtrad**2 * turn
    variance[..., 2] = settings.sideways_m_rtm**2 * ahead + settings.turn_m_rtrad**2 * turn
    J = se2.right_jacobian(twist)
    return se2.exp(twist), (J * variance[..., None, :]) @ np.swapaxes(J, -1, -2)


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Robots (M,) go by steps (M, 3) in their own axes; ``noise`` (M, 3, 3) as of `driven`."""

    robots: NDArray[np.intp]
    step: Array
    noise: Array


@dataclass(frozen=True, slots=True, eq=False)
class Reckoned:
    """Where dead reckoning alone has a robot, (3,), in a frame of its own, and the covariance (3, 3) of its error."""

    pose: Array
    spread: Array


STILL = Reckoned(np.zeros(3), np.zeros((3, 3)))


@dataclass(frozen=True, slots=True)
class Driver:
    """How a robot drives: its speeds until its next row, when it was last heard, whether it still counts."""

    forward_m_s: float = 0.0
    yaw_rate_rad_s: float = 0.0
    heard_s: float = 0.0
    state: Literal["heard", "gap", "left"] = "heard"


@dataclass(frozen=True, slots=True, eq=False)
class DriversSnapshot:
    """Everything that `Drivers` hold."""

    drivers: tuple[Driver, ...]
    track: Array
    spread: Array


class Drivers:
    """All robots by their odometry, and where each has come to by it alone since the start.

    ``usual_s`` (N,) is how often each robot's odometry usually comes; ``happen`` is told time, kind, robot and detail
    of what is news.
    """

    def __init__(
        self,
        robots: tuple[str, ...],
        usual_s: Array,
        settings: PlanarSettings,
        start_s: float,
        happen: Callable[[float, Kind, str, str], None],
    ) -> None:
        self._robots, self._settings, self._happen = robots, settings, happen
        self._index = {name: k for k, name in enumerate(robots)}
        self._patience_s = np.maximum(settings.gap_s, USUALS * usual_s).tolist()
        self._drivers = [Driver(heard_s=start_s) for _ in robots]
        self._track, self._spread = np.zeros((len(robots), 3)), np.zeros((len(robots), 3, 3))

    def snapshot(self) -> DriversSnapshot:
        """The whole state."""
        return DriversSnapshot(tuple(self._drivers), self._track.copy(), self._spread.copy())

    def restore(self, snapshot: DriversSnapshot) -> None:
        """Go back to a state."""
        self._drivers, self._track, self._spread = list(snapshot.drivers), snapshot.track.copy(), snapshot.spread.copy()

    def left(self, name: str) -> bool:
        """Whether a robot was silent for so long that it does not count any more."""
        return name in self._index and self._drivers[self._index[name]].state == "left"

    def reckoned(self, name: str) -> Reckoned:
        """Where a robot, or a landmark, has come to since the start."""
        k = self._index.get(name)
        return STILL if k is None else Reckoned(self._track[k].copy(), self._spread[k].copy())

    def drive(self, window: Window[Event]) -> tuple[list[Move], list[str]]:
        """Carry all robots to the window's end, each from row to row of its odometry; their moves, and who left."""
        legs, moves = self._legs(window), []
        for leg in range(max(map(len, legs), default=0)):
            chosen = np.array([k for k, own in enumerate(legs) if len(own) > leg])
            forward, turn, time_s = np.array([legs[k][leg] for k in chosen]).T
            moves.append(Move(chosen, *driven(self._settings, forward, turn, time_s)))
        moves += [self._astray(k, window) for k in range(len(self._robots)) if self._is_missed(k, window)]
        for move in moves:
            self._reckon(move)
        return moves, [name for k, name in enumerate(self._robots) if self._leaves(k, window)]

    def _legs(self, window: Window[Event]) -> list[list[tuple[float, float, float]]]:
        """Speeds (m/s, rad/s) and times (s) of every robot's ways between rows."""
        legs: list[list[tuple[float, float, float]]] = [[] for _ in self._robots]
        reached_s = [window.start_s] * len(self._robots)
        for event in window.events:
            if isinstance(event, Odometry):
                k = self._index[event.robot]
                self._add_leg(legs[k], k, reached_s[k], event.time_s)
                reached_s[k] = event.time_s
                self._hear(k, event)
        for k, own in enumerate(legs):
            self._add_leg(own, k, reached_s[k], window.end_s)
        return legs

    def _add_leg(self, legs: list[tuple[float, float, float]], k: int, since_s: float, until_s: float) -> None:
        """A robot keeps its speeds, but no longer than odometry is patiently waited for."""
        driver = self._drivers[k]
        held_s = min(until_s, driver.heard_s + self._patience_s[k]) - since_s
        if driver.state == "heard" and held_s > 0:
            legs.append((driver.forward_m_s, driver.yaw_rate_rad_s, held_s))

    def _hear(self, k: int, row: Odometry) -> None:
        driver = self._drivers[k]
        if driver.state != "heard":
            self._happen(row.time_s, Kind.BACK, row.robot, f"after {row.time_s - driver.heard_s:.2f} s")
        self._drivers[k] = Driver(row.forward_m_s, row.yaw_rate_rad_s, row.time_s)

    def _reckon(self, move: Move) -> None:
        self._track[move.robots] = se2.composed(self._track[move.robots], move.step)
        axes = se2.adjoint(self._track[move.robots])
        self._spread[move.robots] += axes @ move.noise @ np.swapaxes(axes, -1, -2)

    def _is_missed(self, k: int, window: Window[Event]) -> bool:
        """Whether a robot's odometry fails to come."""
        driver = self._drivers[k]
        return driver.state != "left" and window.end_s - driver.heard_s > self._patience_s[k]

    def _astray(self, k: int, window: Window[Event]) -> Move:
        """A robot whose odometry fails may be anywhere near."""
        s, driver = self._settings, self._drivers[k]
        silent_s = window.end_s - driver.heard_s
        if driver.state == "heard":
            self._happen(window.end_s, Kind.GAP, self._robots[k], f"no odometry for {silent_s:.2f} s")
            self._drivers[k] = dataclasses.replace(driver, state="gap")
        open_s = silent_s - self._patience_s[k]
        before_s = max(0.0, window.start_s - driver.heard_s - self._patience_s[k])
        noise = np.diag([s.unheard_rad_s, s.unheard_m_s, s.unheard_m_s]) ** 2 * (open_s**2 - before_s**2)
        return Move(np.array([k]), np.zeros((1, 3)), noise[None])

    def _leaves(self, k: int, window: Window[Event]) -> bool:
        """Whether a robot's odometry failed for so long that it may be anywhere; from then on it does not count."""
        driver = self._drivers[k]
        if not self._is_missed(k, window) or window.end_s - driver.heard_s <= self._settings.leave_s:
            return False
        self._drivers[k] = dataclasses.replace(driver, state="left")
        self._happen(window.end_s, Kind.LEFT, self._robots[k], "")
        return True

"""Driving one robot: turn-then-drive to a point, along a path, and out of a place where it is blocked."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.team_view import RobotView, wrapped
from coop_envs.agents.team import Member

TURN_FIRST_RAD = 0.5  # a heading error beyond this is turned away before driving on
SAMPLE_M = 0.01


@dataclass(frozen=True, slots=True)
class Drive:
    """Forward speed in m/s and yaw rate in rad/s, left positive."""

    forward_m_s: float = 0.0
    turn_rad_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Scan:
    """A raster: its width as a share of the laser's full one, its centre left and up of the robot's heading (rad)."""

    share: float
    azimuth_rad: float = 0.0
    elevation_rad: float = 0.0


STILL = Drive()
_HOLD = np.array([1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0], dtype=np.float32)
DARK_HOLD = np.array([1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, -1.0], dtype=np.float32)


def action(drive: Drive, member: Member) -> NDArray[np.float32]:
    """The action (8,) for a drive; standing still is an explicit hold. LEDs are lit fully, the laser stays off."""
    answer = _HOLD.copy()
    if drive != STILL:
        answer[0] = -1.0
        answer[1] = min(1.0, max(-1.0, drive.forward_m_s / member.cruise_speed_m_s))
        answer[2] = min(1.0, max(-1.0, drive.turn_rad_s / member.cruise_yaw_rate_rad_s))
    return answer


def scan_action(scan: Scan, member: Member) -> NDArray[np.float32]:
    """The action (8,) of standing still and drawing a raster."""
    assert member.laser is not None
    answer = _HOLD.copy()
    reach = member.laser.max_deflection_rad
    answer[4:7] = scan.share, scan.azimuth_rad / reach, scan.elevation_rad / reach
    return answer


def turn_to(bearing_rad: float, turn_rad_s: float) -> Drive:
    """Turn in place towards a bearing (from the robot's heading)."""
    return Drive(0.0, min(turn_rad_s, max(-turn_rad_s, 2.0 * bearing_rad)))


def drive_to(robot: RobotView, xy: tuple[float, float], speed_m_s: float, turn_rad_s: float) -> Drive:
    """Turn towards a point, then drive there, correcting the heading on the way."""
    bearing = robot.bearing_to(xy)
    turn = min(turn_rad_s, max(-turn_rad_s, 2.0 * bearing))
    if abs(bearing) > TURN_FIRST_RAD:
        return Drive(0.0, turn)
    return Drive(speed_m_s * math.cos(bearing), turn)


class PathFollower:
    """Where on a path to aim: a short way ahead of the point nearest the robot, never backwards."""

    def __init__(self, path_m: NDArray[np.float64], lookahead_m: float) -> None:
        self.points = _resampled(path_m)
        self.off_m = 0.0
        self._ahead = max(1, round(lookahead_m / SAMPLE_M))
        self._at = 0

    def target(self, xy: tuple[float, float]) -> tuple[float, float]:
        """The point to aim at from here; ``off_m`` then is the distance from the path."""
        window = self.points[self._at : self._at + 2 * self._ahead + 1]
        distance = np.hypot(window[:, 0] - xy[0], window[:, 1] - xy[1])
        nearest = int(np.argmin(distance))
        self._at += nearest
        self.off_m = float(distance[nearest])
        x, y = self.points[min(self._at + self._ahead, len(self.points) - 1)].tolist()
        return x, y

    @property
    def end(self) -> tuple[float, float]:
        x, y = self.points[-1].tolist()
        return x, y

    @property
    def remaining(self) -> NDArray[np.float64]:
        """The points (k, 2) still ahead."""
        return self.points[self._at :]


class StallWatch:
    """Notices a robot that over ``WINDOW_S`` makes less than a fifth of the way, or of the turn, it is told to."""

    WINDOW_S, MOVED = 1.0, 0.2

    def __init__(self, speed_m_s: float, turn_rad_s: float, decision_s: float) -> None:
        self._decision_s = decision_s
        self._way_m, self._turn_rad = 0.3 * self.WINDOW_S * speed_m_s, 0.3 * self.WINDOW_S * turn_rad_s
        self._past: deque[tuple[RobotView, Drive]] = deque(maxlen=max(2, round(self.WINDOW_S / decision_s)))

    def note(self, robot: RobotView, drive: Drive) -> None:
        """Remember where the robot was when it was told this drive."""
        self._past.append((robot, drive))

    def forget(self) -> None:
        self._past.clear()

    def stalled(self, robot: RobotView) -> bool:
        """Whether the robot, being here now, stalls."""
        if len(self._past) < (self._past.maxlen or 0):
            return False
        before = self._past[0][0]
        way = abs(sum(drive.forward_m_s for _, drive in self._past)) * self._decision_s
        turn = abs(sum(drive.turn_rad_s for _, drive in self._past)) * self._decision_s
        if way > self._way_m:
            return before.distance_to(robot.xy) < self.MOVED * way
        return turn > self._turn_rad and abs(wrapped(robot.yaw - before.yaw)) < self.MOVED * turn


class ScoutDriver:
    """Drives one expendable robot to points, and backs out and turns when it stalls.

    Backing out and turning are commanded in turn, so a robot that can do neither is soon declared stuck by the belief.
    """

    BACK_OUT_S, BACK_OUT_PACE, TURN_AWAY_S = 0.6, 0.5, 0.6

    def __init__(self, member: Member, decision_s: float, rng: np.random.Generator) -> None:
        self.blocked = False
        self._speed_m_s, self._turn_rad_s = member.cruise_speed_m_s, member.cruise_yaw_rate_rad_s
        self._decision_s, self._rng = decision_s, rng
        self._stall = StallWatch(self._speed_m_s, self._turn_rad_s, decision_s)
        self._escape: list[Drive] = []

    def go(self, robot: RobotView, target: tuple[float, float], pace: float = 1.0) -> Drive:
        """Drive towards a point at a share of the cruise speed; ``blocked`` is true where an escape begins."""
        self.blocked = not self._escape and self._stall.stalled(robot)
        if self.blocked:
            self._stall.forget()
            self._escape = self._way_out()
        drive = self._escape.pop(0) if self._escape else self._on(robot, target, pace)
        self._stall.note(robot, drive)
        return drive

    def _on(self, robot: RobotView, target: tuple[float, float], pace: float) -> Drive:
        return drive_to(robot, target, pace * self._speed_m_s, self._turn_rad_s)

    def _way_out(self) -> list[Drive]:
        back = Drive(-self.BACK_OUT_PACE * self._speed_m_s, 0.0)
        away = Drive(0.0, float(self._rng.choice([-1.0, 1.0])) * self._turn_rad_s)
        return [back] * round(self.BACK_OUT_S / self._decision_s) + [away] * round(self.TURN_AWAY_S / self._decision_s)


def _resampled(path_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same path as points (k, 2) a centimetre apart."""
    lengths = np.hypot(*np.diff(path_m, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    places = np.linspace(0.0, along[-1], max(2, round(along[-1] / SAMPLE_M) + 1))
    return np.stack([np.interp(places, along, path_m[:, axis]) for axis in (0, 1)], axis=-1)

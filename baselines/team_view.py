"""What a central policy reads from the observations: each robot's believed pose in the team frame, landmarks, goal."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from coop_envs.observations import MATE_FIELDS, SELF_FIELDS
from coop_envs.policy import Observations, TeamDescription

_SELF_SCALE = np.array([field.scale for field in SELF_FIELDS])
_MATE_SCALE = np.array([field.scale for field in MATE_FIELDS])
_SELF = {field.name: index for index, field in enumerate(SELF_FIELDS)}
_MATE = {field.name: index for index, field in enumerate(MATE_FIELDS)}


@dataclass(frozen=True, slots=True)
class RobotView:
    """One live robot as the belief has it, team frame.

    ``in_view`` says that some camera of the team sees its hat; ``window_m`` is the lower corner of its map window;
    ``scanned`` the share of its raster that is done, ``points`` what the team's scans measured in the last decision.
    """

    name: str
    x: float
    y: float
    yaw: float
    sigma_m: float
    stationary: bool
    in_view: bool
    window_m: tuple[float, float]
    docked: bool
    scanned: float
    points: int

    @property
    def xy(self) -> tuple[float, float]:
        return self.x, self.y

    def bearing_to(self, xy: tuple[float, float]) -> float:
        """Angle from the robot's heading to a point, left positive."""
        return wrapped(math.atan2(xy[1] - self.y, xy[0] - self.x) - self.yaw)

    def distance_to(self, xy: tuple[float, float]) -> float:
        return math.hypot(xy[0] - self.x, xy[1] - self.y)


@dataclass(frozen=True, slots=True)
class Landmark:
    """A mate as the leader knows it, team frame."""

    x: float
    y: float
    sigma_m: float
    lost: bool
    docked: bool
    stationary: bool
    in_view: bool

    @property
    def xy(self) -> tuple[float, float]:
        return self.x, self.y


@dataclass(frozen=True, slots=True)
class TeamView:
    """The leader (first observer), the live scouts outside the dock, the leader's mates, and the task's state."""

    leader: RobotView
    scouts: tuple[RobotView, ...]
    landmarks: tuple[Landmark, ...]
    goal: tuple[float, float] | None
    time_left_s: float
    reserves_left: int

    @property
    def bodies(self) -> tuple[RobotView | Landmark, ...]:
        """Everybody who may stand in somebody's way."""
        return self.leader, *self.scouts, *(mark for mark in self.landmarks if mark.lost)


def read_team(observations: Observations, team: TeamDescription) -> TeamView | None:
    """The team's state from one decision's observations; None when the first observer is not among them."""
    leader_name = team.names[0]
    if leader_name not in observations:
        return None
    leader, values = _read_robot(leader_name, observations[leader_name])
    others = [(name, observations[name]) for name in team.names[1:] if name in observations]
    goal = None
    if values[_SELF["goal_known"]] > 0.5:
        goal = _to_team(leader, values[_SELF["goal_x"]], values[_SELF["goal_y"]])
    return TeamView(
        leader=leader,
        scouts=tuple(robot for robot in (_read_robot(name, seen)[0] for name, seen in others) if not robot.docked),
        landmarks=_read_landmarks(leader, observations[leader_name]),
        goal=goal,
        time_left_s=values[_SELF["time_left"]] * team.time_limit_s,
        reserves_left=round(values[_SELF["reserves_left"]]),
    )


def read_robots(
    observations: Observations, team: TeamDescription
) -> tuple[tuple[RobotView, ...], tuple[Landmark, ...]]:
    """All live robots outside the dock, in the team's order, and the lost ones; no robot leads here."""
    seen = [(name, observations[name]) for name in team.names if name in observations]
    robots = tuple(_read_robot(name, observation)[0] for name, observation in seen)
    if not robots:
        return (), ()
    lost = tuple(mark for mark in _read_landmarks(robots[0], seen[0][1]) if mark.lost)
    return tuple(robot for robot in robots if not robot.docked), lost


def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def _read_robot(name: str, observation: dict[str, np.ndarray]) -> tuple[RobotView, list[float]]:
    values: list[float] = (observation["self"] * _SELF_SCALE).tolist()
    seen = observation["mates"][:, _MATE["sees_me"]] * observation["mask"]
    robot = RobotView(
        name=name,
        x=values[_SELF["x"]],
        y=values[_SELF["y"]],
        yaw=math.atan2(values[_SELF["sin_yaw"]], values[_SELF["cos_yaw"]]),
        sigma_m=math.exp(values[_SELF["log_sigma_position"]]),
        stationary=values[_SELF["stationary"]] > 0.5,
        in_view=bool(seen.max() > 0.5),
        window_m=(values[_SELF["map_x"]], values[_SELF["map_y"]]),
        docked=values[_SELF["docked"]] > 0.5,
        scanned=values[_SELF["scan_progress"]],
        points=round(values[_SELF["points"]]),
    )
    return robot, values


def _read_landmarks(leader: RobotView, observation: dict[str, np.ndarray]) -> tuple[Landmark, ...]:
    landmarks = []
    for row in (observation["mates"][observation["mask"] > 0] * _MATE_SCALE).tolist():
        x, y = _to_team(leader, row[_MATE["x"]], row[_MATE["y"]])
        lost, docked = row[_MATE["lost"]] > 0.5, row[_MATE["docked"]] > 0.5
        landmarks.append(
            Landmark(
                x,
                y,
                math.exp(row[_MATE["log_sigma_position"]]),
                lost,
                docked,
                row[_MATE["stationary"]] > 0.5,
                row[_MATE["i_see"]] > 0.5,
            )
        )
    return tuple(landmarks)


def _to_team(robot: RobotView, forward: float, left: float) -> tuple[float, float]:
    c, s = math.cos(robot.yaw), math.sin(robot.yaw)
    return robot.x + c * forward - s * left, robot.y + s * forward + c * left

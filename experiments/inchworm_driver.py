"""Driving an inchworm team by sight of the truth, as the thesis's people drove theirs: courses and a driver.

A course is a list of legs; in a leg some robots go to a pose and turn to face a heading while the others rest. Pickets
go ahead, then the observer catches up; an increment is over when each robot has moved once (thesis section 5.3.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import require

Array = NDArray[np.float64]
Path = Callable[[float], tuple[float, float, float]]
Style = Literal["inchworm", "leapfrog", "cps"]

INCREMENTS = 10
DRIVING, TURNING, THERE = 0, 1, 2
OBSERVER = 0
FAN_SLOPES = (0.18, -0.16, 0.07, -0.06, 0.12, -0.12, 0.0, 0.17)


@dataclass(frozen=True)
class Leg:
    """Robots that move, and the poses (N, 3) they go to: x, y, facing yaw in the world; NaN for those that rest."""

    goals: Array

    @property
    def movers(self) -> tuple[int, ...]:
        return tuple(np.flatnonzero(np.isfinite(self.goals[:, 0])).tolist())


@dataclass(frozen=True)
class Pace:
    """How people drive: speeds, most and least; how soon they slow down; how close they come; how long all rest."""

    speed_m_s: float = 0.2
    yaw_rate_rad_s: float = 0.8
    least_m_s: float = 0.008
    least_rad_s: float = 0.0125
    slow_1_s: float = 2.0
    reach_m: float = 0.004
    aim_rad: float = 0.005
    settle_s: float = 1.0
    patience_s: float = 12.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(value > 0, f"pace.{name}", value, "more than 0")


@dataclass(frozen=True)
class Plan:
    """A path by its length, the observer's stops along it (k + 1,), each picket's lead and offset to the left (n, 2).

    Leads end at ``end_m``; picket ``left_behind[0]`` stays where it is after increment ``left_behind[1]``.
    """

    path: Path
    stops_m: tuple[float, ...]
    posts_m: tuple[tuple[float, float], ...]
    style: Style = "inchworm"
    end_m: float = np.inf
    left_behind: tuple[int, int] | None = None
    pace: Pace = field(default_factory=Pace)


def bend(straight_m: float, radius_m: float, turn_rad: float, start: tuple[float, float]) -> Path:
    """Along x, an arc (left positive), and straight on."""

    def path(s: float) -> tuple[float, float, float]:
        x, y = start
        side, arc_m = np.sign(turn_rad), radius_m * abs(turn_rad)
        angle = float(np.clip((s - straight_m) / radius_m, 0.0, abs(turn_rad)))
        beyond = max(s - straight_m - arc_m, 0.0)
        yaw = side * angle
        at_x = x + min(s, straight_m) + radius_m * np.sin(angle) + beyond * np.cos(yaw)
        at_y = y + side * radius_m * (1.0 - np.cos(angle)) + beyond * np.sin(yaw)
        return float(at_x), float(at_y), float(yaw)

    return path


def fan(pickets: int) -> tuple[tuple[float, float], ...]:
    """Leads and offsets of so many pickets before the observer, at most eight, so that few hide one another."""
    if pickets == 1:
        return ((0.6, 0.0),)
    leads = [0.55 + (0.16 if pickets <= 4 else 0.13) * k for k in range(pickets)]
    return tuple((lead, slope * lead) for lead, slope in zip(leads, FAN_SLOPES[:pickets], strict=True))


def u_turn(pickets: int = 2, style: Style = "inchworm", pace: Pace | None = None) -> Plan:
    """Five metres out, round and back in the scenario ``u_turn``; pickets stop before the edge of its ground."""
    path = bend(1.56, 0.6, np.pi, (-1.5, -0.6))
    stops = tuple(np.linspace(0.0, 4.9, INCREMENTS + 1))
    return Plan(path, stops, fan(pickets), style, end_m=5.4, pace=pace or Pace())


def straight(pickets: int, pace: Pace | None = None) -> Plan:
    """Five metres straight on, which keeps many pickets in view; they move in formation, for none can pass another."""
    stops = tuple(np.linspace(0.0, 5.0, INCREMENTS + 1))
    return Plan(bend(np.inf, 1.0, 0.0, (-4.0, 0.0)), stops, fan(pickets), "cps", pace=pace or Pace())


def ramp(pace: Pace | None = None) -> Plan:
    """Three increments through the rocks of the scenario ``ramp``, seven round the corner and up; a hole for one."""
    path = bend(1.95, 0.45, -np.pi / 2, (0.0, 0.0))
    stops = np.concatenate([np.linspace(0.0, 1.86, 4), np.linspace(1.86, 4.7, 8)[1:]])
    posts = ((0.5, -0.02), (0.65, 0.18))
    return Plan(path, tuple(stops), posts, end_m=5.02, left_behind=(2, 3), pace=pace or Pace())


def legs_of(plan: Plan) -> tuple[Leg, ...]:
    """The legs of all increments in order, after one in which all rest."""
    legs = [Leg(np.full((len(plan.posts_m) + 1, 3), np.nan))]
    here = [post_of(plan, robot, 0) for robot in range(len(plan.posts_m) + 1)]
    for k in range(1, len(plan.stops_m)):
        movers = [r for r in range(len(here)) if r == OBSERVER or not _stays(plan, r, k)]
        goals = {r: post_of(plan, r, k) for r in movers}
        goals[OBSERVER] = _facing(plan, k, movers)
        for group in _groups(plan.style, movers, k):
            goal = np.full((len(here), 3), np.nan)
            for r in group:
                goal[r] = goals[r]
            legs.append(Leg(goal))
    return tuple(legs)


def _stays(plan: Plan, robot: int, increment: int) -> bool:
    return plan.left_behind is not None and robot == plan.left_behind[0] and increment > plan.left_behind[1]


def _groups(style: Style, movers: Sequence[int], increment: int) -> list[tuple[int, ...]]:
    """Who moves together, one group after another.

    ``inchworm`` lets a picket and the observer move at once in every other increment, as Fig 5.1 (f) does; here the
    last picket, so that the first, which Table 5.2 keeps where it drops the other, rests whenever the observer moves.
    ``cps`` never mixes them; in ``leapfrog`` one robot moves at a time (Fig 5.1 a-c).
    """
    pickets = tuple(r for r in movers if r != OBSERVER)
    if style == "leapfrog":
        return [(r,) for r in (*reversed(pickets), OBSERVER)]
    if style == "inchworm" and increment % 2 == 0 and len(pickets) > 1:
        return [pickets[:-1], (OBSERVER, pickets[-1])]
    return [pickets, (OBSERVER,)]


def post_of(plan: Plan, robot: int, increment: int) -> tuple[float, float, float]:
    """Where a robot stands after an increment."""
    lead, left = (0.0, 0.0) if robot == OBSERVER else plan.posts_m[robot - 1]
    x, y, yaw = plan.path(min(plan.stops_m[increment] + lead, plan.end_m))
    return x - left * np.sin(yaw), y + left * np.cos(yaw), yaw


def _facing(plan: Plan, increment: int, movers: Sequence[int]) -> tuple[float, float, float]:
    """The observer's pose after an increment, turned so that it sees where its pickets are and where they go next."""
    x, y, yaw = post_of(plan, OBSERVER, increment)
    after = min(increment + 1, len(plan.stops_m) - 1)
    stays = [r for r in movers if r != OBSERVER and not _stays(plan, r, after)]
    spots = np.array([post_of(plan, r, k)[:2] for r in stays for k in (increment, after)])
    bearing = np.arctan2(spots[:, 1] - y, spots[:, 0] - x) - yaw
    bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
    return x, y, yaw + float(bearing.min() + bearing.max()) / 2


class Driver:
    """Drives B teams leg by leg; each goes on as its own robots arrive."""

    def __init__(self, legs: Sequence[Leg], pace: Pace, teams: int, tick_s: float) -> None:
        self.goals = np.stack([leg.goals for leg in legs])
        self.pace, self.tick_s = pace, tick_s
        self.leg = np.zeros(teams, dtype=int)
        self.spent_s, self.rested_s = np.zeros(teams), np.zeros(teams)
        self.stage = np.full((teams, self.goals.shape[1]), DRIVING)
        self._open(np.ones(teams, dtype=bool))

    @property
    def done(self) -> NDArray[np.bool_]:
        """(B,) which teams have arrived and rested."""
        return self.leg >= len(self.goals)

    def command(self, position: Array, yaw: Array) -> tuple[Array, Array]:
        """Forward speed and yaw rate (B, N) of all robots at ``position`` (B, N, 3) with heading ``yaw`` (B, N)."""
        goal = self.goals[np.minimum(self.leg, len(self.goals) - 1)]
        away = goal[..., :2] - position[..., :2]
        distance = np.linalg.norm(away, axis=-1)
        self.stage[(self.stage == DRIVING) & (distance < self.pace.reach_m)] = TURNING
        heading = np.where(self.stage == DRIVING, np.arctan2(away[..., 1], away[..., 0]), goal[..., 2])
        error = np.nan_to_num(np.arctan2(np.sin(heading - yaw), np.cos(heading - yaw)))
        self.stage[(self.stage == TURNING) & (np.abs(error) < self.pace.aim_rad)] = THERE
        speed, turn = self._speeds(np.nan_to_num(distance), error)
        self._pass_time()
        return speed, turn

    def _speeds(self, distance: Array, error: Array) -> tuple[Array, Array]:
        """Slower as the goal comes near, and on the spot where it is not ahead."""
        pace = self.pace
        ahead = (self.stage == DRIVING) & (np.abs(error) < 0.5)
        speed = np.clip(pace.slow_1_s * distance, pace.least_m_s, pace.speed_m_s) * np.cos(error)
        turn = np.clip(2.5 * error, -pace.yaw_rate_rad_s, pace.yaw_rate_rad_s)
        turn = np.where(ahead, turn, np.sign(error) * np.maximum(np.abs(turn), pace.least_rad_s))
        return np.where(ahead, speed, 0.0), np.where(self.stage == THERE, 0.0, turn)

    def _pass_time(self) -> None:
        self.spent_s += self.tick_s
        given_up = self.spent_s > self.pace.patience_s
        self.stage[given_up] = THERE
        arrived = (self.stage == THERE).all(axis=1)
        self.rested_s = np.where(arrived, self.rested_s + self.tick_s, 0.0)
        over = arrived & (self.rested_s > self.pace.settle_s) & ~self.done
        self.leg[over] += 1
        self._open(over)

    def _open(self, teams: NDArray[np.bool_]) -> None:
        """Start these teams' legs: their movers drive, the others are there."""
        goal = self.goals[np.minimum(self.leg, len(self.goals) - 1)]
        moves = np.isfinite(goal[..., 0]) & ~self.done[:, None]
        self.stage[teams] = np.where(moves, DRIVING, THERE)[teams]
        self.spent_s[teams] = self.rested_s[teams] = 0.0

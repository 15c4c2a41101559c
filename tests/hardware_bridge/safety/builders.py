"""Teams, situations and unicycles for the supervisor's tests."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from coop_envs.agents.catalog import load_team
from coop_envs.agents.team import Team
from hardware_bridge.command import RobotCommand
from hardware_bridge.safety import Intervention, RobotSituation, SafetyLimits, Situation, Supervisor
from hardware_bridge.safety.draft import Body, body_of

TICK_S = 1.0 / 30.0


def team_of(robots: int, robot: str = "zumy") -> Team:
    """One observer and so many pickets less one, all with lasers."""
    observer = {"role": "observer", "robot": robot, "cameras": ["lifecam"], "laser": {}}
    pickets = {"role": "picket", "robot": robot, "hat": "hat0", "laser": {}, "count": robots - 1}
    return load_team({"name": "test", "members": [observer, *([pickets] if robots > 1 else [])]})


def apart(robots: int = 2, **changes: Any) -> tuple[RobotSituation, ...]:
    """Robots on a line, 2 m from each other, all well."""
    return tuple(RobotSituation(position_m=(2.0 * k, 0.0), yaw_rad=math.pi / 2, **changes) for k in range(robots))


def wheels(*speeds: tuple[float, float], **rest: Any) -> tuple[RobotCommand, ...]:
    return tuple(RobotCommand(wheels_rad_s=pair, **rest) for pair in speeds)


@dataclass
class Rig:
    """A supervisor and its clock: each call is a tick."""

    limits: SafetyLimits = field(default_factory=SafetyLimits)
    robots: int = 2
    robot: str = "zumy"
    tick: int = 0

    def __post_init__(self) -> None:
        self.supervisor = Supervisor(self.limits, team_of(self.robots, self.robot))

    def __call__(self, wanted: Any, situation: Situation) -> tuple[list[RobotCommand], tuple[Intervention, ...]]:
        released, told = self.supervisor.release(self.tick * TICK_S, wanted, situation)
        self.tick += 1
        return [safe.command for safe in released], told

    def steady(self, wanted: Any, situation: Situation, ticks: int = 20) -> list[RobotCommand]:
        """After so many ticks of the same."""
        commands: list[RobotCommand] = []
        for _ in range(ticks):
            commands, _ = self(wanted, situation)
        return commands


@dataclass
class Unicycle:
    """A robot that follows its set-points with a first-order lag: the plant, written without the bridge's formulas."""

    x: float
    y: float
    yaw: float
    speed: float = 0.0
    yaw_rate: float = 0.0

    def drive(self, speed: float, yaw_rate: float, lag_s: float, steps: int = 4) -> None:
        for _ in range(steps):
            h = TICK_S / steps
            gain = 1.0 - math.exp(-h / lag_s)
            self.speed += gain * (speed - self.speed)
            self.yaw_rate += gain * (yaw_rate - self.yaw_rate)
            self.yaw += h * self.yaw_rate
            self.x += h * self.speed * math.cos(self.yaw)
            self.y += h * self.speed * math.sin(self.yaw)

    @property
    def situation(self) -> RobotSituation:
        resting = abs(self.speed) < 1e-3 and abs(self.yaw_rate) < 1e-2
        return RobotSituation((self.x, self.y), self.yaw, stationary=resting)


Wish = Callable[[int, list[Unicycle]], tuple[float, float]]
"""(who, everybody) -> wanted speed (m/s) and yaw rate (rad/s)."""


def drive(rig: Rig, plants: list[Unicycle], wish: Wish, seconds: float, lag_s: float, delay: int = 0) -> list[float]:
    """Let robots do what they wish under supervision, seen so many ticks late; the smallest distance of each tick."""
    seen = [[plant.situation for plant in plants]] * (delay + 1)
    body = body_of(team_of(1, rig.robot).members[0])
    distances: list[float] = []
    for _ in range(round(seconds / TICK_S)):
        wanted = tuple(RobotCommand(wheels_of(body, *wish(k, plants))) for k in range(len(plants)))
        commands, _ = rig(wanted, Situation(robots=tuple(seen[-1 - delay])))
        for plant, command in zip(plants, commands, strict=True):
            plant.drive(*twist_of(body, command.wheels_rad_s), lag_s)
        seen = [*seen[-4:], [plant.situation for plant in plants]]
        distances.append(nearest(plants))
    return distances


def nearest(plants: list[Unicycle]) -> float:
    pairs = [(a, b) for k, a in enumerate(plants) for b in plants[:k]]
    return min((math.hypot(a.x - b.x, a.y - b.y) for a, b in pairs), default=math.inf)


def wheels_of(body: Body, speed: float, yaw_rate: float) -> tuple[float, float]:
    half = yaw_rate * body.track_m / 2
    return (speed - half) / body.wheel_radius_m, (speed + half) / body.wheel_radius_m


def twist_of(body: Body, pair: tuple[float, float]) -> tuple[float, float]:
    left, right = (wheel * body.wheel_radius_m for wheel in pair)
    return (left + right) / 2, (right - left) / body.track_m

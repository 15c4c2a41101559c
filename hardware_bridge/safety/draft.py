"""`Draft`: the commands of one tick on their way through the supervisor's rules."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from coop_envs.agents.team import Member
from hardware_bridge.command import RobotCommand
from hardware_bridge.reading import Pair
from hardware_bridge.safety.situation import Intervention, RobotSituation, Situation


@dataclass(frozen=True)
class Body:
    """What the rules need of one member of the team."""

    name: str
    radius_m: float
    wheel_radius_m: float
    track_m: float
    max_speed_m_s: float
    max_yaw_rate_rad_s: float
    drive_lag_s: float
    laser: bool

    def twist(self, wheels_rad_s: Pair) -> Pair:
        """Forward speed (m/s) and yaw rate (rad/s) of wheel speeds."""
        left, right = wheels_rad_s
        return 0.5 * (left + right) * self.wheel_radius_m, (right - left) * self.wheel_radius_m / self.track_m

    def wheels(self, speed_m_s: float, yaw_rate_rad_s: float) -> Pair:
        """Wheel speeds (rad/s) of a twist.

        Source: thesis eq (6.10).
        """
        half = 0.5 * yaw_rate_rad_s * self.track_m
        return (speed_m_s - half) / self.wheel_radius_m, (speed_m_s + half) / self.wheel_radius_m


def body_of(member: Member) -> Body:
    """The body of a member."""
    robot = member.robot
    return Body(
        name=member.name,
        radius_m=robot.body_radius_m,
        wheel_radius_m=robot.wheel_radius_m,
        track_m=robot.track_m,
        max_speed_m_s=robot.max_speed_m_s,
        max_yaw_rate_rad_s=robot.max_yaw_rate_rad_s,
        drive_lag_s=robot.drive_lag_s,
        laser=member.laser is not None,
    )


@dataclass(frozen=True)
class Memory:
    """What the supervisor carries from tick to tick.

    ``driven``: whom a person has taken over and not given back; ``low``: whose battery is below the floor; ``wheels``:
    what was released; ``apart_m``: how far apart the barrier holds each two robots; ``lit_s``: how much each laser has
    used of its allowance; ``held``: (robot, rule) of the last tick's interventions.
    """

    time_s: float | None
    estop: bool
    driven: tuple[bool, ...]
    low: tuple[bool, ...]
    wheels: tuple[Pair, ...]
    apart_m: tuple[tuple[float, ...], ...]
    lit_s: tuple[float, ...]
    held: frozenset[tuple[str, str]]


def nothing_happened(robots: int) -> Memory:
    """The memory at switch-on: everybody stands."""
    no, zero = (False,) * robots, (0.0,) * robots
    return Memory(None, False, no, no, ((0.0, 0.0),) * robots, (zero,) * robots, zero, frozenset())


@dataclass(frozen=True)
class Draft:
    """Commands so far, and why they changed. ``stopped`` robots stand, whatever later rules say; their lasers are off.

    ``elapsed_s`` is the time since the last tick, never below 0.
    """

    time_s: float
    elapsed_s: float
    bodies: tuple[Body, ...]
    situation: Situation
    memory: Memory
    commands: tuple[RobotCommand, ...]
    stopped: frozenset[int] = frozenset()
    interventions: tuple[Intervention, ...] = ()

    @property
    def robots(self) -> list[tuple[int, Body, RobotSituation]]:
        """Everybody: place in the team, body, situation."""
        return list(zip(range(len(self.bodies)), self.bodies, self.situation.robots, strict=True))

    def free(self) -> list[tuple[int, Body, RobotSituation]]:
        """Everybody who is not stopped yet."""
        return [robot for robot in self.robots if robot[0] not in self.stopped]

    def alter(self, place: int, rule: str, reason: str, after: RobotCommand) -> Draft:
        """Another command for one robot, told as an intervention where it differs."""
        if after == self.commands[place]:
            return self
        told = self._told(place, rule, reason, after)
        commands = (*self.commands[:place], after, *self.commands[place + 1 :])
        return replace(self, commands=commands, interventions=(*self.interventions, told))

    def hold(self, place: int, rule: str, reason: str) -> Draft:
        """Stand one robot, its laser off and its mirror still; told where that differs from what was wanted.

        Its hat keeps its light: it is what the others find it by.
        """
        still = RobotCommand(brightness=self.commands[place].brightness)
        return replace(self.alter(place, rule, reason, still), stopped=self.stopped | {place})

    def stop(self, place: int, rule: str, reason: str) -> Draft:
        """Hold one robot for a fault, told even where it stood already."""
        held = self.hold(place, rule, reason)
        if len(held.interventions) > len(self.interventions):
            return held
        return held.tell(place, rule, reason)

    def halt(self, place: int, rule: str, reason: str) -> Draft:
        """Let one robot stand still in this tick; it may go on scanning."""
        return self.alter(place, rule, reason, replace(self.commands[place], wheels_rad_s=(0.0, 0.0)))

    def tell(self, place: int, rule: str, reason: str) -> Draft:
        """Report a fault of one robot whose command stays as it is."""
        told = self._told(place, rule, reason, self.commands[place])
        return replace(self, interventions=(*self.interventions, told))

    def remember(self, **changes: Any) -> Draft:
        """The same with another memory."""
        return replace(self, memory=replace(self.memory, **changes))

    def _told(self, place: int, rule: str, reason: str, after: RobotCommand) -> Intervention:
        name = self.bodies[place].name
        again = (name, rule) in self.memory.held
        return Intervention(self.time_s, name, rule, reason, self.commands[place], after, again)


Rule = Callable[[Draft], Draft]

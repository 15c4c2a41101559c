"""What counts as a command: finite numbers of the right count; and commands within their ranges."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any

from hardware_bridge.command import RobotCommand

LARGEST = 1e6
"""Wheel speeds and counts beyond this come from a fault, not from a wish."""


def taken(wanted: Any, robots: int) -> tuple[tuple[RobotCommand, ...], tuple[str, ...]]:
    """One command a robot, standing and dark in place of what is none, and why (nothing where it is one)."""
    if not isinstance(wanted, Sequence) or len(wanted) != robots:
        got = f"{len(wanted)} commands" if isinstance(wanted, Sequence) else type(wanted).__name__
        return (RobotCommand(),) * robots, (f"got {got}, expected {robots} commands",) * robots
    faults = tuple(fault_of(command) for command in wanted)
    return tuple(RobotCommand() if f else _plain(c) for c, f in zip(wanted, faults, strict=True)), faults


def fault_of(command: Any) -> str:
    """Why something is not a command; nothing where it is one."""
    if not isinstance(command, RobotCommand):
        return f"got {type(command).__name__}, expected a RobotCommand"
    parts = {
        "wheels_rad_s": (command.wheels_rad_s, 2),
        "brightness": ((command.brightness,), 1),
        "laser": ((command.laser,), 1),
        "galvo": (command.galvo, 2),
    }
    for name, (numbers, count) in parts.items():
        if not (isinstance(numbers, Sequence) and len(numbers) == count):
            return f"{name}: got {type(numbers).__name__}, expected {count} numbers"
        for number in numbers:
            if not _finite(number):
                got = f"{float(number):g}" if isinstance(number, Real) else type(number).__name__
                return f"{name}: got {got}, expected a finite number"
    return ""


def clipped(command: RobotCommand, max_galvo_counts: int) -> RobotCommand:
    """A command with brightness and laser within 0..1 and the mirror's move within so many counts."""
    left, up = (max(-max_galvo_counts, min(max_galvo_counts, count)) for count in command.galvo)
    brightness, laser = (max(0.0, min(1.0, share)) for share in (command.brightness, command.laser))
    return RobotCommand(command.wheels_rad_s, brightness, laser, (left, up))


def _plain(command: RobotCommand) -> RobotCommand:
    """The same in Python's own numbers."""
    left, right = command.wheels_rad_s
    count_left, count_up = command.galvo
    wheels = float(left), float(right)
    return RobotCommand(wheels, float(command.brightness), float(command.laser), (int(count_left), int(count_up)))


def _finite(number: Any) -> bool:
    return isinstance(number, Real) and not isinstance(number, bool) and bool(abs(float(number)) <= LARGEST)

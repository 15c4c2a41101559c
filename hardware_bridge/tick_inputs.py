"""`TickInputs`: everything from outside that a mission's outcome depends on, tick by tick. Replay feeds it again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from coop_envs.errors import require
from hardware_bridge.command import RobotCommand
from hardware_bridge.reading import CameraFrame, Sample


@dataclass(frozen=True)
class KeyEvent:
    """A key that a person pressed, or that the terminal repeated, at ``time_s`` on the host's clock.

    ``key`` is the character typed, or a name of `hardware_bridge.keyboard`.
    """

    time_s: float
    key: str


@dataclass(frozen=True)
class HumanInput:
    """What a person wants in this tick.

    ``commands[i]`` is for robot i of the team; None leaves it to the policy. ``estop`` stays true from the key that
    presses it to the one that releases it, ``release_estop`` is true in the tick of the release alone. ``age_s`` counts
    from the person's last sign of life: 0 while a key counts as held, infinite before the first key.

    Raises:
        ConfigError: pressed and released in one tick, or no age.
    """

    time_s: float
    commands: tuple[RobotCommand | None, ...]
    estop: bool = False
    release_estop: bool = False
    age_s: float = math.inf

    def __post_init__(self) -> None:
        require(not (self.estop and self.release_estop), "human.release_estop", True, "false while estop is pressed")
        require(self.age_s >= 0, "human.age_s", self.age_s, "0 s or more")


@dataclass(frozen=True)
class TickInputs:
    """What arrived between the last tick and this one, which is at ``time_s`` on the host's clock.

    Names are agents' names. ``samples`` and ``frames`` are oldest first; a robot that sent nothing may be absent.
    ``keys`` are what a person pressed, ``human`` what that came to. ``estop`` is a button or a line on standard input,
    apart from the keyboard's. ``failures`` tells, in one line each, of the links and cameras that failed in this tick.
    """

    time_s: float
    samples: Mapping[str, tuple[Sample, ...]] = field(default_factory=dict)
    frames: Mapping[str, tuple[CameraFrame, ...]] = field(default_factory=dict)
    keys: tuple[KeyEvent, ...] = ()
    human: HumanInput | None = None
    estop: bool = False
    release_estop: bool = False
    failures: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require(0 <= self.time_s < math.inf, "inputs.time_s", self.time_s, "a time in seconds, 0 or later")

"""Driving by keyboard: from keys with their times to a person's commands. The same keys give the same commands.

Third method of exploration in chapter 2 of the thesis, besides the random walk and the planned one.

A terminal tells of presses and repeats, never of releases. It waits for 0.25 to 0.66 s before the first repeat (X: 660
ms), then repeats at 10 to 40 Hz. So a key counts as held for ``first_hold_s`` from a press, and for ``hold_s`` from
each repeat: a key held down drives without gaps, and a robot stands that long after it was let go. Only the key pressed
last repeats; the other direction lapses by itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from coop_envs.agents.team import Member
from coop_envs.errors import require
from coop_envs.validation import STRICT
from hardware_bridge.command import RobotCommand
from hardware_bridge.reading import Pair
from hardware_bridge.tick_inputs import HumanInput, KeyEvent

HELP = """\
w a s d, arrows   drive the selected robot        1..9, tab   select a robot
x                 stand                           g           give it back to the policy
+ -               faster, slower                  b           brightness of its hat
space             e-stop, everybody               r           release it
q                 end
"""
FORWARD = {"w": 1, "up": 1, "s": -1, "down": -1}
TURN = {"a": 1, "left": 1, "d": -1, "right": -1}
STOPS = {" ", "suspend", "quit", "hangup"}
"""Keys of the e-stop: the space bar, and whatever says that nobody will watch the robots any more."""
FASTER, SLOWER = {"+", "="}, {"-", "_"}
BRIGHTNESSES = (0.5, 0.75, 1.0, 0.0, 0.25)
TENTHS = 10


@dataclass(frozen=True)
class ManualSettings:
    """How long a key counts as held, and at which share of their cruise speeds robots first drive, in tenths.

    Events of one key that are at most ``repeat_s`` apart are repeats, all others presses.
    """

    __pydantic_config__ = STRICT
    first_hold_s: float = 0.75
    hold_s: float = 0.5
    repeat_s: float = 0.2
    speed_tenths: int = 5

    def __post_init__(self) -> None:
        ordered = 0 < self.repeat_s <= self.hold_s <= self.first_hold_s < math.inf
        times_s = (self.repeat_s, self.hold_s, self.first_hold_s)
        require(ordered, "manual.hold_s", times_s, "0 < repeat_s <= hold_s <= first_hold_s")
        require(1 <= self.speed_tenths <= TENTHS, "manual.speed_tenths", self.speed_tenths, f"1 to {TENTHS}")


@dataclass(frozen=True)
class HeldKey:
    """A key that drives: which way, when it was last heard of, until when it counts as held."""

    key: str
    sign: int
    last_s: float
    until_s: float


@dataclass(frozen=True)
class ManualState:
    """What the person's keys came to so far.

    ``taken``: whom the person drives, until given back. ``alive_until_s``: until when a key counts as held.
    """

    selected: int
    taken: tuple[bool, ...]
    brightness: tuple[int, ...]
    """Which of `BRIGHTNESSES`."""
    tenths: int
    forward: HeldKey | None = None
    turn: HeldKey | None = None
    estop: bool = False
    alive_until_s: float = -math.inf


def untouched(members: Sequence[Member], settings: ManualSettings) -> ManualState:
    """Before the first key: the first robot is selected, the policy drives."""
    count = len(members)
    return ManualState(0, (False,) * count, (0,) * count, settings.speed_tenths)


def wheel_speeds(member: Member, speed_m_s: float, yaw_rate_rad_s: float) -> Pair:
    """Left and right wheel speed (rad/s), slowed together where one would exceed the robot's limit.

    The same as `coop_envs.agents.control.wheel_speeds`. Source: thesis eq (6.10).
    """
    robot = member.robot
    half = 0.5 * yaw_rate_rad_s * robot.track_m
    left, right = speed_m_s - half, speed_m_s + half
    scale = min(1.0, robot.max_speed_m_s / max(abs(left), abs(right), 1e-6)) / robot.wheel_radius_m
    return left * scale, right * scale


def manual_step(
    members: Sequence[Member], settings: ManualSettings, state: ManualState, keys: Sequence[KeyEvent], time_s: float
) -> tuple[ManualState, HumanInput]:
    """One tick: the keys since the last one, oldest first, and what the person wants now.

    An e-stop wins over a release in the same tick.
    """
    for event in keys:
        state = pressed(members, settings, state, event.key, min(event.time_s, time_s))
    stop = any(event.key in STOPS for event in keys)
    release = not stop and any(event.key == "r" for event in keys)
    estop = stop or (state.estop and not release)
    forward, turn = (None if estop else _still_held(key, time_s) for key in (state.forward, state.turn))
    state = replace(state, forward=forward, turn=turn, estop=estop)
    commands = tuple(_command(member, state, i) if state.taken[i] else None for i, member in enumerate(members))
    age_s = max(0.0, time_s - state.alive_until_s)
    return state, HumanInput(time_s, commands, estop, release, age_s)


def pressed(
    members: Sequence[Member], settings: ManualSettings, state: ManualState, key: str, time_s: float
) -> ManualState:
    """What one key, pressed or repeated, makes of the state; those of the e-stop are a matter of the whole tick."""
    state = replace(state, alive_until_s=max(state.alive_until_s, time_s + settings.hold_s))
    if key in FORWARD:
        held = _held(settings, state.forward, key, FORWARD[key], time_s)
        return replace(_taken(state), forward=held, alive_until_s=max(state.alive_until_s, held.until_s))
    if key in TURN:
        held = _held(settings, state.turn, key, TURN[key], time_s)
        return replace(_taken(state), turn=held, alive_until_s=max(state.alive_until_s, held.until_s))
    if key == "x" or key in STOPS:
        return replace(_taken(state) if key == "x" else state, forward=None, turn=None)
    if key == "g":
        return replace(_taken(state, False), forward=None, turn=None)
    if key == "b":
        return _brighter(state) if members[state.selected].hat is not None else state
    if key in FASTER | SLOWER:
        return replace(state, tenths=min(max(state.tenths + (1 if key in FASTER else -1), 1), TENTHS))
    return _select(state, key)


def text(members: Sequence[Member], state: ManualState) -> str:
    """The state in a line."""
    i = state.selected
    ways = [
        {1: "ahead", -1: "back"}[state.forward.sign] if state.forward else "",
        {1: "left", -1: "right"}[state.turn.sign] if state.turn else "",
    ]
    doing = " ".join(way for way in ways if way) or "stands"
    parts = [
        f"{i + 1} {members[i].name}: {doing if state.taken[i] else 'the policy drives'}",
        f"speed {state.tenths * TENTHS} %",
        f"hat {BRIGHTNESSES[state.brightness[i]]:.0%}".replace("%", " %"),
    ]
    yours = [str(k + 1) for k, taken in enumerate(state.taken) if taken]
    parts += [f"yours: {' '.join(yours)}"] if yours else []
    parts += ["E-STOP, r releases"] if state.estop else []
    return " | ".join(parts)


def _held(settings: ManualSettings, before: HeldKey | None, key: str, sign: int, time_s: float) -> HeldKey:
    repeats = before is not None and before.key == key and time_s - before.last_s <= settings.repeat_s
    return HeldKey(key, sign, time_s, time_s + (settings.hold_s if repeats else settings.first_hold_s))


def _still_held(key: HeldKey | None, time_s: float) -> HeldKey | None:
    return key if key is not None and key.last_s <= time_s < key.until_s else None


def _taken(state: ManualState, taken: bool = True) -> ManualState:
    i = state.selected
    return replace(state, taken=(*state.taken[:i], taken, *state.taken[i + 1 :]))


def _brighter(state: ManualState) -> ManualState:
    i = state.selected
    step = (state.brightness[i] + 1) % len(BRIGHTNESSES)
    return replace(_taken(state), brightness=(*state.brightness[:i], step, *state.brightness[i + 1 :]))


def _select(state: ManualState, key: str) -> ManualState:
    """Another robot by its number or the next; the one before stands, and stays the person's if it was."""
    count, selected = len(state.taken), state.selected
    if key in ("tab", "backtab"):
        selected = (selected + (1 if key == "tab" else -1)) % count
    elif key in set("123456789"[:count]):
        selected = int(key) - 1
    return state if selected == state.selected else replace(state, selected=selected, forward=None, turn=None)


def _command(member: Member, state: ManualState, place: int) -> RobotCommand:
    """Set-points of a robot that the person drives; all but the selected one stand."""
    brightness = BRIGHTNESSES[state.brightness[place]]
    if place != state.selected:
        return RobotCommand(brightness=brightness)
    share = state.tenths / TENTHS
    speed_m_s = share * member.cruise_speed_m_s * (state.forward.sign if state.forward else 0)
    yaw_rate_rad_s = share * member.cruise_yaw_rate_rad_s * (state.turn.sign if state.turn else 0)
    return RobotCommand(wheel_speeds(member, speed_m_s, yaw_rate_rad_s), brightness)

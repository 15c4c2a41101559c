"""What a person at a keyboard makes robots do: held keys, the deadman, the e-stop, and that it can be replayed."""

from __future__ import annotations

import math
import os
import pty
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.agents import control
from coop_envs.agents.catalog import load_team
from coop_envs.device import prepare
from coop_envs.errors import ConfigError
from hardware_bridge.command import RobotCommand
from hardware_bridge.keyboard import Keyboard
from hardware_bridge.manual_drive import (
    BRIGHTNESSES,
    FORWARD,
    HELP,
    STOPS,
    TURN,
    ManualSettings,
    ManualState,
    manual_step,
    text,
    untouched,
    wheel_speeds,
)
from hardware_bridge.mission_log import MissionLog
from hardware_bridge.mission_reader import MissionReader
from hardware_bridge.person import Driver
from hardware_bridge.tick_inputs import HumanInput, KeyEvent, TickInputs
from tests.hardware_bridge.missions import METADATA

MEMBERS = load_team("scouts").members
SETTINGS = ManualSettings()
TICK_S = 1 / 30
KEYS = [*FORWARD, *TURN, *STOPS, "x", "g", "b", "r", "tab", "backtab", "+", "-", "1", "2", "3", "9", "?", "escape", "A"]


def play(events: list[KeyEvent], until_s: float, tick_s: float = TICK_S) -> list[tuple[HumanInput, list[str]]]:
    """What a person wants in every tick, given keys by time, and the tick's keys."""
    state, waiting, played = untouched(MEMBERS, SETTINGS), list(events), []
    for k in range(1, math.ceil(until_s / tick_s) + 1):
        keys = []
        while waiting and waiting[0].time_s <= k * tick_s:
            keys.append(waiting.pop(0))
        state, human = manual_step(MEMBERS, SETTINGS, state, keys, k * tick_s)
        played.append((human, [event.key for event in keys]))
    return played


def typed(*keys: str) -> tuple[ManualState, HumanInput]:
    """Keys one after the other, a tick each."""
    state = untouched(MEMBERS, SETTINGS)
    human = HumanInput(0.0, ())
    for k, key in enumerate(keys):
        state, human = manual_step(MEMBERS, SETTINGS, state, [KeyEvent(k * TICK_S, key)], k * TICK_S)
    return state, human


def twist(command: RobotCommand | None, robot: int = 0) -> tuple[float, float]:
    """Forward speed and yaw rate of a command, by the textbook's inverse of the wheels' kinematics."""
    assert command is not None
    (left, right), body = command.wheels_rad_s, MEMBERS[robot].robot
    return (left + right) * body.wheel_radius_m / 2, (right - left) * body.wheel_radius_m / body.track_m


@wp.kernel
def wheels_of(model: wp.array[control.DriveModel], twists: wp.array[wp.vec2], wheels: wp.array[wp.vec2]):
    i = wp.tid()
    wheels[i] = control.wheel_speeds(model[0], twists[i][0], twists[i][1])


@pytest.mark.parametrize("robot", [0, 1])
def test_wheels_turn_as_a_policys_would(robot: int) -> None:
    device = prepare("cpu")
    twists = np.random.default_rng(robot).uniform(-3.0, 3.0, (200, 2)).astype(np.float32)
    twists[:3] = [(0.0, 0.0), (0.2, 0.0), (0.0, 1.0)]
    wheels = wp.zeros(len(twists), dtype=wp.vec2, device=device)
    model = control.drive_models(replace(load_team("scouts"), members=MEMBERS[: robot + 1]), False, device)[robot:]
    wp.launch(wheels_of, len(twists), inputs=[model, wp.array(twists, dtype=wp.vec2, device=device), wheels])
    ours = [wheel_speeds(MEMBERS[robot], float(speed), float(yaw_rate)) for speed, yaw_rate in twists]
    np.testing.assert_allclose(ours, wheels.numpy(), rtol=1e-5, atol=1e-5)
    fastest = np.abs(np.array(ours)).max() * MEMBERS[robot].robot.wheel_radius_m
    assert fastest == pytest.approx(MEMBERS[robot].robot.max_speed_m_s)


@pytest.mark.parametrize(
    ("key", "forward", "turn"),
    [(key, sign, 0) for key, sign in (("w", 1), ("up", 1), ("s", -1), ("down", -1))]
    + [(key, 0, sign) for key, sign in (("a", 1), ("left", 1), ("d", -1), ("right", -1))],
)
def test_keys_drive_the_selected_robot_at_a_share_of_its_cruise_speeds(key: str, forward: int, turn: int) -> None:
    for keys, share in (((), 0.5), (("+",) * 9, 1.0), (("-",) * 9, 0.1), (("=", "_", "+"), 0.6)):
        _, human = typed(*keys, key)
        expected = share * forward * MEMBERS[0].cruise_speed_m_s, share * turn * MEMBERS[0].cruise_yaw_rate_rad_s
        assert twist(human.commands[0]) == pytest.approx(expected)
        assert human.commands[1:] == (None,) * (len(MEMBERS) - 1)
        assert human.age_s == 0.0


def test_two_directions_make_a_curve() -> None:
    _, human = typed("w", "d")
    assert twist(human.commands[0]) == pytest.approx(
        (0.5 * MEMBERS[0].cruise_speed_m_s, -0.5 * MEMBERS[0].cruise_yaw_rate_rad_s)
    )


@pytest.mark.parametrize("tick_s", [1 / 30, 1 / 7])
@pytest.mark.parametrize(("delay_s", "period_s"), [(0.25, 1 / 11), (0.5, 1 / 30), (0.66, 0.04), (0.66, 0.12)])
def test_a_held_key_drives_without_gaps(delay_s: float, period_s: float, tick_s: float) -> None:
    """Delays and rates of the Linux console, of desktops, of a bare X server, and that over a poor line."""
    repeats = np.arange(1.0 + delay_s, 4.0, period_s).tolist()
    events = [KeyEvent(time_s, "w") for time_s in (1.0, *repeats)]
    let_go_s = events[-1].time_s
    for human, _ in play(events, 6.0, tick_s):
        drives = human.commands[0] is not None and not human.commands[0].stands
        if human.time_s < 1.0 or human.time_s > let_go_s + SETTINGS.hold_s:
            assert not drives, human.time_s
        elif 1.0 + tick_s <= human.time_s <= let_go_s:
            assert drives, human.time_s


def test_a_tap_drives_no_longer_than_a_terminal_waits_for_its_first_repeat() -> None:
    ticks = play([KeyEvent(1.0, "w")], 3.0)
    driven = [human.time_s for human, _ in ticks if human.commands[0] is not None and not human.commands[0].stands]
    assert 1.0 <= driven[0] <= 1.0 + TICK_S
    assert SETTINGS.first_hold_s - 2 * TICK_S <= driven[-1] - 1.0 <= SETTINGS.first_hold_s


def test_a_robot_taken_stays_the_persons_until_given_back() -> None:
    human = play([KeyEvent(1.0, "w"), KeyEvent(2.0, "2"), KeyEvent(2.5, "w")], 8.0)[-1][0]
    assert [command is None for command in human.commands[:3]] == [False, False, True]
    assert all(command is None or command.stands for command in human.commands)
    state, human = typed("w", "2", "w", "1", "g")
    assert [command is None for command in human.commands[:2]] == [True, False]
    assert "yours: 2" in text(MEMBERS, state)


def test_selecting_another_robot_stands_the_first_at_once() -> None:
    for key in ("2", "tab"):
        state, human = typed("w", key)
        assert state.selected == 1
        assert human.commands[0] is not None and human.commands[0].stands
        assert human.commands[1] is None
    assert typed("backtab")[0].selected == len(MEMBERS) - 1
    assert typed("tab", "backtab")[0].selected == 0
    assert typed("9" if len(MEMBERS) < 9 else "0")[0].selected == 0


def test_x_stands_the_robot_and_keeps_it() -> None:
    _, human = typed("w", "x")
    assert human.commands[0] is not None and human.commands[0].stands


def test_b_goes_round_the_brightnesses() -> None:
    seen = []
    for count in range(1, len(BRIGHTNESSES) + 1):
        (command, *_) = typed(*["tab"], *["b"] * count)[1].commands[1:]
        assert command is not None and command.stands
        seen.append(command.brightness)
    assert seen == [*BRIGHTNESSES[1:], BRIGHTNESSES[0]]
    no_hat = [replace(member, hat=None) for member in MEMBERS]
    _, human = manual_step(no_hat, SETTINGS, untouched(no_hat, SETTINGS), [KeyEvent(0.0, "b")], 0.0)
    assert human.commands == (None,) * len(MEMBERS)


@pytest.mark.parametrize("key", sorted(STOPS))
def test_the_e_stop_latches_until_it_is_released(key: str) -> None:
    assert typed("w", key, "w", "2", "w", "g")[1].estop
    state, human = typed("w", key, "w")
    assert human.estop
    assert human.commands[0] is not None and human.commands[0].stands
    assert "E-STOP" in text(MEMBERS, state)
    state, human = typed("w", key, "w", "r")
    assert (human.estop, human.release_estop) == (False, True)
    assert human.commands[0] is not None and human.commands[0].stands
    assert typed("w", key, "w", "r", "?")[1].release_estop is False
    assert typed("w", key, "r", "w")[1].commands[0] != typed("w", key, "r")[1].commands[0]


@pytest.mark.parametrize("keys", ["r ", " r", "rr r", "w r"])
def test_an_e_stop_wins_over_a_release_in_the_same_tick(keys: str) -> None:
    events = [KeyEvent(0.0, key) for key in keys]
    _, human = manual_step(MEMBERS, SETTINGS, untouched(MEMBERS, SETTINGS), events, 0.0)
    assert human.estop
    assert not human.release_estop


def test_a_clock_that_jumps_drives_nobody() -> None:
    state, _ = manual_step(MEMBERS, SETTINGS, untouched(MEMBERS, SETTINGS), [KeyEvent(100.0, "w")], 100.0)
    for now_s in (50.0, 200.0):
        _, human = manual_step(MEMBERS, SETTINGS, state, [], now_s)
        assert human.commands[0] is not None and human.commands[0].stands
    state, human = manual_step(MEMBERS, SETTINGS, untouched(MEMBERS, SETTINGS), [KeyEvent(900.0, "w")], 10.0)
    assert manual_step(MEMBERS, SETTINGS, state, [], 10.7)[1].commands[0] != RobotCommand(brightness=0.5)
    assert manual_step(MEMBERS, SETTINGS, state, [], 10.8)[1].commands[0] == RobotCommand(brightness=0.5)


events_of_time = st.lists(st.tuples(st.floats(0.0, 5.0), st.sampled_from(KEYS)), max_size=40).map(
    lambda pairs: [KeyEvent(time_s, key) for time_s, key in sorted(pairs, key=lambda pair: pair[0])]
)


@given(events=events_of_time)
@settings(deadline=None)
def test_nothing_moves_without_a_fresh_key_and_never_faster_than_cruise(events: list[KeyEvent]) -> None:
    for human, _ in play(events, 6.5):
        drivers = [e for e in events if e.key in FORWARD or e.key in TURN]
        fresh = any(0 <= human.time_s - e.time_s <= SETTINGS.first_hold_s for e in drivers)
        moving = [i for i, command in enumerate(human.commands) if command is not None and not command.stands]
        assert len(moving) <= (1 if fresh else 0)
        assert not (moving and human.estop)
        for i in moving:
            speed_m_s, yaw_rate_rad_s = twist(human.commands[i], i)
            assert abs(speed_m_s) <= MEMBERS[i].cruise_speed_m_s * (1 + 1e-9)
            assert abs(yaw_rate_rad_s) <= MEMBERS[i].cruise_yaw_rate_rad_s * (1 + 1e-9)
            assert human.age_s == 0.0


@given(events=events_of_time)
@settings(deadline=None)
def test_the_e_stop_is_pressed_from_the_key_to_the_release(events: list[KeyEvent]) -> None:
    latched = False
    for human, keys in play(events, 5.5):
        stop, release = any(key in STOPS for key in keys), "r" in keys
        latched = stop or (latched and not release)
        assert human.estop == latched
        assert human.release_estop == (release and not stop)


@given(events=events_of_time, at=st.floats(0.0, 5.0))
def test_how_keys_fall_into_ticks_changes_nothing_but_the_e_stop(events: list[KeyEvent], at: float) -> None:
    events = [event for event in events if event.key not in STOPS and event.key != "r"]
    start = untouched(MEMBERS, SETTINGS)
    whole, _ = manual_step(MEMBERS, SETTINGS, start, events, 5.0)
    first, _ = manual_step(MEMBERS, SETTINGS, start, [e for e in events if e.time_s <= at], at)
    second, _ = manual_step(MEMBERS, SETTINGS, first, [e for e in events if e.time_s > at], 5.0)
    assert second == whole


@given(keys=st.lists(st.sampled_from(KEYS), max_size=12))
def test_the_status_line_is_one_line_that_names_the_selected_robot(keys: list[str]) -> None:
    state, _ = typed(*keys)
    line = text(MEMBERS, state)
    assert "\n" not in line
    assert len(line) < 120
    assert line.startswith(f"{state.selected + 1} {MEMBERS[state.selected].name}: ")


def test_the_help_names_every_key() -> None:
    for key in ("w a s d", "arrows", "1..9", "tab", "x ", "g ", "+ -", "b ", "space", "r ", "q "):
        assert key in HELP


def test_a_drive_is_recorded_and_played_again_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    state, humans = untouched(MEMBERS, SETTINGS), []
    with MissionLog(tmp_path / "run.mcap", METADATA, waits=True) as log:
        for k in range(600):
            now_s = 0.1 + k / 30
            keys = tuple(
                KeyEvent(now_s - rng.random() / 30, str(rng.choice(KEYS))) for _ in range(int(rng.integers(3) == 0))
            )
            state, human = manual_step(MEMBERS, SETTINGS, state, keys, now_s)
            humans.append(human)
            log.write_inputs(TickInputs(now_s, keys=keys, human=human))
    again, state = [], untouched(MEMBERS, SETTINGS)
    for tick in MissionReader(tmp_path / "run.mcap").ticks():
        state, human = manual_step(MEMBERS, SETTINGS, state, tick.inputs.keys, tick.inputs.time_s)
        again.append(human)
        assert human == tick.inputs.human
    assert again == humans
    assert any(command is not None and not command.stands for human in humans for command in human.commands)


def test_keys_of_a_terminal_drive() -> None:
    operator, ours = pty.openpty()
    try:
        with Keyboard(ours) as keyboard:
            driver = Driver(keyboard, MEMBERS)
            assert driver.read(4.9) == ((), HumanInput(4.9, (None,) * len(MEMBERS)))
            os.write(operator, b"2\x1b[A")
            events: tuple[KeyEvent, ...] = ()
            end = time.monotonic() + 20.0
            while time.monotonic() < end and len(events) < 2:
                more, human = driver.read(5.0)
                events += more
    finally:
        os.close(operator)
        os.close(ours)
    assert events == (KeyEvent(5.0, "2"), KeyEvent(5.0, "up"))
    assert not driver.quit
    assert twist(human.commands[1], 1)[0] == pytest.approx(0.5 * MEMBERS[1].cruise_speed_m_s)


@pytest.mark.parametrize(
    "wrong",
    [{"hold_s": 0.0}, {"first_hold_s": 0.3}, {"repeat_s": 0.6}, {"speed_tenths": 11}, {"first_hold_s": math.inf}],
)
def test_settings_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="manual"):
        ManualSettings(**wrong)  # type: ignore[arg-type]

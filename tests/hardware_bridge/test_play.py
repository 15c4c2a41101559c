"""`coop play` through a real terminal: a person drives a simulated robot, stops it, ends; the log replays exactly."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from coop_envs.cli import main
from hardware_bridge.mission_log_format import BELIEF
from hardware_bridge.mission_reader import MissionReader
from tests.hardware_bridge.fake_simulator import wait_until
from tests.hardware_bridge.lone_robot import STANDS, RestingRobot, images, steady_policy, team_file

COOP = str(Path(sys.executable).with_name("coop"))


@contextmanager
def at_a_terminal(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """`coop` with a terminal to type at, and a pipe for what it tells."""
    keys, terminal = pty.openpty()
    pipe = subprocess.PIPE
    try:
        with subprocess.Popen([COOP, *arguments], stdin=terminal, stdout=pipe, stderr=pipe, text=True) as process:
            try:
                yield process, keys
            finally:
                process.kill()
    finally:
        os.close(keys)
        os.close(terminal)


def hold(keys: int, key: bytes, seconds: float) -> None:
    """A key held down, as a keyboard repeats it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        os.write(keys, key)
        time.sleep(0.05)


@pytest.mark.slow
def test_a_person_drives_a_simulated_robot(tmp_path: Path) -> None:
    log = tmp_path / "play.mcap"
    with at_a_terminal("play", "--scenario", "rubble", "--log", str(log)) as (process, keys):
        stderr = process.stderr
        assert stderr is not None
        wait_until(lambda: "observer_0 (+0.00, " in stderr.readline(), 60.0)
        hold(keys, b"w", 1.2)
        os.write(keys, b" ")
        hold(keys, b"w", 0.4)
        os.write(keys, b"q")
        told, complaints = process.communicate(timeout=30.0)
    assert process.returncode == 0, complaints
    assert "stopped" in told and "observer_0: e-stop" in told
    reader = MissionReader(log)
    ticks = [tick for tick in reader.ticks() if tick.sent]
    pressed = next(k for k, tick in enumerate(ticks) if tick.inputs.human and tick.inputs.human.estop)
    assert any(not tick.sent["observer_0"].stands for tick in ticks[:pressed] if tick.sent)
    assert all(robot.stands for tick in ticks[pressed:] if tick.sent for robot in tick.sent.values())
    *_, (_, belief) = reader.arrays(BELIEF)
    assert belief["position"][0, 0, 0] > 0.02
    assert main(["deploy", "--replay", str(log)]) == 0


def test_a_person_takes_a_robot_from_its_policy(tmp_path: Path) -> None:
    """And it stands once nobody holds a key any more, and after ``q``."""
    with RestingRobot() as robot:
        team, policy = team_file(tmp_path, robot, images(tmp_path)), steady_policy(tmp_path, STANDS)
        log = str(tmp_path / "run.mcap")
        with at_a_terminal("deploy", "--policy", policy, "--team", team, "--log", log, "--keyboard") as (process, keys):
            wait_until(lambda: len(robot.sets) > 30 or process.poll() is not None, 30.0)
            assert robot.stood
            hold(keys, b"w", 0.3)
            wait_until(lambda: min(robot.wheels) > 0.0, 10.0)
            wait_until(lambda: robot.wheels == [0.0, 0.0], 10.0)
            os.write(keys, b"q")
            _, complaints = process.communicate(timeout=20.0)
        assert process.returncode == 0, complaints
        assert robot.wheels == [0.0, 0.0]

"""A mission's log through the runner's core again: whole, cut short by a kill, with a person, and with another seed."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from coop_envs.policy import load_policy
from coop_envs.recording.whole_file import unfinished_path
from hardware_bridge.command import RobotCommand
from hardware_bridge.mission_reader import MissionReader
from hardware_bridge.mission_replay import replay_mission
from hardware_bridge.session import Order, prepared
from hardware_bridge.tick_inputs import HumanInput, KeyEvent

ROOT = Path(__file__).parents[2]
POLICY = "random_walk"
ROBOTS = ("observer_0", "picket_0", "picket_1")


class Somebody:
    """Takes the second robot for a while, presses the e-stop, and lets go."""

    def read(self, now_s):
        commands = (None, RobotCommand((1.5, 2.0), 0.5) if 1.0 < now_s < 2.0 else None, None)
        keys = (KeyEvent(now_s, "w"),) if 1.0 < now_s < 2.0 else ()
        estop, release = 2.4 < now_s < 2.8, 2.8 <= now_s < 2.84
        return keys, HumanInput(now_s, commands, estop, release, age_s=0.0)


def team_file(folder):
    robots = {name: {"link": {"kind": "simulator"}, "camera": {"kind": "simulator"}} for name in ROBOTS}
    emulation = {"scenario": "rubble", "seed": 2, "lockstep": True}
    file = folder / "team.yaml"
    file.write_text(json.dumps({"team": "surveyors", "robots": robots, "emulation": emulation}))
    return file


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mission")
    log = folder / "run.mcap"
    order = Order(team_file(folder), POLICY, load_policy(POLICY), 5, log, time_limit_s=4.0)
    with prepared(order, str, person=lambda deployment: Somebody()) as session:
        tally = session.run()
    assert tally.ended.startswith("the time limit")
    assert any("human" in rule for rule in tally.interventions)
    assert any("e-stop" in rule for rule in tally.interventions)
    return log


def test_a_whole_log_replays_bit_for_bit(log):
    done = replay_mission(log)
    assert (done.difference, done.note) == (None, None)
    assert done.decisions == 20
    assert done.ticks == len(list(MissionReader(log).ticks()))


def test_another_seed_is_a_difference(log, monkeypatch):
    made = MissionReader.__init__

    def other(self, path):
        made(self, path)
        self.metadata = replace(self.metadata, seed=6)

    monkeypatch.setattr(MissionReader, "__init__", other)
    assert (replay_mission(log).difference or "").startswith("commands at")


def test_another_policy_is_a_difference(log):
    assert replay_mission(log, "frontier").difference is not None


@pytest.mark.parametrize("share", [0.5, 0.8, 0.97])
def test_a_log_cut_anywhere_replays_up_to_there(log, tmp_path, share):
    data = log.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: round(len(data) * share)])
    done = replay_mission(cut)
    assert done.difference is None
    assert done.note is not None and done.ticks > 10


def test_a_killed_missions_log_replays_up_to_the_kill(tmp_path):
    log = tmp_path / "killed.mcap"
    coop = "from coop_envs.cli import main; raise SystemExit(main())"
    command = [sys.executable, "-c", coop, "deploy", "--policy", POLICY, "--team", str(team_file(tmp_path))]
    process = subprocess.Popen(
        [*command, "--log", str(log)], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    part, end = unfinished_path(log), time.monotonic() + 60.0
    while process.poll() is None and time.monotonic() < end:
        if part.is_file() and part.stat().st_size > 200_000:
            break
        time.sleep(0.02)
    assert process.poll() is None, "it ended by itself"
    process.kill()
    process.wait()
    done = replay_mission(part)
    assert done.difference is None
    assert done.note is not None and done.ticks > 10

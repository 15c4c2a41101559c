"""`coop deploy` on real transports: what it refuses before anything moves, how it ends, what it leaves."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from coop_envs.cli import main
from coop_envs.policy import load_policy
from hardware_bridge.mission_display import Display
from hardware_bridge.mission_reader import MissionReader
from hardware_bridge.session import Order, Tally, prepared
from tests.hardware_bridge.fake_simulator import Emulator, FakeSimulator, wait_until
from tests.hardware_bridge.lone_robot import DRIVES, STANDS, RestingRobot, images, steady_policy, team_file

PAIR = [{"role": "observer", "robot": "zumy", "cameras": ["ch6"], "hat": "hat0", "laser": {}}]
PAIR += [{"role": "picket", "robot": "zumy", "cameras": ["ch6"], "hat": "hat1", "laser": {}}]


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line with which `coop deploy` refuses."""
    assert main(["deploy", *arguments]) == 2
    *before, last = capsys.readouterr().err.splitlines()
    assert last.startswith("error: ")
    assert not any("error" in line or "Traceback" in line for line in before)
    return last


def written(folder: Path, tree: dict[str, Any]) -> str:
    file = folder / "written.yaml"
    file.write_text(json.dumps(tree))
    return str(file)


def emulated(folder: Path, **emulation: Any) -> str:
    """Two Zumys that scan, one with real bytes, as fast as the machine can."""
    robot = {"link": {"kind": "zumy_serial", "poll_hz": 1000}, "camera": {"kind": "simulator"}}
    other = {"link": {"kind": "simulator"}, "camera": {"kind": "simulator"}}
    tree: dict[str, Any] = {"team": {"name": "pair", "members": PAIR}, "robots": {"observer_0": robot}}
    tree["robots"]["picket_0"] = other
    tree["emulation"] = {"scenario": "rubble", "lockstep": True, **emulation}
    tree["safety"] = {"inchworm": False, "max_speed_m_s": 0.05, "max_sigma_m": None}
    return written(folder, tree)


COMMAND_LINES = {
    "no policy": (["--team", "team.yaml"], "policy: got None, expected a policy by name or path"),
    "no such policy": (["--policy", "goal_gird", "--team", "team.yaml"], "did you mean 'goal_grid'?"),
    "no team": (["--policy", "goal_grid"], "team: got None, expected a team file (.yaml)"),
    "no such team": (["--policy", "goal_grid", "--team", "none.yaml"], "expected a team file (.yaml) that exists"),
    "no time": (["--policy", "goal_grid", "--team", "t.yaml", "--time-limit-s", "0"], "expected more than 0 s"),
    "an unknown option": (["--polcy", "goal_grid"], "Unrecognized options"),
    "no such log": (["--replay", "none.mcap"], "log: got 'none.mcap', expected an existing"),
}


@pytest.mark.parametrize("case", COMMAND_LINES)
def test_a_wrong_command_line(capsys, case):
    arguments, expected = COMMAND_LINES[case]
    assert expected in refusal(capsys, *arguments)


@pytest.mark.parametrize(("log", "expected"), [("run.txt", "that ends in .mcap"), ("team.yaml/a.mcap", "written to")])
def test_a_log_that_cannot_be_written(tmp_path, capsys, log, expected):
    with RestingRobot() as robot:
        team = team_file(tmp_path, robot, images(tmp_path))
        policy = steady_policy(tmp_path, DRIVES)
        assert expected in refusal(capsys, "--policy", policy, "--team", team, "--log", str(tmp_path / log))
        assert not robot.sets


SENSORS = {
    "no gravity": ({"accel": [0.0, 0.0, 0.5]}, "robots.observer_0.accel: got (0.0, 0.0, 0.5), expected gravity"),
    "on its side": ({"accel": [9.81, 0.0, 0.0]}, "robots.observer_0.accel: got (9.81, 0.0, 0.0), expected gravity"),
    "turned while it calibrated": ({"gyro": [0.0, 0.0, 0.4]}, "robots.observer_0.gyro: got 0.4, expected at rest"),
    "wheels that turn": ({"wheels": [2.0, 2.0]}, "robots.observer_0.wheels: got 2.0, expected at rest"),
    "an empty battery": ({"voltage": 6.4}, "robots.observer_0.battery: got '6.40 V (0%)', expected more than 10%"),
    "silence": ({"powered": False}, "robots.observer_0.reports: got 0, expected reports while it rests"),
}


@pytest.mark.parametrize("case", SENSORS)
def test_a_robot_that_makes_no_sense_is_not_driven(tmp_path, capsys, case):
    says, expected = SENSORS[case]
    with RestingRobot(**says) as robot:
        team = team_file(tmp_path, robot, images(tmp_path))
        log = tmp_path / "run.mcap"
        assert expected in refusal(
            capsys, "--policy", steady_policy(tmp_path, DRIVES), "--team", team, "--log", str(log)
        )
        assert robot.sets and robot.stood
        assert not list(tmp_path.glob("*.mcap"))


def test_images_of_another_size_than_the_calibrations(tmp_path, capsys):
    with RestingRobot() as robot:
        team = team_file(tmp_path, robot, images(tmp_path, 320, 240))
        line = refusal(capsys, "--policy", steady_policy(tmp_path, DRIVES), "--team", team)
        assert line.endswith("got images of 320 x 240, expected 640 x 480, as calibrated")
        assert robot.stood


def test_absent_devices(tmp_path, capsys):
    with RestingRobot() as robot:
        policy, team = steady_policy(tmp_path, DRIVES), team_file(tmp_path, robot, "/dev/video77")
        assert "got no /dev/video77, expected a camera" in refusal(capsys, "--policy", policy, "--team", team)
        port = str(tmp_path / "ttyUSB0")
        wiring = {"link": {"kind": "zumy_serial", "port": port}, "camera": {"kind": "opencv", "source": 0}}
        team = team_file(tmp_path, robot, 0, robots={"observer_0": wiring})
        assert f"{port}: got no such port, expected" in refusal(capsys, "--policy", policy, "--team", team)
        assert robot.stood


def test_firmware_that_nobody_has_listed(tmp_path, capsys):
    with RestingRobot() as observer, FakeSimulator() as simulator:
        file = Path(team_file(tmp_path, observer, images(tmp_path)))
        tree = json.loads(file.read_text())
        tree["team"]["members"].append({"role": "picket", "robot": "velociroach_radio", "hat": "hat0"})
        tree["site"]["start"].append([0.4, 0.0, 0.0])
        with Emulator("velociroach_firmware", simulator) as firmware:
            link = {"kind": "velociroach_xbee", "port": firmware.port, "firmware": ["roach 2012"]}
            tree["robots"]["picket_0"] = {"link": link}
            line = refusal(capsys, "--policy", steady_policy(tmp_path, DRIVES), "--team", written(tmp_path, tree))
        assert "got firmware 'emulated roach 1', expected one that is known: 'roach 2012'" in line
        assert observer.stood and not any(any(told.get("wheels", ())) for told in simulator.sets)


def test_a_policy_for_another_team_or_rate(tmp_path, capsys):
    with RestingRobot() as robot:
        team = team_file(tmp_path, robot, images(tmp_path))
        line = refusal(capsys, "--policy", "inchworm_scan", "--team", team)
        assert line == "error: team.cameras: got 1, expected at least 2 (policy inchworm_scan needs them)"
        tree = json.loads(Path(team).read_text()) | {"rates": {"ticks_per_decision": 3}}
        tree["team"]["members"].append({"role": "picket", "robot": "zumy", "hat": "hat0"})
        tree["robots"]["picket_0"] = {"link": {"kind": "zumy_serial", "port": "/dev/ttyUSB7"}}
        tree["site"]["start"].append([0.4, 0.0, 0.0])
        line = refusal(capsys, "--policy", "learned_scouts", "--team", written(tmp_path, tree))
        assert line.startswith("error: team.decision_s: got 0.1, expected 0.2")
        assert not robot.sets


def test_quirks_that_firmware_does_not_have(tmp_path, capsys):
    team = emulated(tmp_path, quirks={"all": {"losst": 0.1}})
    line = refusal(capsys, "--policy", "inchworm_scan", "--team", team)
    assert "emulation.quirks.all.losst" in line and line.endswith("did you mean 'lost'?")


def test_a_mission_ends_at_its_time_and_replays_exactly(tmp_path, capsys):
    log = tmp_path / "run.mcap"
    team = emulated(tmp_path)
    arguments = ["--policy", "inchworm_scan", "--team", team, "--log", str(log), "--time-limit-s", "1"]
    assert main(["deploy", *arguments, "--json"]) == 0
    tally = json.loads(capsys.readouterr().out)
    assert tally["ended"] == "the time limit of 1 s is over" and tally["decisions"] == 5
    assert max(tally["true_position_error_m"]) < 0.1
    assert main(["deploy", "--replay", str(log)]) == 0
    assert capsys.readouterr().out == "31 ticks, 5 decisions: beliefs and commands are the same, bit for bit\n"
    assert main(["deploy", "--replay", str(log), "--policy", steady_policy(tmp_path, DRIVES)]) == 1
    assert "differs first: commands at" in capsys.readouterr().out


def test_a_dry_run_moves_nothing_and_names_the_limits(tmp_path):
    policy = load_policy(steady_policy(tmp_path, DRIVES))
    order = Order(Path(emulated(tmp_path)), "steady", policy, 0, None, dry_run=True, time_limit_s=0.4)
    console = Console(file=io.StringIO(), width=80)
    display = Display(console, order)
    with prepared(order, display.say, watch=display.show) as session:
        tally: Tally = session.run()
    assert tally.truth is not None
    assert tally.truth["path"] == [0.0, 0.0]
    assert tally.truth["set_wheels"] == [[0.0, 0.0], [0.0, 0.0]]
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert any("mbed_zumy [packet]" in line for line in lines)
    moves = [line for line in lines if "picket_0: would send wheels +" in line and "(wanted +" in line]
    assert any("[speed: rim " in line and "at most 0.05 m/s" in line for line in moves)


def test_ctrl_c_stands_the_robots_and_keeps_the_log(tmp_path):
    log = tmp_path / "run.mcap"
    with RestingRobot() as robot:
        team = team_file(tmp_path, robot, images(tmp_path))
        command = [str(Path(sys.executable).with_name("coop")), "deploy", "--policy", steady_policy(tmp_path, DRIVES)]
        command += ["--team", team, "--log", str(log)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
            wait_until(lambda: any(robot.wheels) or process.poll() is not None, 30.0)
            process.send_signal(signal.SIGINT)
            _, told = process.communicate(timeout=20.0)
        assert process.returncode == 130, told
        assert robot.wheels == [0.0, 0.0]
    reader = MissionReader(log)
    ticks = list(reader.ticks())
    assert reader.note is None
    assert any(not tick.sent["observer_0"].stands for tick in ticks if tick.sent)
    assert main(["deploy", "--replay", str(log)]) == 0


def test_people_at_no_terminal_cannot_drive(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with RestingRobot() as robot:
        team = team_file(tmp_path, robot, images(tmp_path))
        line = refusal(capsys, "--policy", steady_policy(tmp_path, STANDS), "--team", team, "--keyboard")
        assert line.startswith("error: keyboard: got 'no standard input', expected a terminal")
        assert not robot.sets

"""The example team files load, and the page on real robots tells the truth: defaults, options, programs, links."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import pytest
import yaml

from coop_envs.cli import main, parse
from hardware_bridge import deploy, play
from hardware_bridge.cameras.detection import DetectionSettings
from hardware_bridge.cameras.opencv_camera import OpencvCameraSettings
from hardware_bridge.cameras.ros1_camera import Ros1CameraSettings
from hardware_bridge.deployment import Deployment, Emulation, Site, load_deployment
from hardware_bridge.emulators.quirks import Quirks
from hardware_bridge.links.simulator_udp import SimulatorUdpSettings
from hardware_bridge.links.velociroach_xbee import VelociroachSettings
from hardware_bridge.links.zumy_ros1 import ZumyRos1Settings
from hardware_bridge.links.zumy_serial import ZumySerialSettings
from hardware_bridge.safety.limits import SafetyLimits

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "deploying.md"
TEXT = PAGE.read_text(encoding="utf-8")
EXAMPLES = sorted((ROOT / "examples").glob("*.yaml"))
TABLES: dict[str, Any] = {
    "## The team file": Deployment,
    "`kind: zumy_serial`**": ZumySerialSettings,
    "`kind: zumy_ros1`**": ZumyRos1Settings,
    "`kind: velociroach_xbee`**": VelociroachSettings,
    "`kind: simulator`**": SimulatorUdpSettings,
    "`kind: opencv`**": OpencvCameraSettings,
    "`kind: ros1`**": Ros1CameraSettings,
    "**`detection`**": DetectionSettings,
    "**`site`**": Site,
    "**`emulation`**": Emulation,
    "**`safety`**": SafetyLimits,
    "`quirks` make it worse": Quirks,
}


def rows(heading: str) -> dict[str, str]:
    """The first table after a heading: every entry with its default."""
    table = TEXT[TEXT.index(heading) :].split("\n| ", 1)[1].split("\n\n", 1)[0]
    found: dict[str, str] = {}
    for line in table.splitlines()[2:]:
        names, *_, default = (cell.strip() for cell in line.strip().strip("|").split("|"))
        found |= dict.fromkeys(re.findall(r"`(\w+)`", names), default)
    return found


def plain(value: Any) -> Any:
    return [plain(item) for item in value] if isinstance(value, tuple | list) else value


@pytest.mark.parametrize("heading", TABLES)
def test_tables_name_every_entry_with_its_default(heading: str) -> None:
    kind, told = TABLES[heading], rows(heading)
    entries = {field.name: field for field in fields(kind) if field.name != "kind"}
    assert set(told) == set(entries)
    for name, default in told.items():
        field = entries[name]
        if default == "needed":
            assert field.default is MISSING and field.default_factory is MISSING, name
        elif field.default is not MISSING and default:
            assert yaml.safe_load(default) == plain(field.default), name


def test_every_rule_is_explained() -> None:
    folder = ROOT / "hardware_bridge" / "safety"
    source = "".join(path.read_text(encoding="utf-8") for path in folder.glob("*.py"))
    named = set(re.findall(r"\.(?:stop|hold|halt|alter|tell)\(place, \"([^\"]+)\"", source))
    assert len(named) >= 12
    assert not [rule for rule in named if f"`{rule}`" not in TEXT]


def commands() -> list[str]:
    return re.findall(r"^ {4,}(coop (?:deploy|play) .*)$", TEXT, re.MULTILINE)


@pytest.mark.parametrize("command", commands())
def test_commands_are_read(command: str) -> None:
    _, name, *arguments = shlex.split(command, comments=True)
    options = parse({"deploy": deploy.Options, "play": play.Options}[name], name, arguments)
    team = getattr(options, "team", None)
    assert team is None or (ROOT / team).is_file()


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", TEXT):
        assert (PAGE.parent / target).exists(), target


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_example_team_files_load(file: Path) -> None:
    deployment = load_deployment(file)
    assert (deployment.emulation is None) == (not file.stem.startswith("emulated"))
    if deployment.emulation is None:
        assert deployment.safety.geofence is not None
        assert deployment.safety.max_speed_m_s <= 0.1


@pytest.mark.parametrize(
    ("file", "policy", "expected"),
    [
        ("three_zumys", "inchworm_scan", "/dev/ttyUSB0: got no such port"),
        pytest.param("scouts_ros1_xbee", "goal_grid", "master http://zumy1.local:11311", marks=pytest.mark.ros),
    ],
)
def test_real_robots_that_are_not_there_are_missed(capsys, file: str, policy: str, expected: str) -> None:
    arguments = ["deploy", "--policy", policy, "--team", str(ROOT / "examples" / f"{file}.yaml"), "--dry-run"]
    assert main(arguments) == 2
    assert expected in capsys.readouterr().err


def test_emulated_scouts_drive(tmp_path: Path, capsys) -> None:
    """As fast as the machine can, and without the waiting."""
    text = (ROOT / "examples" / "emulated_scouts.yaml").read_text(encoding="utf-8")
    tree = yaml.safe_load(text)
    tree["emulation"]["lockstep"] = True
    team = tmp_path / "team.yaml"
    team.write_text(yaml.safe_dump(tree), encoding="utf-8")
    log = str(tmp_path / "run.mcap")
    arguments = ["--policy", "goal_grid", "--team", str(team), "--log", log, "--time-limit-s", "3"]
    assert main(["deploy", *arguments]) == 0
    assert "the time limit of 3 s is over" in capsys.readouterr().out
    assert main(["deploy", "--replay", log]) == 0


@pytest.mark.slow
def test_programs_run(tmp_path: Path) -> None:
    """The one that breaks a robot, then the one that reads a log: its log."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    reads, breaks = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    told = [
        subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
        for program in (breaks, reads.replace("out/run.mcap", "out/broken.mcap"))
    ]
    assert [run.returncode for run in told] == [0, 0], told
    assert "picket_0 left" in told[0].stdout
    assert "silent robot" in told[1].stdout

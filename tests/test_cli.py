"""The `coop` launcher and `coop doctor`, as processes of their own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from coop_envs.cli import guarded, main, parse
from coop_envs.doctor import Options
from coop_envs.errors import ConfigError

COOP = Path(sys.executable).with_name("coop")


def coop(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([COOP, *arguments], capture_output=True, text=True, timeout=60, check=False)


def test_help_lists_every_command_with_a_line():
    shown = coop("--help")
    assert shown.returncode == 0
    for command in ("demo", "doctor", "evaluate"):
        line = next(line for line in shown.stdout.splitlines() if line.startswith(f"  {command} "))
        assert len(line.split()) > 4
    assert "not installed" not in shown.stdout


def test_listing_commands_imports_none_of_them():
    program = "import sys, coop_envs.cli as cli; cli.main(['--help']); print(*sys.modules)"
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert not {"warp", "train.evaluate", "scipy", "matplotlib", "tyro"} & set(shown.stdout.split())


def test_importing_the_package_is_cheap():
    program = "import sys, coop_envs; print(*sys.modules)"
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert not {"warp", "cv2", "scipy", "trimesh", "matplotlib", "torch"} & set(shown.stdout.split())


def test_nothing_called_is_a_usage_error():
    assert coop().returncode == 2


def test_version():
    assert coop("--version").stdout.startswith("coop_envs ")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (
            ("doctr",),
            (
                "command: got 'doctr', expected one of demo, deploy, doctor, evaluate, localize, play, reproduce, "
                "train (did you mean 'doctor'?)"
            ),
        ),
        (("doctor", "--jsno"), "--jsno"),
        (("evaluate",), "--policy"),
        (("evaluate", "--policy", "random_walk", "--episodes", "many"), "'many'"),
        (("evaluate", "--policy", "random_walk", "--episodes", "0"), "episodes: got 0, expected 1 or more"),
    ],
)
def test_mistakes_are_told_in_one_line(arguments, expected):
    told = coop(*arguments)
    assert told.returncode == 2
    assert told.stdout == ""
    assert len(told.stderr.splitlines()) == 1
    assert told.stderr.startswith("error: ")
    assert expected in told.stderr


def test_command_help_names_options_and_units():
    shown = coop("evaluate", "--help")
    assert shown.returncode == 0
    for words in ("--scenario", "--world", "metres", "--episodes", "count"):
        assert words in shown.stdout


def test_interruption_has_its_own_exit_code(capsys):
    def interrupted() -> int:
        raise KeyboardInterrupt

    assert guarded(interrupted) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_users_error_is_one_line(capsys):
    def mistaken() -> int:
        raise ConfigError("map.cell_m", -1, "0.01 to 0.5 m")

    assert guarded(mistaken) == 2
    assert capsys.readouterr().err == "error: map.cell_m: got -1, expected 0.01 to 0.5 m\n"


def test_a_missing_package_is_named(capsys):
    def lacking() -> int:
        raise ModuleNotFoundError("No module named 'torch'", name="torch")

    assert guarded(lacking) == 2
    assert "'torch' is not installed" in capsys.readouterr().err


def test_parse_reads_a_dataclass():
    assert parse(Options, "doctor", ["--json"]).json


def test_doctor_reports_what_a_program_can_read(capsys):
    assert main(["doctor", "--json"]) == 0
    findings = json.loads(capsys.readouterr().out)
    assert findings["core"]["numpy"]
    assert None not in findings["core"].values()
    assert {"viz", "log", "train", "dev"} <= set(findings["extras"])
    assert all(extra["enables"] for extra in findings["extras"].values())
    assert findings["warp"]["devices"][0].startswith("cpu")


def test_doctor_finds_what_is_missing(monkeypatch, capsys):
    monkeypatch.setattr("coop_envs.doctor._version", lambda name: None if name == "scipy" else "1")
    assert main(["doctor"]) == 1
    assert "scipy missing" in capsys.readouterr().out

"""Nobody but the supervisor makes a `SafeCommand`."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from coop_envs.errors import CoopError
from hardware_bridge.command import RobotCommand, SafeCommand, Seal, checked_safe

ROOT = Path(__file__).parents[3]
PACKAGES = ("coop_envs", "baselines", "policies", "experiments", "hardware_bridge", "train", "examples", "benchmarks")
SECRET = {"supervisors_seal", "_SEAL"}


def names_of(path: Path) -> set[str]:
    """Every name, attribute, import and string in a module."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.alias(name=name):
                names.add(name)
            case ast.Constant(value=str(name)):
                names.add(name)
    return names


def test_only_safety_asks_for_the_seal():
    modules = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    users = {path.relative_to(ROOT).as_posix() for path in modules if names_of(path) & SECRET}
    assert users == {"hardware_bridge/command.py", "hardware_bridge/safety/supervisor.py"}


@pytest.mark.parametrize("seal", [None, Seal()])
def test_a_forged_command_is_refused(seal):
    with pytest.raises(CoopError, match=r"^command: got .*, expected .*"):
        SafeCommand(RobotCommand(), seal)
    with pytest.raises(CoopError, match=r"^command: got RobotCommand, expected .*"):
        checked_safe(RobotCommand())

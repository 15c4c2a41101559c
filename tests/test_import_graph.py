"""Who may import whom: `ALLOWED`, held against every import statement, lazy ones included."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("coop_envs", "baselines", "policies", "experiments", "hardware_bridge", "train")

FOUNDATION = {"coop_envs.errors", "coop_envs.validation"}
SIBLINGS = {"coop_envs.worlds", "coop_envs.agents", "coop_envs.sensing", "coop_envs.mapping"}
BELOW_ENVIRONMENT = FOUNDATION | SIBLINGS | {"coop_envs.geometry", "coop_envs.estimation", "coop_envs.simulation"}
SEEING = {"coop_envs.recording", "coop_envs.viewer"}
ENVIRONMENT = BELOW_ENVIRONMENT | SEEING | {"coop_envs"}
SEEN_BY_POLICIES = FOUNDATION | {"coop_envs", "coop_envs.geometry", "coop_envs.agents", "coop_envs.mapping"}

ALLOWED: dict[str, set[str]] = {
    "coop_envs.errors": set(),
    "coop_envs.validation": {"coop_envs.errors"},
    "coop_envs.geometry": FOUNDATION,
    **{room: FOUNDATION | {"coop_envs.geometry"} for room in SIBLINGS},
    "coop_envs.estimation": FOUNDATION | SIBLINGS | {"coop_envs.geometry"},
    "coop_envs.simulation": FOUNDATION | SIBLINGS | {"coop_envs.geometry"},
    "coop_envs.recording": FOUNDATION | {"coop_envs.geometry"},
    "coop_envs.viewer": FOUNDATION | {"coop_envs.geometry", "coop_envs.recording"},
    "coop_envs.localization": FOUNDATION
    | {"coop_envs.geometry", "coop_envs.agents", "coop_envs.sensing", "coop_envs.estimation", "coop_envs.cli"}
    | {"coop_envs.device"}
    | SEEING,
    "coop_envs": ENVIRONMENT,
    "coop_envs.wrappers": SEEN_BY_POLICIES,
    "baselines": SEEN_BY_POLICIES,
    "policies": SEEN_BY_POLICIES,
    "experiments": ENVIRONMENT | {"baselines"},
    "hardware_bridge": FOUNDATION
    | {"coop_envs.geometry", "coop_envs.agents", "coop_envs.sensing", "coop_envs.estimation", "coop_envs.mapping"}
    | {"coop_envs.recording", "coop_envs.observations", "coop_envs.actions", "coop_envs.belief_loop"}
    | {"coop_envs.localization"}
    | {"coop_envs.belief_picture", "coop_envs.inchworm_rule", "coop_envs.policy", "coop_envs.device", "coop_envs.cli"},
    "hardware_bridge.emulators": ENVIRONMENT | {"hardware_bridge"},
    "train": ENVIRONMENT | {"baselines", "policies", "experiments"},
}
"""Each room and the rooms it may import besides itself; ``coop_envs`` stands for its top-level modules."""

NEVER_REACHED = {
    "hardware_bridge": {"coop_envs.simulation", "train", "torch", "stable_baselines3", "pybullet"},
    "coop_envs.recording": {"coop_envs.simulation", "torch"},
    "coop_envs.localization": {"coop_envs.simulation", "torch"},
    "baselines": {"torch", "stable_baselines3"},
    "coop_envs": {"torch", "stable_baselines3", "train", "baselines"},
}
"""What a room must not import even through others."""

CONFINED = {
    "torch": {"train", "policies"},
    "stable_baselines3": {"train"},
    "ray": {"train"},
    "pybullet": {"coop_envs.simulation"},
}
"""Outside packages that only some rooms may import."""


@cache
def modules() -> dict[str, Path]:
    """Path by dotted name of every module in the tree."""
    found: dict[str, Path] = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports(module: str) -> frozenset[str]:
    """Dotted names that a module imports anywhere in its text; a name that is a module counts as the module."""
    path = modules()[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return frozenset(name for node in ast.walk(tree) for name in _named(node, package))


def _named(node: ast.AST, package: str) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        parts = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
        base = ".".join([*parts, *([node.module] if node.module else [])])
        submodules = [f"{base}.{alias.name}" for alias in node.names]
        yield from ([base] if not all(name in modules() for name in submodules) else [])
        yield from (name for name in submodules if name in modules())
    elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("importlib.import_module", "import_module"):
        yield from (str(argument.value) for argument in node.args if isinstance(argument, ast.Constant))


def room(module: str) -> str:
    """The room a module of ours belongs to; other packages are rooms of their own."""
    parts = module.split(".")
    part = ".".join(parts[:2])
    return part if part in ALLOWED else parts[0]


def reached(start: str) -> dict[str, str]:
    """Everything that the modules of a room import, directly or through others, with the module that did.

    Importing ``a.b`` runs ``a`` too.
    """
    found: dict[str, str] = {}
    waiting = [module for module in modules() if room(module) == start]
    while waiting:
        module = waiting.pop()
        for name in imports(module):
            parts = name.split(".")
            for parent in (".".join(parts[:depth]) for depth in range(1, len(parts) + 1)):
                if parent not in found:
                    found[parent] = module
                    waiting += [parent] if parent in modules() else []
    return found


@pytest.mark.parametrize("module", sorted(modules()))
def test_imports_only_what_its_room_may(module):
    own = room(module)
    ours = {name for name in imports(module) if name.split(".")[0] in PACKAGES}
    refused = {name for name in ours if room(name) != own and not ({room(name), name} & ALLOWED[own])}
    assert not refused, f"{module} ({own}) imports {sorted(refused)}"


@pytest.mark.parametrize("start", sorted(NEVER_REACHED))
def test_never_reaches(start):
    found = reached(start)
    bad = {name: by for name, by in found.items() if {room(name), name.split(".")[0]} & NEVER_REACHED[start]}
    assert not bad, f"{start} reaches {bad}"


@pytest.mark.parametrize("package", sorted(CONFINED))
def test_confined(package):
    users = {room(module) for module in modules() for name in imports(module) if name.split(".")[0] == package}
    assert users <= CONFINED[package]


def test_every_package_of_the_tree_is_in_the_graph():
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages == set(PACKAGES)
    folders = {f"coop_envs.{path.parent.name}" for path in (ROOT / "coop_envs").glob("*/*.py")}
    assert folders <= set(ALLOWED)

"""Drive robots by keyboard, simulated or real, behind the same safety supervisor; recorded, and replayed exactly."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from coop_envs.agents.catalog import load_team
from coop_envs.cli import parse
from coop_envs.errors import require
from coop_envs.policy import load_policy
from hardware_bridge.deploy import run
from hardware_bridge.manual_drive import HELP
from hardware_bridge.session import Order


@dataclass(frozen=True)
class Options:
    """Drive robots by keyboard, simulated or real, behind the same safety supervisor.

    Without a team file the robots are simulated: a team in a scenario's world.
    """

    team: str | None = None
    """A team file (.yaml) with links; or, for simulation, a team preset's name (default: surveyors)."""
    scenario: str = "rubble"
    """The simulated world's scenario."""
    world: int = 0
    """Which of the scenario's worlds."""
    policy: str | None = None
    """A policy that drives whom you do not; without one they stand."""
    log: Path = Path("out/play.mcap")
    """Where to record the mission (.mcap); `coop deploy --replay` replays it."""
    seed: int = 0
    """Seed of the simulation and the policy."""
    time_limit_s: float = 600.0
    """Ends after so many seconds."""
    json: bool = False
    """Print what the mission came to as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run ``coop play``."""
    options = parse(Options, "play", argv)
    require(options.time_limit_s > 0, "time_limit_s", options.time_limit_s, "more than 0 s")
    Console(stderr=True).print(HELP, highlight=False, soft_wrap=True)
    with tempfile.TemporaryDirectory() as folder:
        order = Order(
            team_file=_team_file(options, Path(folder)),
            policy_name=options.policy or "",
            policy=load_policy(options.policy) if options.policy else None,
            seed=options.seed,
            log=options.log,
            time_limit_s=options.time_limit_s,
            command=" ".join(["coop play", *argv]),
        )
        return run(order, keyboard=True, as_json=options.json)


def _team_file(options: Options, folder: Path) -> Path:
    if options.team is not None and Path(options.team).suffix in (".yaml", ".yml"):
        return Path(options.team)
    team = load_team(options.team or "surveyors")
    cameras = {m.name: {"camera": {"kind": "simulator"}} if m.camera else {} for m in team.members}
    robots = {m.name: {"link": {"kind": "simulator"}, **cameras[m.name]} for m in team.members}
    emulation = {"scenario": options.scenario, "world": options.world, "seed": options.seed}
    file = folder / "team.yaml"
    tree = {"team": options.team or "surveyors", "robots": robots, "emulation": emulation}
    file.write_text(json.dumps({**tree, "safety": {"inchworm": False}}))
    return file

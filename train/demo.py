"""Evaluate the baselines on one team of surveyors before a wall corner, a few episodes each, and write a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from coop_envs.cli import parse
from train import evaluate

POLICIES = ("random_walk", "goal_grid", "inchworm_scan", "frontier")
SCENARIO, TEAM = "corner", "surveyors"


@dataclass(frozen=True)
class Options:
    """Evaluate random_walk, goal_grid, inchworm_scan and frontier on one team that fits all; write DIR/report.html."""

    episodes: int = 2
    """Episodes for each policy (count)."""
    seed: int = 0
    """Seed of the first episode."""
    out: Path = Path("out/demo")
    """Folder for the outputs."""


def main(argv: Sequence[str]) -> int:
    """Run ``coop demo``; exit codes as of `evaluate`."""
    options = parse(Options, "demo", argv)
    preset = evaluate.Options(
        policy=POLICIES,
        scenario=SCENARIO,
        team=TEAM,
        episodes=options.episodes,
        seed=options.seed,
        out=options.out,
    )
    return evaluate.evaluate(preset, " ".join(["coop demo", *argv]))

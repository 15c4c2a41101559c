"""Evaluate random_walk and goal_grid in the arena, a few episodes each, and write a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from coop_envs.cli import parse
from train import evaluate

POLICIES = ("random_walk", "goal_grid")


@dataclass(frozen=True)
class Options:
    """Evaluate random_walk and goal_grid in the arena and write DIR/report.html."""

    episodes: int = 4
    """Episodes for each policy (count)."""
    seed: int = 0
    """Seed of the first episode."""
    out: Path = Path("out/demo")
    """Folder for the outputs."""


def main(argv: Sequence[str]) -> int:
    """Run ``coop demo``; exit codes as of `evaluate`."""
    options = parse(Options, "demo", argv)
    preset = evaluate.Options(policy=POLICIES, episodes=options.episodes, seed=options.seed, out=options.out)
    return evaluate.evaluate(preset, " ".join(["coop demo", *argv]))

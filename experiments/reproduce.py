"""Reproduce the thesis's tables and figures: ours beside theirs, as a table, JSON and PNG."""

from __future__ import annotations

import dataclasses
import difflib
import importlib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from coop_envs.cli import parse
from coop_envs.errors import ConfigError, require
from coop_envs.recording.whole_file import written_whole
from experiments.comparison import Result, terminal_table, to_json

EXPERIMENTS = {
    "table-5.2": "experiments.table_5_2",
    "table-5.3": "experiments.table_5_3",
    "figure-5.4": "experiments.figure_5_4:FIGURE_5_4",
    "figure-5.5": "experiments.figure_5_4:FIGURE_5_5",
    "figure-5.6": "experiments.figure_5_4:FIGURE_5_6",
    "figure-5.9": "experiments.figure_5_9:FIGURE_5_9",
    "figure-5.10": "experiments.figure_5_9:FIGURE_5_10",
    "figure-5.11": "experiments.figure_5_9:FIGURE_5_11",
    "figure-5.12": "experiments.figure_5_9:FIGURE_5_12",
    "consistency": "experiments.consistency",
    "figure-6.1": "experiments.figure_6_1",
    "figure-6.2": "experiments.figure_6_2",
    "figure-6.6": "experiments.figure_6_6",
    "figure-6.7": "experiments.figure_6_7",
}
"""Module, or module and name in it: ``run(config, tick) -> table`` computes, ``plot(table) -> Figure`` draws."""


@dataclass(frozen=True)
class Options:
    """Reproduce the thesis's tables and figures: ours beside theirs.

    Prints a table and writes DIR/NAME.png and DIR/NAME.json for each.
    """

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Which: table-5.2, table-5.3, figure-5.4, figure-5.5, figure-5.6, figure-5.9, figure-5.10, figure-5.11,
    figure-5.12, consistency, figure-6.1, figure-6.2, figure-6.6, figure-6.7; all of them if none is named."""
    out: Path = Path("out/reproduce")
    """Folder for the pictures and figures."""
    seeds: int = 0
    """Teams that chapter 5's experiments drive; 0: each one's own number."""
    json: bool = False
    """Print one JSON document a name, one after another, instead of tables."""


def main(argv: Sequence[str]) -> int:
    """Run ``coop reproduce``."""
    options = parse(Options, "reproduce", argv)
    names = options.names or tuple(EXPERIMENTS)
    for name in names:
        _check_name(name)
    check_folder(options.out)
    require(0 <= options.seeds <= 1000, "seeds", options.seeds, "0 to 1000")
    console = Console(stderr=True)
    for name in names:
        document, result = reproduce(name, options.out, console, options.seeds)
        if options.json:
            sys.stdout.write(document)
        else:
            Console().print(terminal_table(result))
    console.print(f"pictures in {options.out}", soft_wrap=True)
    return 0


def reproduce(name: str, folder: Path, console: Console, seeds: int = 0) -> tuple[str, Result]:
    """Run an experiment and write its picture and its JSON document, which is returned with the result."""
    home, _, part = EXPERIMENTS[name].partition(":")
    module: Any = importlib.import_module(home)
    experiment: Any = getattr(module, part) if part else module
    seeded = seeds > 0 and any(entry.name == "seeds" for entry in dataclasses.fields(module.Config))
    given = {"config": module.Config(seeds=seeds)} if seeded else {}
    with _progress(console) as progress:
        task = progress.add_task(name, total=1.0)
        result: Result = experiment.run(tick=lambda share: progress.update(task, completed=share), **given)
        figure = experiment.plot(result)
    document = to_json(name, result)
    with written_whole(folder / f"{name}.png") as path:
        figure.savefig(path, format="png")
    with written_whole(folder / f"{name}.json") as path:
        path.write_text(document, encoding="utf-8")
    return document, result


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or written to, before anything is computed.

    Raises:
        ConfigError: naming the folder.
    """
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    require(nearest.is_dir() and os.access(nearest, os.W_OK), "out", str(folder), "a folder that can be written")


def _check_name(name: str) -> None:
    if name not in EXPERIMENTS:
        close = difflib.get_close_matches(name, EXPERIMENTS, n=1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise ConfigError("name", name, f"one of {', '.join(EXPERIMENTS)}{hint}")


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    return Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console)

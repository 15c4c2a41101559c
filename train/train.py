"""Train an exploration policy for teams by PPO: policy.onnx, checkpoints, learning curves, report."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from coop_envs.cli import guarded, parse
from coop_envs.errors import require
from coop_envs.validation import known, read_yaml, validated
from train.training_settings import TrainingSettings

LINE_PERIOD_S = 30.0
"""Between lines that tell how far it is, where no bar can be drawn."""


@dataclass(frozen=True)
class Run:
    """Where settings come from, and what becomes of the run.

    Values are taken from the preset, then from the file, then from the other options.
    """

    preset: str | None = None
    """Settings that come with the package, by name; the one named like the scenario if there is one."""
    config: Path | None = None
    """A YAML file of settings, such as the training.yaml that every run writes."""
    resume: bool = False
    """Go on from OUT's newest checkpoint, with its settings."""
    json: bool = False
    """Print the final figures as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run ``coop train``; 0 if it came to its end, 130 if interrupted."""
    # Read when torch is loaded: its threads must not spin for each other where they are not alone on the machine.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # whoever takes the machine back gets a checkpoint too
    console = Console(stderr=True)
    base, checkpoint = _base(argv, console)
    settings, run = _parsed(argv, base)
    return train(settings, run, " ".join(["coop train", *argv]), console, checkpoint)


def train(settings: TrainingSettings, run: Run, command: str, console: Console, checkpoint: Any = None) -> int:
    """Train, write everything, tell the outcome; the exit code.

    Raises:
        CoopError: something cannot work, or went wrong on the way.
    """
    from train import training_progress as progress
    from train.learning_report import reportable, write_learning_report
    from train.training import Training

    if checkpoint is None:
        check_folder(settings.out)
    with _bar(console) as bar:
        task = bar.add_task("preparing", total=settings.steps, note="the first run compiles the simulation")

        told_at = time.monotonic()

        def tell(steps: int, row: Mapping[str, Any]) -> None:
            nonlocal told_at
            if not console.is_terminal and time.monotonic() - told_at >= LINE_PERIOD_S:
                told_at = time.monotonic()
                console.print(f"{steps:,} of {settings.steps:,} steps, {_note(row)}", soft_wrap=True, highlight=False)
            bar.update(task, completed=steps, description="training", note=_note(row))

        training = Training(settings, command, tell=tell, checkpoint=checkpoint)
        with closing(training):
            if checkpoint is not None and progress.finished(settings.out / "progress.json", settings.steps):
                bar.stop()
                console.print(f"complete already; to train longer: --steps {2 * settings.steps}", highlight=False)
                return 0
            bar.update(task, completed=training.steps, description="training", note="")
            status = training.run()
            bar.update(task, completed=training.steps)
    document = training.document
    if reportable():
        write_learning_report(document, settings.out / "report.html")
    else:
        console.print("no report: the viz extra is missing (coop doctor)")
    if run.json:
        sys.stdout.write(progress.to_json(progress.summary(document)))
    for line in _outcome(document):
        console.print(line, soft_wrap=True, highlight=False)
    return 130 if status == "interrupted" else 0


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written, that holds a training to go on with, or something else.

    Raises:
        ConfigError: naming the folder.
    """
    held = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    begun = "training.yaml" in held and any((folder / "checkpoints").glob("*.zip"))
    require(not begun, "out", str(folder), "a new folder, or --resume to go on with the training in this one")
    require(not held or "training.yaml" in held, "out", str(folder), "a new or empty folder")
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    writable = nearest.is_dir() and os.access(nearest, os.W_OK)
    require(writable, "out", str(folder), "a folder that can be written")


def preset_names() -> list[str]:
    """The settings that come with the package."""
    return sorted(Path(entry.name).stem for entry in _presets().iterdir() if entry.name.endswith(".yaml"))


def preset(name: str) -> dict[str, Any]:
    """The settings of a preset, as far as it names them.

    Raises:
        ConfigError: there is none of this name.
    """
    known(name, preset_names(), "preset", "one of")
    return read_yaml((_presets() / f"{name}.yaml").read_text(encoding="utf-8"), f"{name}.yaml")


def _presets() -> Any:
    return resources.files("train") / "presets"


def _base(argv: Sequence[str], console: Console) -> tuple[TrainingSettings, Any]:
    """The settings before the command line's own, and the checkpoint to go on from, if any."""
    given = _sources(argv)
    tree: dict[str, Any] = {}
    checkpoint = None
    if given.resume:
        from train.checkpoint import newest_checkpoint

        folder = Path(given.out or TrainingSettings().out)
        path, checkpoint = newest_checkpoint(folder / "checkpoints", console.print)
        console.print(f"going on from {path}", soft_wrap=True, highlight=False)
        tree = {**checkpoint.about["settings"], "out": str(folder)}
    file: dict[str, Any] = {}
    if given.config:
        path = Path(given.config)
        require(path.is_file(), "config", str(path), "a YAML file that exists")
        file = read_yaml(path.read_text(encoding="utf-8"), str(path))
    scenario = given.scenario or file.get("scenario") or TrainingSettings().scenario
    fits = scenario in preset_names() and not (given.resume or given.world or file.get("world"))
    chosen = given.preset or (scenario if fits else None)
    for layer in (preset(chosen) if chosen else {}, file):
        tree = _over(tree, layer)
    return validated(TrainingSettings, tree, given.config or chosen or ""), checkpoint


def _sources(argv: Sequence[str]) -> argparse.Namespace:
    """The options that decide on the defaults of all others."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    for name in ("preset", "config", "scenario", "world", "out"):
        parser.add_argument(f"--{name}")
    parser.add_argument("--resume", action="store_true")
    try:
        return parser.parse_known_args(argv)[0]
    except argparse.ArgumentError:  # an option without its value: the full parser says so
        return parser.parse_known_args([])[0]


def _parsed(argv: Sequence[str], base: TrainingSettings) -> tuple[TrainingSettings, Run]:
    def chosen(
        settings: Annotated[TrainingSettings, tyro.conf.arg(name="")] = base,
        run: Annotated[Run, tyro.conf.arg(name="")] = Run(),
    ) -> tuple[TrainingSettings, Run]:
        return settings, run

    chosen.__doc__ = TrainingSettings.__doc__
    chosen.__annotations__ |= {
        "settings": Annotated[TrainingSettings, tyro.conf.arg(name="")],
        "run": Annotated[Run, tyro.conf.arg(name="")],
    }
    return parse(chosen, "train", argv)  # pyright: ignore[reportArgumentType]


def _over(tree: Any, layer: Any) -> Any:
    """``tree`` with the values of ``layer`` put in, entry by entry."""
    if isinstance(tree, Mapping) and isinstance(layer, Mapping):
        return {**tree, **{key: _over(tree.get(key), value) for key, value in layer.items()}}
    return layer


def _note(row: Mapping[str, Any]) -> str:
    parts = [f"{row['steps_per_s']:,.0f} steps/s"] if "steps_per_s" in row else []
    if row.get("return") is not None:
        parts.append(f"return {row['return']:.2f}")
    return ", ".join(parts)


def _outcome(document: Mapping[str, Any]) -> list[str]:
    last = document["held_out"][-1] if document["held_out"] else {}
    speed = f"{document['steps_per_s']:,.0f} steps/s"
    lines = [f"{document['status']}: {document['steps']:,} steps in {document['wall_s']:,.0f} s ({speed})"]
    if last:
        lines.append(
            f"held-out worlds: return {last['return']:.2f}, {last['information_bits']:.1f} bits, "
            f"{last['bits_per_action_joule']:.3f} bits per action joule, {last['pickets_lost']:.2f} pickets lost, "
            f"success {100 * last['success']:.0f} %"
        )
    out = document["settings"]["out"]
    resume = f"; go on with: coop train --resume --out {out}" if document["status"] == "interrupted" else ""
    return [*lines, f"results in {out}{resume}"]


def _bar(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    times = (TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), TextColumn("{task.fields[note]}"))
    return Progress(*columns, *times, console=console)


if __name__ == "__main__":
    sys.exit(guarded(lambda: main(sys.argv[1:])))

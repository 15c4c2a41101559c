"""Evaluate exploration policies on the same worlds and seeds: results.json, report, logs, videos."""

from __future__ import annotations

import dataclasses
import itertools
import os
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from coop_envs.cli import parse
from coop_envs.device import available_cpus
from coop_envs.errors import require
from coop_envs.policy import check_needs, load_policy
from train.episode import EpisodeJob, Row, episode_name, identity, make_exploration, policy_label, run_episode
from train.overrides import Overrides, assignments
from train.pool import Outcome, run_jobs
from train.reporting import PICTURED, Pictures, installed, keep_picture, report, reportable
from train.results import CRASHED, Document, add_row, new_document, summarise, to_json, write
from train.results_table import results_tables

WRITE_PERIOD_S = 2.0


@dataclass(frozen=True)
class Options:
    """Evaluate exploration policies on the same worlds and seeds.

    Writes DIR/results.json, DIR/report.html, DIR/episodes/*.mcap and, if asked, DIR/videos.
    """

    policy: tuple[str, ...]
    """Policies by name, folders of trainings, .onnx files, or .py files that define make_policy()."""
    scenario: str = "arena"
    """A scenario's name, or its YAML file."""
    world: Path | None = None
    """A triangle mesh (.ply, .obj, .stl; metres, z up) or height map (.png) in place of the scenario's world."""
    team: str | None = None
    """A team preset's name, or its YAML file; the scenario's own if not given."""
    overrides: Overrides = ()
    """Replaces one entry of the scenario, such as task.time_limit_s=100; may be given several times."""
    episodes: int = 10
    """Episodes for each policy (count)."""
    seed: int = 0
    """Seed of the first episode; the others count up from it."""
    split: Literal["heldout", "train"] = "heldout"
    """Which worlds: those kept from training, or those trained in."""
    out: Path = Path("out/evaluate")
    """Folder for the outputs: new, empty, or of an earlier evaluation, which is replaced."""
    fidelity: str = "features"
    """Rung of the fidelity ladder."""
    physics: str = "fast"
    """Physics engine."""
    jobs: int | None = None
    """Episodes run at the same time (processes; default: the number of CPUs)."""
    video: bool = False
    """Write a video of every episode."""
    json: bool = False
    """Print the results as JSON instead of a table."""

    @property
    def settings(self) -> dict[str, Any]:
        """Keywords for `exploration_v0.parallel_env`."""
        chosen = {"team": self.team, "world": self.world and str(self.world)}
        given = {name: value for name, value in chosen.items() if value is not None}
        named = {"scenario": self.scenario, "fidelity": self.fidelity, "physics": self.physics, **given}
        return {**assignments(self.overrides), **named}


def main(argv: Sequence[str]) -> int:
    """Run ``coop evaluate``; 0 if every episode finished, 1 if one crashed, 130 if interrupted."""
    return evaluate(parse(Options, "evaluate", argv), " ".join(["coop evaluate", *argv]))


def evaluate(options: Options, command: str, make_env: Callable[..., Any] = make_exploration) -> int:
    """Check everything, run every policy on every world, write the outputs; the exit code.

    Raises:
        CoopError: before anything is written, if something is wrong with the options.
    """
    console = Console(stderr=True)
    with console.status("checking; the first run on a machine compiles the simulation, up to a minute"):
        check(options, make_env)
    clear(options.out)
    document = new_document(command, dataclasses.asdict(options), [policy_label(p) for p in options.policy])
    pictures: Pictures = {}
    status = _run(_jobs(options, command, make_env), options, document, pictures, console)
    if status == "interrupted":
        drop_unfinished(document, options.out)
    summarise(document, status)
    write(document, options.out / "results.json")
    _tell(document, pictures, options, console)
    if status == "interrupted":
        return 130
    return 1 if any(row["error"] for row in _rows(document)) else 0


def check(options: Options, make_env: Callable[..., Any]) -> None:
    """Raise for options that cannot work: numbers, folder, scenario, world, team, and each policy's needs."""
    labels = [policy_label(policy) for policy in options.policy]
    require(bool(labels), "policy", labels, "at least one policy")
    require(len(set(labels)) == len(labels), "policy", labels, "each policy once")
    require(options.episodes >= 1, "episodes", options.episodes, "1 or more")
    require(options.seed >= 0, "seed", options.seed, "0 or more")
    require(options.jobs is None or options.jobs >= 1, "jobs", options.jobs, "1 or more")
    require(not options.video or installed("imageio"), "video", options.video, "the viz extra (coop doctor)")
    check_folder(options.out)
    policies = [load_policy(policy) for policy in options.policy]
    with closing(make_env(**options.settings)) as env:
        for policy in policies:
            check_needs(policy, env.team_description)
            policy.reset(env.team_description, options.seed)
        env.reset(seed=options.seed, options={"world_index": 0, "split": options.split})


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written, or that holds something else than an evaluation.

    Raises:
        ConfigError: naming the folder.
    """
    if folder.exists():
        ours = folder.is_dir() and (not any(folder.iterdir()) or (folder / "results.json").is_file())
        require(ours, "out", str(folder), "a new or empty folder, or one of an earlier evaluation")
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    writable = nearest.is_dir() and os.access(nearest, os.W_OK)
    require(writable, "out", str(folder), "a folder that can be written")


def clear(folder: Path) -> None:
    """Make the folder, without the outputs of an earlier evaluation."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("episodes", "videos"):
        shutil.rmtree(folder / name, ignore_errors=True)
    for name in ("results.json", "report.html"):
        (folder / name).unlink(missing_ok=True)


def drop_unfinished(document: Document, folder: Path) -> None:
    """Remove the files of episodes that are not in the document: a log is complete a little before its episode."""
    kept = {episode_name(row["policy"], row["episode"]) for row in _rows(document)}
    for path in itertools.chain(folder.glob("episodes/*"), folder.glob("videos/*")):
        if path.stem not in kept:
            path.unlink(missing_ok=True)


def _jobs(options: Options, command: str, make_env: Callable[..., Any]) -> list[EpisodeJob]:
    """Episode by episode, each with every policy, so that an interrupted evaluation still compares."""
    log = installed("mcap")
    return [
        EpisodeJob(
            policy=policy,
            episode=episode,
            seed=options.seed + episode,
            split=options.split,
            settings=options.settings,
            folder=options.out,
            log=log,
            video=options.video,
            picture=episode < PICTURED and reportable(),
            command=command,
            make_env=make_env,
        )
        for episode, policy in itertools.product(range(options.episodes), options.policy)
    ]


def _run(jobs: Sequence[EpisodeJob], options: Options, document: Document, pictures: Pictures, console: Console) -> str:
    """Run the jobs and fill document and pictures; the document is written every other second. Its final status."""
    path = options.out / "results.json"
    written_at = -WRITE_PERIOD_S
    workers = min(options.jobs or available_cpus(), len(jobs))
    with _progress(console) as progress, closing(run_jobs(run_episode, jobs, workers)) as outcomes:
        task = progress.add_task("episodes", total=len(jobs))
        try:
            for outcome in outcomes:
                row = _row(jobs[outcome.index], outcome)
                keep_picture(pictures, row)
                add_row(document, row)
                progress.advance(task)
                if time.monotonic() - written_at > WRITE_PERIOD_S:
                    summarise(document, "running")
                    write(document, path)
                    written_at = time.monotonic()
        except KeyboardInterrupt:
            return "interrupted"
    return "complete"


def _row(job: EpisodeJob, outcome: Outcome) -> Row:
    if outcome.error is None:
        return outcome.value
    return identity(job) | {"status": "crashed", "error": outcome.error} | CRASHED


def _tell(document: Document, pictures: Pictures, options: Options, console: Console) -> None:
    """Write the report, print the table or the JSON, and say what is missing and why."""
    rows = _rows(document)
    if rows and reportable():
        report(document, pictures, options.out / "report.html")
    if options.json:
        sys.stdout.write(to_json(document))
    else:
        Console().print(results_tables(document))
    if not reportable():
        console.print("no report: the viz extra is missing (coop doctor)")
    if not installed("mcap"):
        console.print("no episode logs: the log extra is missing (coop doctor)")
    for row in rows:
        if row["error"]:
            console.print(
                f"{row['policy']}, episode {row['episode']} crashed: {row['error']}", style="red", soft_wrap=True
            )
    if document["status"] == "interrupted":
        total = options.episodes * len(options.policy)
        console.print(f"interrupted: {len(rows)} of {total} episodes had finished and are kept")
    console.print(f"results in {options.out}", soft_wrap=True)


def _rows(document: Document) -> list[Row]:
    return [row for entry in document["policies"].values() for row in entry["episodes"]]


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console)

"""Where robots went, from a log of their IMUs, wheels, cameras and fixes."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from tyro.conf import Positional

from coop_envs.cli import parse
from coop_envs.device import prepare
from coop_envs.errors import require
from coop_envs.estimation.settings import Estimation
from coop_envs.localization.assessment import Assessment, assess, true_paths
from coop_envs.localization.logs.events import Log
from coop_envs.localization.logs.read_log import read_log
from coop_envs.localization.result import Result
from coop_envs.localization.result_files import make_folder, write_result
from coop_envs.localization.settings import Clocks, Localization
from coop_envs.validation import read_yaml, validated

CALIBRATION = {"focal_sigma": 0.005, "centre_sigma_px": 2.0, "lever_sigma_m": 0.002, "hat_sigma_m": 0.001}


@dataclass(frozen=True)
class Options:
    """Where robots went, from a log of their IMUs, wheels, cameras and fixes.

    The log is a folder of CSV files, an .mcap file or a ROS 1 bag; see docs/localizing.md. Written are a TUM trajectory
    (timestamp tx ty tz qx qy qz qw; s, m) for each robot, events.csv, trajectories.png and results.json.
    """

    log: Positional[Path]
    """The log."""
    out: Path = Path("out/localized")
    """The folder to write into."""
    team: str | None = None
    """A team by name, or a YAML file, in place of the log's own."""
    settings: Path | None = None
    """A YAML file with entries of `Localization` (longest_s, bridge_s, ..., estimation: {rest_s, ...})."""
    clocks: Clocks | None = None
    """Whose word on times is taken: stamps, arrivals, turns, or auto, in place of the settings'."""
    self_calibrate: bool = False
    """Let the filter estimate how far lenses, cameras' places and LEDs' places are off: by 0.5 %, 2 px, 2 mm, 1 mm,
    where the settings say nothing else."""
    json: bool = False
    """Print results.json instead of a table."""


def main(argv: Sequence[str]) -> int:
    """Run ``coop localize``; 0 if a robot was localized, 1 if none."""
    options = parse(Options, "localize", argv)
    settings = chosen_settings(options)
    console = Console(stderr=True)
    log = read_log(options.log, options.team)
    make_folder(options.out)
    began_s = time.monotonic()
    result = _localized(log, settings, console)
    truth = true_paths(result, log.truth, log.robots[0])
    found = assess(result, truth)
    document = describe(result, found) | {"log": str(options.log), "wall_s": round(time.monotonic() - began_s, 3)}
    write_result(options.out, result, truth, document)
    for note in result.notes:
        console.print(f"note: {note}", soft_wrap=True, highlight=False)
    if options.json:
        sys.stdout.write(json.dumps(document, indent=2) + "\n")
    else:
        Console().print(_table(result, found))
        console.print(f"written to {options.out}", soft_wrap=True, highlight=False)
    return 0 if result.paths else 1


def chosen_settings(options: Options) -> Localization:
    """Defaults, changed by the settings file and then by the options.

    Raises:
        ConfigError: an entry of the file is unknown or makes no sense.
    """
    settings = Localization()
    if options.settings is not None:
        require(options.settings.is_file(), "settings", str(options.settings), "a YAML file")
        entries = read_yaml(options.settings.read_text(encoding="utf-8"), str(options.settings))
        settings = validated(Localization, entries, "settings")
    if options.clocks is not None:
        settings = replace(settings, clocks=options.clocks)
    if options.self_calibrate:
        settings = replace(settings, estimation=_calibrating(settings.estimation))
    return settings


def _calibrating(estimation: Estimation) -> Estimation:
    """Settings that estimate calibrations too, as vague at first as they say themselves, else as `CALIBRATION`."""
    return replace(estimation, **{name: getattr(estimation, name) or sigma for name, sigma in CALIBRATION.items()})


def _localized(log: Log, settings: Localization, console: Console) -> Result:
    from coop_envs.localization.localizer import localize

    prepare("cpu")
    with _progress(console) as progress:
        task = progress.add_task("localizing", total=1.0)
        return localize(log, settings, lambda share: progress.update(task, completed=share))


def describe(result: Result, found: Mapping[str, Assessment]) -> dict[str, object]:
    """What results.json holds."""
    kinds = sorted({happening.kind.value for happening in result.happenings})
    return {
        "frame": result.frame,
        "planar": result.planar,
        "robots": {
            name: {
                "poses": len(path.time_s),
                "start_s": float(path.time_s[0]),
                "end_s": float(path.time_s[-1]),
                "sigma_m": float(path.covariance[-1].diagonal()[3:].sum() ** 0.5),
                "sigma_heading_deg": float(57.29577951308232 * path.covariance[-1][2, 2] ** 0.5),
                **(asdict(found[name]) if name in found else {}),
            }
            for name, path in result.paths.items()
        },
        "happenings": {kind: sum(one.kind.value == kind for one in result.happenings) for kind in kinds},
        "events": dict(result.counts),
        "clock_offset_s": dict(result.clock_offset_s),
        "landmarks": dict(result.landmarks),
        "calibration": {
            name: {what: {"value": e.value.tolist(), "sigma": e.sigma.tolist()} for what, e in found.items()}
            for name, found in result.calibration.items()
        },
        "notes": list(result.notes),
    }


def _table(result: Result, found: Mapping[str, Assessment]) -> Table:
    table = Table(title=f"paths in the {result.frame} frame", title_justify="left", box=None, padding=(0, 1, 0, 0))
    drifts = ("drift (m)", "drift (%)", "drift (deg)", "NEES") if found else ()
    for column in ("robot", "poses", "sigma (m)", "sigma (deg)", *drifts):
        table.add_column(column, justify="left" if column == "robot" else "right", no_wrap=True)
    for name, path in result.paths.items():
        variances = path.covariance[-1].diagonal()
        row = [name, str(len(path.time_s)), f"{variances[3:].sum() ** 0.5:.4f}", f"{57.2958 * variances[2] ** 0.5:.3f}"]
        if name in found:
            one = found[name]
            row += [f"{one.position_drift_m:.4f}", f"{one.drift_percent_of_path:.2f}", f"{one.heading_drift_deg:.3f}"]
            row.append(f"{one.nees_mean:.2f}")
        table.add_row(*row)
    return table


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    left = TextColumn("left"), TimeRemainingColumn()
    return Progress(*columns, *left, console=console, transient=True, disable=not console.is_terminal)

"""A log as a folder of CSV files, one for each kind of row, and its ``team.yaml``."""

from __future__ import annotations

import csv
import io
import re
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from coop_envs.errors import ConfigError, require
from coop_envs.localization.logs.assembly import assemble
from coop_envs.localization.logs.columns import KINDS, Kind, RawRows, check_columns
from coop_envs.localization.logs.events import Log
from coop_envs.localization.logs.rows import log_rows
from coop_envs.localization.logs.team_file import LogTeam, TeamReference, read_team, team_text
from coop_envs.validation import suggestion

TEAM_FILE = "team.yaml"
FILES = {f"{name}.csv": kind for name, kind in KINDS.items()}


def read_folder(folder: Path, team: TeamReference | None = None) -> Log:
    """The log in a folder; ``team`` takes the place of its ``team.yaml``.

    Raises:
        ConfigError: files, rows or columns that cannot be used.
    """
    raws = [read_rows(folder / name, kind) for name, kind in FILES.items() if (folder / name).is_file()]
    if not raws:
        held = ", ".join(sorted(path.name for path in folder.iterdir())[:5]) or "nothing"
        raise ConfigError("log", f"{folder} with {held}", f"a folder with {' or '.join(list(FILES)[:2])}")
    own = folder / TEAM_FILE
    who: LogTeam | None = None
    if team is not None or own.is_file():
        who = read_team(own if team is None else team)
    unread = sorted(path.name for path in folder.glob("*.csv") if path.name not in FILES)
    notes = [f"{name} is not read: no kind of row has this name{suggestion(name, FILES)}" for name in unread]
    return assemble(str(folder), raws, who, notes)


def read_rows(path: Path, kind: Kind) -> RawRows:
    """The cells of one CSV file, column by column.

    Raises:
        ConfigError: no table of this kind's columns; rows that are longer or shorter than the header.
    """
    name = path.name
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(name, error.strerror, "a file that can be read") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{name} line {_line(path, error.start)}", "bytes that are not UTF-8", "text") from None
    _check_header(text, name, kind)
    header, columns, lines = (_quoted_cells if '"' in text or "\r" in text else _plain_cells)(text, name)
    place: Callable[[int], str] = lambda i: f"{name} line {lines[i]}" if i >= 0 else name  # noqa: E731
    return RawRows(kind, dict(zip(header, columns, strict=True)), place)


def _check_header(text: str, name: str, kind: Kind) -> None:
    """That the first line that is not empty names columns of the kind."""
    first = re.split(r"[\r\n]", text.lstrip(), maxsplit=1)[0]
    if not first:
        raise ConfigError(name, "an empty file", f"a line that names the columns: {', '.join(kind.columns)}")
    header = [cell.strip() for cell in next(csv.reader([first], skipinitialspace=True))]
    place = f"{name} line {1 + text[: text.index(first)].count(chr(10))}"
    require(len(set(header)) == len(header), f"{place}, columns", header, "each column once")
    check_columns(kind, header, place)


Cells = tuple[list[str], Sequence[Sequence[str]], Sequence[int]]
"""Names of the columns, their cells, and the line of each row."""


def _plain_cells(text: str, name: str) -> Cells:
    """Cells of lines without quotes, all split at once: ten times faster than row by row."""
    lines = text.split("\n")
    numbers = [k for k, line in enumerate(lines, 1) if line and not line.isspace()]
    if not numbers:
        return [], [], []
    kept = [lines[k - 1] for k in numbers] if len(numbers) < len(lines) else lines
    header = [cell.strip() for cell in kept[0].split(",")]
    width = len(header)
    for k, line in zip(numbers, kept, strict=True):
        if line.count(",") != width - 1:
            raise ConfigError(f"{name} line {k}", f"{line.count(',') + 1} values", f"{width}, as the header has")
    cells = ",".join(kept[1:]).split(",") if len(kept) > 1 else []
    if " " in text or "\t" in text:
        cells = [cell.strip() for cell in cells]
    return header, [cells[c::width] for c in range(width)], numbers[1:]


def _quoted_cells(text: str, name: str) -> Cells:
    """Cells of any lines that the csv module reads."""
    reader = csv.reader(io.StringIO(text, newline=""), skipinitialspace=True)
    numbers: list[int] = []
    rows: list[list[str]] = []
    try:
        for row in reader:
            if row:
                numbers.append(reader.line_num)
                rows.append([cell.strip() for cell in row])
                if len(row) != len(rows[0]):
                    raise ConfigError(
                        f"{name} line {numbers[-1]}", f"{len(row)} values", f"{len(rows[0])}, as the header has"
                    )
    except csv.Error as error:
        raise ConfigError(f"{name} line {reader.line_num}", str(error), "comma-separated values") from None
    if not rows:
        return [], [], []
    columns = list(zip(*rows[1:], strict=True)) if len(rows) > 1 else [()] * len(rows[0])
    return rows[0], columns, numbers[1:]


def write_folder(folder: Path, log: Log) -> None:
    """Write a log as a folder that appears whole or not at all; an older log there is replaced.

    Raises:
        ConfigError: something else than a log stands there.
    """
    free = "a new folder, or one with a log alone"
    require(folder.is_dir() or not folder.exists(), "log", str(folder), free)
    found = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    strange = [name for name in found if name not in {*FILES, TEAM_FILE}]
    require(not strange, "log", strange, free)
    part, old = (folder.with_name(f"{folder.name}.{what}") for what in ("part", "old"))
    for path in (part, old):
        shutil.rmtree(path, ignore_errors=True)
    try:
        part.mkdir(parents=True)
        for name, rows in log_rows(log).items():
            _write_rows(part / f"{name}.csv", KINDS[name], rows)
        (part / TEAM_FILE).write_text(team_text(log.team, log.robots, log.starts), encoding="utf-8")
        if folder.is_dir():
            folder.replace(old)
        part.replace(folder)
    finally:
        for path in (part, old):
            shutil.rmtree(path, ignore_errors=True)


def _write_rows(path: Path, kind: Kind, rows: Iterable[Mapping[str, object]]) -> None:
    rows = list(rows)
    used = [name for name in kind.columns if any(name in row for row in rows)]
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, used, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _line(path: Path, position: int) -> int:
    return path.read_bytes().count(b"\n", 0, position) + 1

"""Our figures beside the thesis's: rows, their table on the terminal, their JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Protocol

from rich.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Comparison:
    """A quantity as we find it and as the thesis has it, None where it has none; ``remark`` says what differs."""

    quantity: str
    unit: str
    ours: float
    thesis: float | None = None
    remark: str = ""

    @property
    def deviation_percent(self) -> float | None:
        """How far ours is from the thesis's, None where there is nothing to compare with."""
        return None if not self.thesis else 100.0 * (self.ours / self.thesis - 1.0)


class Result(Protocol):
    """What every experiment's ``run`` returns: a title, comparisons and notes, besides what its ``plot`` draws."""

    @property
    def title(self) -> str: ...
    @property
    def comparisons(self) -> Sequence[Comparison]: ...
    @property
    def notes(self) -> Sequence[str]: ...


class Tick(Protocol):
    """Called by a long ``run`` with the share of its work that is done, 0 to 1."""

    def __call__(self, share: float, /) -> object: ...


class Experiment(Protocol):
    """A module of this room."""

    def run(self, *, tick: Tick) -> Any:
        """Compute the table."""
        ...

    def plot(self, table: Any) -> Figure:
        """Draw it."""
        ...


def silent(share: float) -> None:
    """A `Tick` that tells nobody."""


def terminal_table(result: Result) -> Table:
    """The comparisons as a table for a terminal."""
    table = Table(title=result.title, title_justify="left", caption=" ".join(result.notes), caption_justify="left")
    table.add_column("quantity", no_wrap=True)
    for heading in ("ours", "thesis", "deviation"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    if any(row.remark for row in result.comparisons):
        table.add_column("remark")
    for row in result.comparisons:
        deviation = "" if row.deviation_percent is None else f"{row.deviation_percent:+.2f} %"
        thesis = "" if row.thesis is None else f"{row.thesis:g}"
        table.add_row(
            row.quantity, f"{row.ours:.5g}", thesis, deviation, row.unit, *[row.remark][: len(table.columns) - 5]
        )
    return table


def to_json(name: str, result: Result) -> str:
    """The comparisons as a JSON document."""
    rows = [asdict(row) | {"deviation_percent": row.deviation_percent} for row in result.comparisons]
    document = {"name": name, "title": result.title, "comparisons": rows, "notes": list(result.notes)}
    return json.dumps(document, indent=2, allow_nan=False) + "\n"

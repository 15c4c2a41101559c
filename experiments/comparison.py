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
    """A quantity as we find it and as the thesis has it: a number, what it says in words, or None.

    What comes before a colon in ``quantity`` names the group that it belongs to.
    """

    quantity: str
    unit: str
    ours: float
    thesis: float | str | None = None

    @property
    def deviation_percent(self) -> float | None:
        """How far ours is from the thesis's, None where there is no number to compare with."""
        if not self.thesis or isinstance(self.thesis, str):
            return None
        return 100.0 * (self.ours / self.thesis - 1.0)


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
    """The comparisons as a table for a terminal, group by group."""
    table = Table(title=result.title, title_justify="left", caption=" ".join(result.notes), caption_justify="left")
    table.add_column("quantity", no_wrap=True)
    compared = any(row.deviation_percent is not None for row in result.comparisons)
    for heading in ("ours", "thesis", *["deviation"] * compared):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    last = ""
    for row in result.comparisons:
        group, colon, quantity = row.quantity.rpartition(": ")
        if group != last:
            table.add_section()
            table.add_row(f"[bold]{group}[/bold]")
            last = group
        deviation = "" if row.deviation_percent is None else f"{row.deviation_percent:+.2f} %"
        thesis = row.thesis if isinstance(row.thesis, str) else "" if row.thesis is None else f"{row.thesis:g}"
        name = f"  {quantity}" if colon else quantity
        table.add_row(name, _short(row.ours), thesis, *[deviation] * compared, row.unit)
    return table


def _short(value: float) -> str:
    """Three figures of what is below 1, five of what is not, whole numbers from 10000 on."""
    if abs(value) < 1:
        return f"{value:.3g}"
    return f"{value:.5g}" if abs(value) < 1e4 else f"{value:.0f}"


def to_json(name: str, result: Result) -> str:
    """The comparisons as a JSON document."""
    rows = [asdict(row) | {"deviation_percent": row.deviation_percent} for row in result.comparisons]
    document = {"name": name, "title": result.title, "comparisons": rows, "notes": list(result.notes)}
    return json.dumps(document, indent=2, allow_nan=False) + "\n"

"""Table 5.3: drift over the rock garden and the ramp, one picket left behind in a hole; beside it our filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from experiments.comparison import Comparison, Tick, silent
from experiments.contenders import CAMERA, TWO
from experiments.localization_study import UNEVEN, Config, Study, chapter_5
from experiments.table_5_2 import draw_bars, drift_notes, drift_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

THESIS: dict[str, dict[int, tuple[float, float]]] = {
    CAMERA: {0: (13.99, 3.12), 1: (18.11, 6.22), 2: (5.38, 3.58)},
    TWO: {0: (13.75, 2.18), 1: (17.35, 4.29), 2: (5.38, 3.59)},
}
"""Drift (cm, deg) by filter and robot: lengths of the printed (x, y, z), and the printed angles."""


@dataclass(frozen=True)
class Table:
    """The ramp by all filters."""

    study: Study
    title: str = "Table 5.3: drift over rocks and ramp, medians over seeds"

    @property
    def comparisons(self) -> list[Comparison]:
        return drift_rows(self.study, THESIS)

    @property
    def notes(self) -> Sequence[str]:
        return drift_notes(self.study)


def run(config: Config | None = None, tick: Tick = silent) -> Table:
    """Drive all teams."""
    return Table(chapter_5(UNEVEN, (config or Config()).seeds, tick))


def plot(table: Table) -> Figure:
    """Drift of the observer by filter."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.2), layout="constrained", dpi=144)
    values = {name: outcome.drift_cm() for name, outcome in table.study.outcomes.items()}
    draw_bars(figure.subplots(), values, THESIS)
    return figure

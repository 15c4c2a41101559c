"""Figs 5.4 to 5.6: the planar U-turn from above, by one picket, by two, and by the camera alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from experiments.comparison import Comparison, Tick, silent
from experiments.contenders import CAMERA, ONE, OURS, OURS_ONE, TWO
from experiments.inchworm_driver import OBSERVER
from experiments.localization_study import PLANAR, Config, Study, chapter_5
from experiments.table_5_2 import THESIS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROBOTS = (("observer", "#c0392b"), ("picket-1", "#2471a3"), ("picket-2", "#1e8449"))


@dataclass(frozen=True)
class Table:
    """The drive, and which filters are shown for how many robots."""

    study: Study
    title: str
    shown: tuple[str, ...]
    robots: int

    @property
    def comparisons(self) -> list[Comparison]:
        rows: list[Comparison] = []
        for name in self.shown:
            outcome = self.study.outcomes[name]
            thesis = THESIS.get(name, {}).get(OBSERVER, (None, None))
            rows.append(Comparison(f"{name}: drawn team", "cm", float(outcome.drift_cm()[0]), thesis[0]))
            rows.append(Comparison(f"{name}: drawn team, angle", "deg", float(outcome.drift_deg()[0]), thesis[1]))
        return rows

    @property
    def notes(self) -> Sequence[str]:
        return (
            "The observer's drift at the end, of the first team as in the thesis of its only one. In the bend",
            "observers turn away from their pickets and dead-reckon until they see one again.",
        )


@dataclass(frozen=True)
class Trajectories:
    """One of the figures, as an experiment."""

    title: str
    shown: tuple[str, ...]
    robots: int

    def run(self, config: Config | None = None, tick: Tick = silent) -> Table:
        """Drive the teams."""
        study = chapter_5(PLANAR, (config or Config()).seeds, tick)
        return Table(study, self.title, self.shown, self.robots)

    def plot(self, table: Table) -> Figure:
        """A panel a filter: beliefs over the truth."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6.0 * len(table.shown), 4.6), layout="constrained", dpi=144)
        panels = np.atleast_1d(figure.subplots(1, len(table.shown), sharex=True, sharey=True))
        for axes, name in zip(panels, table.shown, strict=True):
            draw_from_above(axes, table.study.truth, table.study.outcomes[name].track, table.robots)
            axes.set_title(f"{name}: {table.study.outcomes[name].drift_cm()[0]:.1f} cm at the end")
        panels[0].legend(loc="center left", fontsize=8)
        return figure


def draw_from_above(axes: Any, truth: NDArray[np.float64], track: NDArray[np.float64], robots: int) -> None:
    """True tracks (K, N, 3) dashed, believed ones in colour, of the first so many robots."""
    for r, (name, colour) in enumerate(ROBOTS[:robots]):
        axes.plot(track[:, r, 0], track[:, r, 1], color=colour, lw=1.2, label=name)
        axes.plot(truth[:, r, 0], truth[:, r, 1], color="black", lw=0.8, ls="--", label="truth" if r == 0 else None)
        axes.plot(track[-1, r, 0], track[-1, r, 1], "o", color=colour, ms=4)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.grid(alpha=0.3)


FIGURE_5_4 = Trajectories("Fig. 5.4: U-turn by one picket", (ONE, OURS_ONE), 2)
FIGURE_5_5 = Trajectories("Fig. 5.5: U-turn by two pickets", (TWO, OURS), 3)
FIGURE_5_6 = Trajectories("Fig. 5.6: U-turn by the camera alone", (CAMERA,), 3)

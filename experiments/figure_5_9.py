"""Figs 5.9 to 5.12: the drive over rocks and ramp in space, from above, and against time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.comparison import Comparison, Tick, silent
from experiments.contenders import CAMERA, OURS, TWO
from experiments.figure_5_4 import ROBOTS, draw_from_above
from experiments.inchworm_driver import OBSERVER
from experiments.localization_study import UNEVEN, Config, Study, chapter_5
from experiments.table_5_3 import THESIS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = (TWO, OURS)
LINES = ((CAMERA, "#b7950b"), (TWO, "#c0392b"), (OURS, "#1e8449"))


@dataclass(frozen=True)
class Table:
    """The drive of the first of some teams."""

    study: Study
    title: str

    @property
    def comparisons(self) -> list[Comparison]:
        rows: list[Comparison] = []
        for name, _ in LINES:
            outcome = self.study.outcomes[name]
            thesis = THESIS.get(name, {}).get(OBSERVER, (None, None))
            rows.append(Comparison(f"{name}: drawn team", "cm", float(outcome.drift_cm()[0]), thesis[0]))
            rows.append(Comparison(f"{name}: drawn team, angle", "deg", float(outcome.drift_deg()[0]), thesis[1]))
        return rows

    @property
    def notes(self) -> Sequence[str]:
        return ("The observer's drift at the end, of the first team as in the thesis of its only one.",)


class _Uneven:
    """What the four figures share."""

    title = ""

    def run(self, config: Config | None = None, tick: Tick = silent) -> Table:
        """Drive the teams."""
        return Table(chapter_5(UNEVEN, (config or Config()).seeds, tick), self.title)


class _InSpace(_Uneven):
    title = "Fig. 5.9: rocks and ramp in space"

    def plot(self, table: Table) -> Figure:
        """A panel a filter, axes to one scale."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(12.0, 5.4), layout="constrained", dpi=144)
        truth = table.study.truth
        for k, name in enumerate(SHOWN):
            axes: Any = figure.add_subplot(1, 2, k + 1, projection="3d")
            track = table.study.outcomes[name].track
            for r, (robot, colour) in enumerate(ROBOTS):
                axes.plot(*track[:, r].T, color=colour, lw=1.2, label=robot)
                axes.plot(*truth[:, r].T, color="black", lw=0.8, ls="--", label="truth" if r == 0 else None)
            axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)", title=name)
            axes.set_zticks([0.0, 0.2])
            axes.set_aspect("equal")
            axes.view_init(35, -120)
        figure.axes[0].legend(loc="upper left", fontsize=8)
        return figure


class _FromAbove(_Uneven):
    title = "Fig. 5.10: rocks and ramp from above"

    def plot(self, table: Table) -> Figure:
        """A panel a filter."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(10.0, 5.4), layout="constrained", dpi=144)
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, name in zip(panels, SHOWN, strict=True):
            draw_from_above(axes, table.study.truth, table.study.outcomes[name].track, len(ROBOTS))
            axes.set_title(name)
        panels[0].legend(loc="lower left", fontsize=8)
        return figure


class _AlongX(_Uneven):
    title = "Fig. 5.11: position along x against time"

    def plot(self, table: Table) -> Figure:
        """Position above, its error below, of the observer."""
        from matplotlib.figure import Figure

        study = table.study
        figure = Figure(figsize=(9.0, 6.0), layout="constrained", dpi=144)
        above, below = figure.subplots(2, 1, sharex=True)
        for name, colour in LINES:
            x = study.outcomes[name].track[:, OBSERVER, 0]
            above.plot(study.time_s, x, color=colour, lw=1.2, label=name)
            below.plot(study.time_s, 100.0 * (x - study.truth[:, OBSERVER, 0]), color=colour, lw=1.2)
        above.plot(study.time_s, study.truth[:, OBSERVER, 0], color="black", lw=0.8, ls="--", label="truth")
        above.set_ylabel("observer's x (m)")
        above.legend(fontsize=8)
        below.set(xlabel="time (s)", ylabel="error of x (cm)", ylim=(-30.0, 30.0))
        for axes in (above, below):
            axes.grid(alpha=0.3)
        return figure


class _AngleError(_Uneven):
    title = "Fig. 5.12: orientation error against time"

    def plot(self, table: Table) -> Figure:
        """The angle between belief and truth of the observer and of picket-1."""
        from matplotlib.figure import Figure

        study = table.study
        figure = Figure(figsize=(9.0, 6.0), layout="constrained", dpi=144)
        panels = figure.subplots(2, 1, sharex=True)
        for r, axes in enumerate(panels):
            for name, colour in LINES:
                axes.plot(
                    study.time_s, np.rad2deg(study.outcomes[name].track_angle[:, r]), color=colour, lw=1.2, label=name
                )
            axes.set_ylabel(f"{ROBOTS[r][0]}'s error (deg)")
            axes.set_ylim(0.0, 12.0)
            axes.grid(alpha=0.3)
        panels[0].legend(fontsize=8)
        panels[-1].set_xlabel("time (s)")
        return figure


FIGURE_5_9, FIGURE_5_10, FIGURE_5_11, FIGURE_5_12 = _InSpace(), _FromAbove(), _AlongX(), _AngleError()

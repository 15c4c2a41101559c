"""Table 5.2: drift over the planar U-turn; beside it our filter, more pickets, and other ways for a team to move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.comparison import Comparison, Tick, silent
from experiments.contenders import CAMERA, ONE, OURS, TWO, WHEELS, ours
from experiments.inchworm_driver import OBSERVER
from experiments.localization_study import (
    PLANAR,
    Config,
    Outcome,
    Study,
    chapter_5,
    crew,
    median_interval,
    moving,
    ratios,
    run_study,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

THESIS: dict[str, dict[int, tuple[float, float]]] = {
    CAMERA: {0: (18.97, 9.33), 1: (32.23, 4.72), 2: (25.85, 4.56)},
    ONE: {0: (6.04, 1.89), 1: (9.16, 2.64)},
    TWO: {0: (3.49, 1.54), 1: (7.82, 1.36), 2: (12.52, 1.88)},
}
"""Drift (cm, deg) by filter and robot: lengths of the printed (x, y, z), and the printed angles."""
ROBOTS = ("observer", "picket-1", "picket-2")
PICKETS = (1, 2, 4, 8)
MAIN_SHARE = 0.6


@dataclass(frozen=True)
class Table:
    """The U-turn by all filters; by ours with other numbers of pickets, and with other ways to move."""

    study: Study
    crews: Mapping[int, Study]
    styles: Mapping[str, Study]
    title: str = "Table 5.2: drift over the planar U-turn, medians over seeds"

    @property
    def comparisons(self) -> list[Comparison]:
        rows = drift_rows(self.study, THESIS)
        for n, study in self.crews.items():
            rows += _rows(f"ours, 5 m straight on, {n} picket{'s' * (n > 1)}", study.outcomes[OURS], {})
        for name, study in self.styles.items():
            rows += _rows(f"ours, {name}", study.outcomes[OURS], {})
            rows.append(Comparison(f"ours, {name}: duration", "s", study.duration_s))
        return rows

    @property
    def notes(self) -> Sequence[str]:
        return (*drift_notes(self.study), *_crew_note(self.crews))


def drift_rows(study: Study, thesis: Mapping[str, Mapping[int, tuple[float, float]]]) -> list[Comparison]:
    """Median drift of the observer by all filters, of the pickets where the thesis tells theirs."""
    rows: list[Comparison] = []
    for name, outcome in study.outcomes.items():
        rows += _rows(name, outcome, thesis.get(name, {}))
    return rows


def _rows(name: str, outcome: Outcome, thesis: Mapping[int, tuple[float, float]]) -> list[Comparison]:
    rows: list[Comparison] = []
    for robot in sorted({OBSERVER, *thesis}):
        cm, deg = thesis.get(robot, (None, None))
        position, angle = float(np.median(outcome.drift_cm(robot))), float(np.median(outcome.drift_deg(robot)))
        rows.append(Comparison(f"{name}: {ROBOTS[robot]}, position", "cm", position, cm))
        rows.append(Comparison(f"{name}: {ROBOTS[robot]}, angle", "deg", angle, deg))
    return rows


def drift_notes(study: Study) -> tuple[str, ...]:
    """Intervals of the observer's drift, and how much less ours is."""
    seeds, metres = len(study.path_m), float(study.path_m[:, OBSERVER].mean())
    spans = [f"{name}: {_span(outcome)}" for name, outcome in study.outcomes.items()]
    position, angle = ratios(study, OURS)
    with_wheels, angle_wheels = ratios(study, WHEELS)
    return (
        f"{seeds} seeds, {metres:.1f} m. The noise of the streams was chosen for the two-picket row of the thesis's",
        "filter; all filters then see the same. Observer, 95 % bootstrap intervals of the medians:",
        *(f"{span};" for span in spans),
        f"ours against the thesis's filter with two pickets: {position:.1f} times less position drift and {angle:.1f}",
        f"times less angle by IMU alone, {with_wheels:.1f} and {angle_wheels:.1f} times with wheels.",
    )


def _span(outcome: Outcome) -> str:
    _, low, high = median_interval(outcome.drift_cm())
    _, least, most = median_interval(outcome.drift_deg())
    return f"{low:.2f} to {high:.2f} cm, {least:.2f} to {most:.2f} deg"


def _crew_note(crews: Mapping[int, Study]) -> tuple[str, ...]:
    spans = (f"{n}: {_span(study.outcomes[OURS])}" for n, study in crews.items())
    return ("Ours straight on, by number of pickets, each its own streams:", *(f"{span};" for span in spans))


def run(config: Config | None = None, tick: Tick = silent) -> Table:
    """Drive all teams."""
    config = config or Config()
    study = chapter_5(PLANAR, config.seeds, lambda share: tick(MAIN_SHARE * share))
    settings = {n: crew(n) for n in PICKETS}
    styles = {"leapfrog": moving("leapfrog"), "cps": moving("cps")}
    others: dict[int | str, Study] = {}
    for k, (name, setting) in enumerate([*settings.items(), *styles.items()]):
        others[name] = run_study(setting, {OURS: ours(wheels=False)}, config.seeds)
        tick(MAIN_SHARE + (1.0 - MAIN_SHARE) * (k + 1) / (len(settings) + len(styles)))
    return Table(study, {n: others[n] for n in PICKETS}, {"inchworm": study} | {name: others[name] for name in styles})


def plot(table: Table) -> Figure:
    """Drift by filter, and ours against the number of pickets and by way to move."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 4.6), layout="constrained", dpi=144)
    first, second, third = figure.subplots(1, 3, width_ratios=[2.2, 1, 1])
    draw_bars(first, {name: outcome.drift_cm() for name, outcome in table.study.outcomes.items()}, THESIS)
    crews = {f"{n}": study.outcomes[OURS].drift_cm() for n, study in table.crews.items()}
    styles = {name: study.outcomes[OURS].drift_cm() for name, study in table.styles.items()}
    for axes, values, label in ((second, crews, "pickets (ours, straight on)"), (third, styles, "way to move (ours)")):
        _draw_columns(axes, values)
        axes.set_xlabel(label)
        axes.set_ylabel("observer's drift (cm)")
    return figure


def draw_bars(
    axes: Any, values: Mapping[str, np.ndarray], thesis: Mapping[str, Mapping[int, tuple[float, float]]]
) -> None:
    """Medians with their intervals, one line a filter, the thesis's figures as crosses."""
    for row, (name, drift) in enumerate(values.items()):
        middle, low, high = median_interval(drift)
        axes.barh(row, middle, color="#58b368" if name.startswith("ours") else "#8aa7c7")
        axes.plot([low, high], [row, row], color="black", lw=1.2)
        if name in thesis:
            axes.plot(thesis[name][OBSERVER][0], row, "x", color="#c0392b", label="thesis" if row == 0 else None)
    axes.set_yticks(range(len(values)), list(values))
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel("observer's drift (cm): medians, 95 % intervals")
    axes.legend(loc="center right")
    axes.grid(axis="x", alpha=0.3)


def _draw_columns(axes: Any, values: Mapping[str, np.ndarray]) -> None:
    for k, drift in enumerate(values.values()):
        middle, low, high = median_interval(drift)
        axes.bar(k, middle, color="#58b368")
        axes.plot([k, k], [low, high], color="black", lw=1.2)
    axes.set_xticks(range(len(values)), list(values))
    axes.set_ylim(bottom=0.0)

"""Fig. 6.7: information h_v against energy as two robots scan, move, scan, move and scan.

The authors' scene is not known: a floor and one wall stand in for it, see `scan_trip.plane_spots`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.catalog import load_robot
from coop_envs.errors import require
from coop_envs.mapping.swept_volume import SweptVolume, round_section
from experiments.comparison import Comparison, Tick, silent
from experiments.scan_trip import Segment, Spots, SpotSource, Trip, energies_j, phases, plane_spots, timeline

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCAN_S = 42.55
FIRST_OF_T3 = 10800.0
PHASE_COLOURS = {"scan": "#2f6fd6", "move": "#d6862f"}


@dataclass(frozen=True)
class Config:
    """The trip, the robots (twice the same), spots between points of the curve, sides of the round cylinders."""

    trip: Trip = field(default_factory=Trip)
    robot: str = "zumy"
    spots_per_point: int = 5
    sides: int = 8

    def __post_init__(self) -> None:
        require(self.spots_per_point >= 1, "spots_per_point", self.spots_per_point, "1 or more")


@dataclass(frozen=True)
class Phase:
    """A scan or a move: its duration, what both robots together had used, and what they had swept.

    ``energy_j``, ``action_energy_j`` (J) and ``h_v`` (n,) run from the phase's start to its end; action energy leaves
    out the idle draw.
    """

    name: str
    duration_s: float
    energy_j: NDArray[np.float64]
    action_energy_j: NDArray[np.float64]
    h_v: NDArray[np.float64]

    @property
    def used_j(self) -> float:
        return float(self.energy_j[-1] - self.energy_j[0])

    @property
    def action_j(self) -> float:
        return float(self.action_energy_j[-1] - self.action_energy_j[0])

    @property
    def gained(self) -> float:
        return float(self.h_v[-1] - self.h_v[0])

    @property
    def late_gain_share(self) -> float:
        """Share of the phase's information that came in the second half of its energy."""
        middle = float(np.interp(0.5 * (self.energy_j[0] + self.energy_j[-1]), self.energy_j, self.h_v))
        return (float(self.h_v[-1]) - middle) / self.gained


@dataclass(frozen=True)
class Table:
    """The phases in order."""

    phases: tuple[Phase, ...]
    trip: Trip
    title: str = "Fig. 6.7: information h_v, in (0.1 m)^3, against energy"

    @property
    def comparisons(self) -> list[Comparison]:
        scans = [phase for phase in self.phases if phase.name.startswith("scan")]
        moves = [phase for phase in self.phases if phase.name.startswith("move")]
        rows = [Comparison("duration of a scan", "s", scans[0].duration_s, SCAN_S)]
        for phase in self.phases:
            rows.append(Comparison(f"energy, {phase.name}", "J", phase.used_j))
            rows.append(Comparison(f"action energy, {phase.name}", "J", phase.action_j))
        rows += [Comparison(f"h_v gained, {phase.name}", "d^3", phase.gained) for phase in scans]
        rows += [
            Comparison(f"late share of it, {phase.name}", "", phase.late_gain_share) for phase in scans if phase.gained
        ]
        rows.append(Comparison("h_v after the first scan", "d^3", float(scans[0].h_v[-1]), FIRST_OF_T3, "fig. 6.2c"))
        if moves:
            ratio = _mean([p.used_j for p in scans]) / _mean([p.used_j for p in moves])
            rows.append(Comparison("energy of a scan over that of a move", "", ratio, remark="thesis: above 1"))
            ratio = _mean([p.action_j for p in scans]) / _mean([p.action_j for p in moves])
            rows.append(Comparison("the same of action energy", "", ratio))
        rows.append(Comparison("h_v per joule", "d^3/J", float(scans[-1].h_v[-1] / scans[-1].energy_j[-1])))
        return rows

    @property
    def notes(self) -> Sequence[str]:
        return (
            f"Scene: the floor and a wall at x = {self.trip.wall_x_m:g} m, every spot seen by both cameras.",
            "The thesis gives neither its scene nor how long it waited for cameras: a scan lasts its shortest time.",
        )


def run(config: Config | None = None, spots: SpotSource = plane_spots, tick: Tick = silent) -> Table:
    """Follow the trip: energy segment by segment, information spot by spot."""
    config = config or Config()
    power = load_robot(config.robot).power
    scans, segments = timeline(config.trip, power)
    volume = SweptVolume(round_section(sides=config.sides))
    seen = iter([spots(scan, config.trip) for scan in scans])
    used, found, names = np.zeros(2), list[Phase](), phases(segments)
    for name in names:
        mine = [segment for segment in segments if segment.phase == name]
        steps = used + np.cumsum([(0.0, 0.0), *(energies_j(segment, power) for segment in mine)], axis=0)
        if name.startswith("scan"):
            kept, h_v = _swept(mine, next(seen), volume, config.spots_per_point)
        else:
            kept, h_v = np.array([0, len(mine)]), np.full(2, volume.h_v)
        duration_s = sum(segment.duration_s for segment in mine)
        found.append(Phase(name, duration_s, steps[kept, 0], steps[kept, 1], h_v))
        used = steps[-1]
        tick(len(found) / len(names))
    return Table(tuple(found), config.trip)


def plot(table: Table) -> Figure:
    """Information against energy, scans and moves in two colours."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.2, 3.8), layout="constrained", dpi=144)
    axes = figure.subplots()
    for phase in table.phases:
        kind = phase.name.split()[0]
        axes.plot(phase.energy_j, phase.h_v, color=PHASE_COLOURS[kind], linewidth=2.0)
        middle = 0.5 * (phase.energy_j[0] + phase.energy_j[-1])
        axes.annotate(
            phase.name,
            (middle, float(np.interp(middle, phase.energy_j, phase.h_v))),
            xytext=(6, -12),
            textcoords="offset points",
            fontsize=8,
            color=PHASE_COLOURS[kind],
        )
    axes.set_xlabel("energy of both robots (J)", fontsize=9)
    axes.set_ylabel("information h_v ((0.1 m)³)", fontsize=9)
    axes.set(xlim=(0, None), ylim=(0, None))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(visible=True, color="#e4e4e4", linewidth=0.7)
    axes.tick_params(labelsize=8)
    return figure


def _swept(
    segments: Sequence[Segment], spots: Spots, volume: SweptVolume, every: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """How many segments had passed, and h_v, at a scan's start and after each ``every`` spots; it ends with a spot."""
    lit = np.flatnonzero([segment.laser > 0 for segment in segments]) + 1
    require(len(spots.points) == len(lit), "spots", len(spots.points), f"{len(lit)}, one for each point of the raster")
    passed, h_v = [0], [volume.h_v]
    for first in range(0, len(spots.points), every):
        last = min(first + every, len(spots.points))
        passed.append(int(lit[last - 1]))
        h_v.append(volume.add(*spots.rays(first, last)))
    return np.array(passed), np.array(h_v)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)

"""Fig. 6.7: information against energy as two robots scan, move, scan, move and scan.

Three trips: the authors' timing and raster on a floor and one wall, every spot seen, for their scene is not known
(`scan_trip.plane_spots`); and twice in the environment (`surveyed_trip`), with its points and its joules: once with the
laser's full raster, once with 187 points over the authors' angles. Cylinders are united by cells, see `BlockMap.h_v`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.catalog import load_robot
from coop_envs.errors import require
from coop_envs.mapping.block_map import BlockMap
from coop_envs.mapping.swept_volume import DIAMETER_M
from experiments.comparison import Comparison, Tick, silent
from experiments.scan_trip import Segment, Spots, SpotSource, Trip, energies_j, phases, plane_spots, timeline
from experiments.surveyed_trip import AUTHORS_RASTER, FULL_RASTER, Stretch, SurveyedTrip, follow, stretches

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

SCAN_S = 42.55
FIRST_OF_T3 = 10800.0
SCRIPT = "authors' script"
CELL_M = 0.025
PHASE_COLOURS = {"scan": "#2f6fd6", "move": "#d6862f"}
LINES = ("-", (0, (4, 1.5)))


@dataclass(frozen=True)
class Config:
    """The authors' trip and ours by name; the robots (twice the same); steps between points of a scan's curve.

    Steps are spots in the script, decisions in the environment. ``cell_m`` is that of the cells that rays sweep.
    """

    trip: Trip = field(default_factory=Trip)
    surveyed: tuple[tuple[str, SurveyedTrip], ...] = (
        ("environment, full raster", FULL_RASTER),
        ("environment, 187 points", AUTHORS_RASTER),
    )
    robot: str = "zumy"
    steps_per_point: int = 5
    cell_m: float = CELL_M

    def __post_init__(self) -> None:
        require(self.steps_per_point >= 1, "steps_per_point", self.steps_per_point, "1 or more")


@dataclass(frozen=True, eq=False)
class Phase:
    """A scan or a move: its duration, what both robots together had used, and what they had found.

    ``uses_j`` (n, 4) of idling, motion, markers, scanner, ``h_v`` and ``bits`` (n,) run from the phase's start to its
    end. ``bits`` are what the team's map holds, none in the script. ``points`` counts spots that became points.
    """

    name: str
    duration_s: float
    uses_j: FloatArray
    h_v: FloatArray
    points: int = 0
    bits: FloatArray | None = None

    @property
    def energy_j(self) -> FloatArray:
        """Of all uses together (n,)."""
        return np.asarray(self.uses_j.sum(axis=1), dtype=np.float64)

    @property
    def used_j(self) -> FloatArray:
        """In this phase, by use (4,)."""
        return np.asarray(self.uses_j[-1] - self.uses_j[0], dtype=np.float64)

    @property
    def gained(self) -> float:
        return float(self.h_v[-1] - self.h_v[0])

    @property
    def late_gain_share(self) -> float:
        """Of the phase's information, what came in the second half of the energy from the first gain to the last."""
        grew = np.flatnonzero(np.diff(self.h_v) > 0)
        span = slice(grew[0], grew[-1] + 2)
        energy, h_v = self.energy_j[span], self.h_v[span]
        return float(h_v[-1] - np.interp(0.5 * (energy[0] + energy[-1]), energy, h_v)) / self.gained


@dataclass(frozen=True, eq=False)
class Table:
    """Each trip's phases in order, by the trip's name."""

    trips: dict[str, tuple[Phase, ...]]
    trip: Trip
    title: str = "Fig. 6.7: information h_v, in (0.1 m)^3, against energy"

    @property
    def comparisons(self) -> list[Comparison]:
        first = scans(self.trips[SCRIPT])[0]
        return [
            Comparison(f"{SCRIPT}: a scan's duration", "s", first.duration_s, SCAN_S),
            Comparison(f"{SCRIPT}: h_v as t3 begins, less a spot", "d^3", float(first.h_v[-1]), FIRST_OF_T3),
            *(row for name, found in self.trips.items() for row in _rows(name, found)),
        ]

    @property
    def notes(self) -> Sequence[str]:
        return (
            f"Script: the floor and a wall at x = {self.trip.wall_x_m:g} m, every spot seen by both cameras; a scan",
            "lasts its shortest time, for the thesis does not say how long it waited for cameras. Environment: one",
            "team before the corner, drawn out to 4 m; cameras at 30 Hz that need no second look with the laser off,",
            "a raster row by row from the top (the authors': column by column), 0.1 m/s and 0.5 rad/s as the authors',",
            "hats at half brightness on moves. Scanner's over motors': mirror and laser of a scan, drive of a move.",
            "Late share: of a scan's h_v, what came in the second half of the energy from its first gain to its last;",
            "below 0.5 returns diminish. Bits: of the team's map, against truth.",
            f"h_v by cells of {CELL_M * 100:g} cm, within 1 % of the exact union.",
        )


def scans(found: Sequence[Phase]) -> list[Phase]:
    """Those phases that are scans."""
    return [phase for phase in found if phase.name.startswith("scan")]


def _rows(name: str, found: Sequence[Phase]) -> list[Comparison]:
    looks, moves = scans(found), [phase for phase in found if not phase.name.startswith("scan")]
    rows = list[Comparison]()

    def row(quantity: str, unit: str, ours: float, thesis: str | None = None) -> None:
        rows.append(Comparison(f"{name}: {quantity}", unit, ours, thesis))

    scan_j = np.mean([phase.used_j for phase in looks], axis=0)
    row("energy of a scan, mean", "J", float(scan_j.sum()))
    row("the same without idling", "J", float(scan_j[1:].sum()))
    if moves:
        move_j = np.mean([phase.used_j for phase in moves], axis=0)
        row("energy of a move, mean", "J", float(move_j.sum()))
        row("the same without idling", "J", float(move_j[1:].sum()))
        row("a scan's energy over a move's", "", float(scan_j.sum() / move_j.sum()), "above 1")
        row("scanner's over motors' energy", "", float(scan_j[3] / move_j[1]), "above 1")
    for phase in looks:
        row(f"points, {phase.name}", "", phase.points)
    for phase in looks:
        row(f"h_v gained, {phase.name}", "d^3", phase.gained)
    for phase in looks:
        if phase.gained:
            expected = "not below 0.5" if phase is looks[0] else "below 0.5"
            row(f"late share of it, {phase.name}", "", phase.late_gain_share, expected)
    for phase in looks:
        if phase.bits is not None:
            row(f"bits gained, {phase.name}", "bit", float(phase.bits[-1] - phase.bits[0]))
    row("h_v per joule", "d^3/J", float(looks[-1].h_v[-1] / looks[-1].energy_j[-1]))
    return rows


def run(config: Config | None = None, spots: SpotSource = plane_spots, tick: Tick = silent) -> Table:
    """Follow the authors' script, then drive the trips in the environment."""
    config = config or Config()
    trips = {SCRIPT: script_phases(config, spots)}
    tick(1 / (1 + len(config.surveyed)))
    for name, trip in config.surveyed:
        trips[name] = surveyed_phases(stretches(follow(trip)), config)
        tick(len(trips) / (1 + len(config.surveyed)))
    return Table(trips, config.trip)


def script_phases(config: Config, spots: SpotSource) -> tuple[Phase, ...]:
    """Energy segment by segment, information spot by spot."""
    power = load_robot(config.robot).power
    poses, segments = timeline(config.trip, power)
    cells = BlockMap(config.cell_m, 0.5 * DIAMETER_M)
    seen = iter([spots(scan, config.trip) for scan in poses])
    used, found = np.zeros(4), list[Phase]()
    for name in phases(segments):
        mine = [segment for segment in segments if segment.phase == name]
        steps = used + np.cumsum([(0.0,) * 4, *(energies_j(segment, power) for segment in mine)], axis=0)
        if name.startswith("scan"):
            spotted = next(seen)
            kept, h_v = _swept(mine, spotted, cells, config.steps_per_point)
            points = int(np.isfinite(spotted.points).all(axis=1).sum())
        else:
            kept, h_v, points = np.array([0, len(mine)]), np.full(2, cells.h_v), 0
        duration_s = sum(segment.duration_s for segment in mine)
        found.append(Phase(name, duration_s, steps[kept], h_v, points))
        used = steps[-1]
    return tuple(found)


def _swept(
    segments: Sequence[Segment], spots: Spots, cells: BlockMap, every: int
) -> tuple[NDArray[np.intp], FloatArray]:
    """How many segments had passed, and h_v, at a scan's start and after each ``every`` spots; it ends with a spot."""
    lit = np.flatnonzero([segment.laser > 0 for segment in segments]) + 1
    require(len(spots.points) == len(lit), "spots", len(spots.points), f"{len(lit)}, one for each point of the raster")
    passed, h_v = [0], [cells.h_v]
    for first in range(0, len(spots.points), every):
        last = min(first + every, len(spots.points))
        passed.append(int(lit[last - 1]))
        cells.enter(*spots.rays(first, last))
        h_v.append(cells.h_v)
    return np.array(passed), np.array(h_v)


def surveyed_phases(trip: Sequence[Stretch], config: Config) -> tuple[Phase, ...]:
    """What robots used and found in the environment, counted from the first scan's start."""
    cells, found, start = BlockMap(config.cell_m, 0.5 * DIAMETER_M), list[Phase](), trip[0].energy_j[0]
    for stretch in trip:
        decisions = len(stretch.shots)
        kept, h_v = [0], [cells.h_v]
        for first in range(0, decisions, config.steps_per_point):
            last = min(first + config.steps_per_point, decisions)
            for shots in stretch.shots[first:last]:
                cells.enter(*shots.rays())
            kept.append(last)
            h_v.append(cells.h_v)
        points = sum(int(shots.ranged.sum()) for shots in stretch.shots)
        uses, bits = stretch.energy_j[kept] - start, stretch.bits[kept]
        found.append(Phase(stretch.name, stretch.duration_s, uses, np.array(h_v), points, bits))
    return tuple(found)


def plot(table: Table) -> Figure:
    """Information against energy: the script's h_v, the environment's h_v, the environment's bits."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 4.0), layout="constrained", dpi=144)
    script, swept, bits = figure.subplots(1, 3)
    script.set_title(f"h_v, authors' script: every spot seen, wall at {table.trip.wall_x_m:g} m", fontsize=9)
    swept.set_title("h_v, environment", fontsize=9)
    bits.set_title("bits in the team's map, environment", fontsize=9)
    style = 0
    for name, found in table.trips.items():
        if name == SCRIPT:
            _draw(script, found, [phase.h_v for phase in found], LINES[0], named=True)
            continue
        line, named = LINES[style % len(LINES)], style == 0
        _draw(swept, found, [phase.h_v for phase in found], line, named, name.split(", ")[-1])
        _draw(bits, found, [phase.bits for phase in found if phase.bits is not None], line, named, name)
        style += 1
    for axes in (script, swept, bits):
        axes.set_xlabel("energy of both robots (J)", fontsize=8)
        axes.set_ylabel("information (bit)" if axes is bits else "information h_v ((0.1 m)³)", fontsize=8)
        axes.margins(y=0.08)
        axes.set(xlim=(0, None), ylim=(0, None))
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True, color="#e4e4e4", linewidth=0.7)
        axes.tick_params(labelsize=7)
    if style:
        swept.legend(fontsize=7, loc="upper left", frameon=False)
    return figure


def _draw(
    axes: Axes, found: Sequence[Phase], values: Sequence[FloatArray], line: object, named: bool, label: str = ""
) -> None:
    """One trip's curve, scans and moves in two colours."""
    for phase, value in zip(found, values, strict=True):
        colour = PHASE_COLOURS[phase.name.split()[0]]
        first = phase is found[0]
        axes.plot(phase.energy_j, value, color=colour, linewidth=1.8, linestyle=line, label=label if first else None)  # pyright: ignore[reportArgumentType]
        if named:
            middle = 0.5 * (phase.energy_j[0] + phase.energy_j[-1])
            aside = "center" if label or phase.name.startswith("move") else "right"
            height = float(value[-1]) if aside == "center" else float(np.interp(middle, phase.energy_j, value))
            place = (middle, height)
            shift = {"xytext": (0, 6), "textcoords": "offset points", "ha": aside}
            axes.annotate(phase.name, place, fontsize=7, color=colour, **shift)  # pyright: ignore[reportArgumentType]

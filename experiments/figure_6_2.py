"""Fig. 6.2: the swept volume h_v after one spot, part way through the first scan, and as the second one begins.

Twice: with the authors' raster on a floor and one wall, for their scene is not known (`scan_trip.plane_spots`), and
with the points that two robots measure in the environment (`surveyed_trip`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from baselines.inchworm_poses import scan_sequence
from coop_envs.errors import require
from coop_envs.mapping.swept_volume import Section, SweptVolume, pentagonal_section, round_section
from experiments.comparison import Comparison, Tick, silent
from experiments.scan_trip import SpotSource, Trip, plane_spots
from experiments.shots import Shots
from experiments.surveyed_trip import AUTHORS_RASTER, SurveyedTrip, follow

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rays = tuple[NDArray[np.float64], NDArray[np.float64]]

THESIS = (21.3, 4650.0, 10800.0)
HALF_IMAGE = (320 / 457.007, 240 / 457.007)
STAGES = ("first spot of t0", "part way through t0", "first spot of t3")
SCRIPT, MEASURED = "round", "environment"


@dataclass(frozen=True)
class Config:
    """Both trips, the share of t0's spots that counts as part way, and the sides of round cylinders."""

    trip: Trip = field(default_factory=Trip)
    surveyed: SurveyedTrip = field(default_factory=lambda: replace(AUTHORS_RASTER, scans=2))
    part_way: float = 0.5
    sides: int = 8

    def __post_init__(self) -> None:
        require(0 < self.part_way < 1, "part_way", self.part_way, "above 0, below 1")


@dataclass(frozen=True)
class Stage:
    """h_v by the sweep's name, and the surfaces of the two unions that are drawn: vertices (v, 3), triangles (f, 3)."""

    name: str
    h_v: dict[str, float]
    surfaces: dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]


@dataclass(frozen=True)
class Table:
    """The three stages."""

    stages: tuple[Stage, ...]
    trip: Trip
    title: str = "Fig. 6.2: swept volume h_v, in (0.1 m)^3"

    @property
    def comparisons(self) -> list[Comparison]:
        return [
            Comparison(f"{section}: {stage.name}", "d^3", stage.h_v[section], thesis)
            for section in self.stages[0].h_v
            for stage, thesis in zip(self.stages, THESIS, strict=True)
        ]

    @property
    def notes(self) -> Sequence[str]:
        return (
            f"The authors' raster on a floor and a wall at x = {self.trip.wall_x_m:g} m: the thesis gives neither its",
            "scene nor which spot is part way, so the wall's distance was chosen for the third figure, with round",
            "cylinders and every spot seen by both cameras. 'In both images' sweeps only spots within both images of",
            "the simulation's cameras (70 x 55 deg): with one wall ahead, tried every 0.05 m from 0.5 m to 12 m, the",
            "first scan then sweeps less than 1000, so the authors' scene was another, or they counted spots beyond",
            "the images. 'Environment': points that two robots measured before the corner, drawn out to 4 m, with 187",
            "points over the authors' angles, row by row. Unions are exact, round cylinders with 8 sides.",
        )


def run(config: Config | None = None, spots: SpotSource = plane_spots, tick: Tick = silent) -> Table:
    """Sweep the first scan and the second one's first spot, each way that may have been the authors', and ours."""
    config = config or Config()
    everything = _parts(config, config.trip, spots)
    imaged = _parts(config, replace(config.trip, half_image=HALF_IMAGE), spots)
    round_one = round_section(sides=config.sides)
    sweeps = {
        SCRIPT: (round_one, everything),
        "pentagonal": (pentagonal_section(), everything),
        "round, in both images": (round_one, imaged),
        MEASURED: (round_one, _measured_parts(config)),
    }
    grown: dict[str, list[SweptVolume]] = {}
    for name, (section, parts) in sweeps.items():
        grown[name] = [_united(section, parts[: k + 1]) for k in range(len(parts))]
        tick(len(grown) / len(sweeps))
    stages = (
        Stage(
            name,
            {section: volumes[k].h_v for section, volumes in grown.items()},
            {drawn: grown[drawn][k].mesh() for drawn in (SCRIPT, MEASURED)},
        )
        for k, name in enumerate(STAGES)
    )
    return Table(tuple(stages), config.trip)


def _parts(config: Config, trip: Trip, spots: SpotSource) -> list[Rays]:
    """The rays that each stage adds."""
    first, second = (spots(scan, trip) for scan in scan_sequence(2))
    half = round(config.part_way * len(first.points))
    return [first.rays(0, 1), first.rays(1, half), _joined(first.rays(half), second.rays(0, 1))]


def _measured_parts(config: Config) -> list[Rays]:
    """The same of what robots measured in the environment; spots that gave no point do not count."""
    log = follow(config.surveyed).log
    first, second = (
        Shots.joined([decision.shots for decision in log if decision.phase == f"scan {label}"]).rays()
        for label in ("t0", "t3")
    )
    spots = len(first[0]) // 2
    require(min(spots, len(second[0])) >= 2, "surveyed", spots, "a trip on which both scans measure points")
    half = 2 * round(config.part_way * spots)
    cuts = [slice(0, 2), slice(2, half), slice(half, None)]
    parts: list[Rays] = [(first[0][cut], first[1][cut]) for cut in cuts]
    return [*parts[:2], _joined(parts[2], (second[0][:2], second[1][:2]))]


def _joined(a: Rays, b: Rays) -> Rays:
    return np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1]])


def _united(section: Section, parts: Sequence[Rays]) -> SweptVolume:
    volume = SweptVolume(section)
    volume.add(*(np.concatenate(side) for side in zip(*parts, strict=True)))
    return volume


def plot(table: Table) -> Figure:
    """The unions of round cylinders at each stage: above the authors' raster, below what was measured."""
    from matplotlib.figure import Figure

    columns = len(table.stages)
    figure = Figure(figsize=(3.9 * columns, 6.0), layout="constrained", dpi=144)
    for row, (kind, name) in enumerate([(SCRIPT, "authors' raster, ideal"), (MEASURED, "environment")]):
        ends = np.concatenate([stage.surfaces[kind][0] for stage in table.stages])
        for k, (stage, thesis) in enumerate(zip(table.stages, THESIS, strict=True)):
            axes = figure.add_subplot(2, columns, row * columns + k + 1, projection="3d")
            _draw(axes, stage.surfaces[kind], ends.min(axis=0), ends.max(axis=0))
            h_v = f"{stage.h_v[kind]:.1f}" if stage.h_v[kind] < 1000 else f"{stage.h_v[kind]:.0f}"
            axes.set_title(f"{name}\n{stage.name}: {h_v} (thesis {thesis:g})", fontsize=9)
    return figure


def _draw(
    axes: Any,
    surface: tuple[NDArray[np.float64], NDArray[np.int64]],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> None:
    """A surface in the box from ``low`` to ``high``, all axes to one scale."""
    from matplotlib.colors import LightSource
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    vertices, triangles = surface
    axes.add_collection3d(
        Poly3DCollection(vertices[triangles], shade=True, facecolors="#58b368", lightsource=LightSource(315, 45))
    )
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
    axes.locator_params(nbins=5)
    axes.set_zticks([0.0, 2.0] if high[2] > 1.0 else [0.0])
    axes.set_xlabel("x (m)", fontsize=7)
    axes.set_ylabel("y (m)", fontsize=7)
    axes.set_zlabel("z (m)", fontsize=7, labelpad=-2)
    axes.view_init(elev=28, azim=-118)
    axes.tick_params(labelsize=6)

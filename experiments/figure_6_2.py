"""Fig. 6.2: the swept volume h_v after one spot, part way through the first scan, and as the second one begins.

The authors' scene is not known: a floor and one wall stand in for it, see `scan_trip.plane_spots`.
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

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rays = tuple[NDArray[np.float64], NDArray[np.float64]]

THESIS = (21.3, 4650.0, 10800.0)
HALF_IMAGE = (320 / 457.007, 240 / 457.007)
STAGES = ("first spot of t0", "part way through t0", "first spot of t3")


@dataclass(frozen=True)
class Config:
    """The trip, the share of t0's spots that counts as part way, and the sides of round cylinders."""

    trip: Trip = field(default_factory=Trip)
    part_way: float = 0.5
    sides: int = 8

    def __post_init__(self) -> None:
        require(0 < self.part_way < 1, "part_way", self.part_way, "above 0, below 1")


@dataclass(frozen=True)
class Stage:
    """h_v by section's name, and the surface of the round cylinders' union."""

    name: str
    h_v: dict[str, float]
    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]


@dataclass(frozen=True)
class Table:
    """The three stages."""

    stages: tuple[Stage, ...]
    trip: Trip
    title: str = "Fig. 6.2: swept volume h_v, in (0.1 m)^3"

    @property
    def comparisons(self) -> list[Comparison]:
        return [
            Comparison(f"{stage.name}, {section}", "d^3", stage.h_v[section], thesis)
            for section in self.stages[0].h_v
            for stage, thesis in zip(self.stages, THESIS, strict=True)
        ]

    @property
    def notes(self) -> Sequence[str]:
        return (
            f"Scene: the floor and a wall at x = {self.trip.wall_x_m:g} m.",
            "The thesis gives neither its scene nor which spot is part way: the wall's distance was chosen for the",
            "third figure, with round cylinders and every spot seen by both cameras.",
            "The last rows sweep only spots within both images of the simulation's cameras (70 x 55 deg); there, no",
            "distance of the wall gives the first scan 1000, which suggests that the authors counted spots beyond.",
        )


def run(config: Config | None = None, spots: SpotSource = plane_spots, tick: Tick = silent) -> Table:
    """Sweep the first scan and the second one's first spot, each way that may have been the authors'."""
    config = config or Config()
    everything = _parts(config, config.trip, spots)
    imaged = _parts(config, replace(config.trip, half_image=HALF_IMAGE), spots)
    round_one = round_section(sides=config.sides)
    sweeps = {
        "round": (round_one, everything),
        "pentagonal": (pentagonal_section(), everything),
        "round, in both images": (round_one, imaged),
    }
    grown: dict[str, list[SweptVolume]] = {}
    for name, (section, parts) in sweeps.items():
        grown[name] = [_united(section, parts[: k + 1]) for k in range(len(parts))]
        tick(len(grown) / len(sweeps))
    stages = (
        Stage(name, {section: volumes[k].h_v for section, volumes in grown.items()}, *grown["round"][k].mesh())
        for k, name in enumerate(STAGES)
    )
    return Table(tuple(stages), config.trip)


def _parts(config: Config, trip: Trip, spots: SpotSource) -> list[Rays]:
    """The rays that each stage adds."""
    first, second = (spots(scan, trip) for scan in scan_sequence(2))
    half = round(config.part_way * len(first.points))
    return [first.rays(0, 1), first.rays(1, half), _joined(first.rays(half), second.rays(0, 1))]


def _joined(a: Rays, b: Rays) -> Rays:
    return np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1]])


def plot(table: Table) -> Figure:
    """The union of round cylinders at each stage."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.6 * len(table.stages), 3.4), layout="constrained", dpi=144)
    for k, (stage, thesis) in enumerate(zip(table.stages, THESIS, strict=True)):
        axes = figure.add_subplot(1, len(table.stages), k + 1, projection="3d")
        _draw(axes, stage, table.trip)
        axes.set_title(f"{stage.name}\nh_v = {stage.h_v['round']:.5g} (thesis {thesis:g})", fontsize=9)
    return figure


def _united(section: Section, parts: Sequence[Rays]) -> SweptVolume:
    volume = SweptVolume(section)
    volume.add(*(np.concatenate(side) for side in zip(*parts, strict=True)))
    return volume


def _draw(axes: Any, stage: Stage, trip: Trip) -> None:
    from matplotlib.colors import LightSource
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    surface = Poly3DCollection(
        stage.vertices[stage.triangles], shade=True, facecolors="#58b368", lightsource=LightSource(315, 45)
    )
    axes.add_collection3d(surface)
    far = trip.wall_x_m
    axes.set(xlim=(0, far), ylim=(-0.2 * far, 0.6 * far), zlim=(0, 0.5 * far), xlabel="x (m)", ylabel="y (m)")
    axes.set_box_aspect((1, 0.8, 0.5))
    axes.view_init(elev=28, azim=-118)
    axes.tick_params(labelsize=6)

"""Ground that scans have shown to be free: where a robot may go, and where the known ends."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from baselines.atlas import Point, Survey
from coop_envs.agents.team import Member
from coop_envs.mapping.planning import (
    BLOCKED,
    HAZARD,
    PROVEN,
    BeliefGrid,
    Clearance,
    Disc,
    Footprint,
    Mask,
    SafeRoutes,
    at_nodes,
    minimum_cost_search,
    node_clearance,
)

SCANNED = 40  # P(obstacle) in 255ths up to which a cell counts as seen free; window cells are means of several
FRONTIER_M = 0.3  # shorter frontiers are gaps that scans left
OPEN_M = 0.15  # with this much clearance a robot pays nothing for being near an edge
SHYNESS = 1.5
TOLLS = (1.0, 6.0)  # what a metre over ground that no robot has proven costs pickets and observers on top, and ...
FAILURES = 2  # failures to get to a cell after which no robot is sent there any more
SUSPECT_M = (0.45, 0.6)  # ... how far they keep off where a robot was lost, unless somebody has been there


def seen_free(grid: BeliefGrid) -> Mask:
    """Cells (nx, ny) that scans or bodies have shown to be free, on ground that is no known hazard."""
    return (grid.obstacle <= SCANNED) & (grid.ground > HAZARD)


def unknown(grid: BeliefGrid) -> Mask:
    """Cells (nx, ny) that may be free or not."""
    return (grid.obstacle > SCANNED) & (grid.obstacle < BLOCKED) & (grid.ground > HAZARD)


def frontier(survey: Survey, trusted: tuple[Disc, ...]) -> Mask:
    """Unknown cells (nx, ny) with a free or trusted one beside them, in rows no shorter than `FRONTIER_M`.

    Source: Yamauchi, "A frontier-based approach for autonomous exploration", 1997.
    """
    from scipy.ndimage import binary_dilation
    from skimage.measure import label

    free = as_proven(survey, trusted, ()).ground >= PROVEN
    edge = unknown(survey.grid) & ~free & np.asarray(binary_dilation(free), dtype=bool)
    rows = np.asarray(label(edge, connectivity=2))
    long = np.bincount(rows.ravel()) * survey.grid.cell_m >= FRONTIER_M - 1e-9
    return edge & long[rows]


def footprint_of(member: Member, cell_m: float) -> Footprint:
    """What has to be seen free: every cell that the robot's body reaches into."""
    radius_m = member.robot.body_radius_m
    return Footprint(radius_m, radius_m, margin_m=0.5 * cell_m)


def as_proven(survey: Survey, trusted: tuple[Disc, ...], suspect: tuple[Disc, ...]) -> BeliefGrid:
    """The grid with cells that were seen free taken for proven ones, all others for unproven ones.

    Unknown cells in the ``trusted`` discs count as free: people saw that ground when they set the robots down, and
    cameras do not see what is right before them. In the ``suspect`` ones only what robots have proven does, for no
    camera sees a trap. Where robots have failed to get to counts for nothing.
    """
    grid = survey.grid
    free, open_ = seen_free(grid), unknown(grid)
    for disc in trusted:
        free |= open_ & grid.within(disc)
    for disc in suspect:
        free &= ~grid.within(disc) | (grid.ground >= PROVEN)
    free &= survey.doubt < FAILURES
    return replace(grid, ground=np.where(free, np.uint8(255), np.uint8(0)))


@dataclass(frozen=True)
class Going:
    """What a robot needs to know of ground to go there: its footprint, discs trusted and suspect, and its toll."""

    footprint: Footprint
    trusted: tuple[Disc, ...]
    suspect: tuple[Disc, ...]
    toll: float

    def clearance(self, survey: Survey) -> Clearance:
        """How far the robot is from ground that is not known to be free."""
        return Clearance(as_proven(survey, self.trusted, self.suspect), self.footprint)


def going(member: Member, cell_m: float, trusted: tuple[Disc, ...], losses: tuple[Point, ...]) -> Going:
    """How a robot goes: observers are more careful."""
    careful = member.role == "observer"
    suspect = tuple((x, y, SUSPECT_M[careful]) for x, y in losses)
    return Going(footprint_of(member, cell_m), trusted, suspect, TOLLS[careful])


class ScannedRoutes(SafeRoutes):
    """Routes over ground that was seen free, clear of ``others``, rather where robots have been."""

    def __init__(self, survey: Survey, start_m: ArrayLike, go: Going, others: tuple[Disc, ...]) -> None:
        self.grid = as_proven(survey, go.trusted, go.suspect)
        self.start_m = np.asarray(start_m, dtype=np.float64)
        self.clearance = Clearance(self.grid, go.footprint, others)
        self.spare_m = node_clearance(self.grid, go.footprint, others)
        self.cost_m = np.full(self.spare_m.shape, np.inf)
        entries = self._entries()
        if entries:
            price = 1.0 + SHYNESS * (1.0 - np.clip(self.spare_m / OPEN_M, 0.0, 1.0))
            price += go.toll * ~near_proven(survey.grid)
            self._search = minimum_cost_search(np.where(self.spare_m > 0.0, price, -1.0))
            self.cost_m = self._search.find_costs(entries)[0] * (0.5 * self.grid.cell_m)


def near_proven(grid: BeliefGrid) -> Mask:
    """Nodes (2 nx + 1, 2 ny + 1) at or next to the middle of ground that robots have proven."""
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(at_nodes(grid.ground >= PROVEN), np.ones((3, 3), dtype=bool)), dtype=bool)

"""Which robot of a scanning team should go where, and how two cameras should look, to map the most in the least time.

A candidate is a robot, a place it can reach over ground seen free, its heading there, and a mate that stays where it is
but may turn. Worth is the unmeasured ground that both cameras would see, from directions that differ, per second of
driving, turning and scanning. One of the two has to see the other: its hat ties their poses together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.atlas import Survey
from baselines.common_view import GOOD_PARALLAX, GROUND_RANGE_M, LEAST_PARALLAX, Sector, hidden, parallax, views
from baselines.rasters import Tries, Watcher
from baselines.scanned import ScannedRoutes, unknown
from coop_envs.mapping.planning import BeliefGrid, Mask, Node, Points

HEADINGS = np.linspace(-math.pi, math.pi, 16, endpoint=False)
SAMPLE_M, STAND_M, STANDS = 0.2, 0.2, 64
HAT_M = (0.25, 2.5)  # distances from which a hat gives a good pose
HAT_RAD = 0.1  # how far inside its view a camera needs a hat's middle
SPEED_M_S, TURN_RAD_S = 0.12, 0.7
STOP_S, SCAN_S_M2 = 12.0, 14.0  # what every stop takes, and what scanning a square metre takes
SPARSE_M = 1.0  # from here on rays of a raster lie so sparse that none is wasted
LEAST_M2 = 0.06
AGAIN, OBSERVER = 0.8, 0.6  # worth of moving the same robot again, and of moving an observer


@dataclass(frozen=True)
class Move:
    """A robot's way (k, 2; None where it only turns), its heading at the end, and a mate's; ``worth`` in m^2/s.

    ``aim`` (n, 2) is the ground that this is about.
    """

    mover: str
    path: Points | None
    heading: float
    partner: str
    partner_heading: float
    worth: float
    aim: Points


@dataclass(frozen=True)
class Ground:
    """Samples (k, 2) of ground that is not measured yet, and what each is worth (k,) in m^2."""

    points: Points
    worth: NDArray[np.float64]


@dataclass(frozen=True)
class Options:
    """Where a robot might stand: places (s, 2), their nodes in the routes (None: where it is), seconds to get there."""

    stands: Points
    nodes: tuple[Node | None, ...]
    time_s: NDArray[np.float64]


def unmeasured(survey: Survey, watchers: list[Watcher], tries: Tries) -> Ground:
    """What may be worth measuring, within sight of where some robot stands now: one of a pair stays."""
    grid = survey.grid
    every = max(1, round(SAMPLE_M / grid.cell_m))
    points = grid.centre_of(np.argwhere(unknown(grid)[::every, ::every]) * every)
    stands = np.array([watcher.robot.xy for watcher in watchers])
    near = np.hypot(*np.moveaxis(points[:, None] - stands, -1, 0)).min(axis=1, initial=np.inf) < GROUND_RANGE_M
    points = points[near]
    worth = tries.worth(points) * (every * grid.cell_m) ** 2
    hopeful = worth > 0.1 * (every * grid.cell_m) ** 2
    return Ground(points[hopeful], worth[hopeful])


def options_of(routes: ScannedRoutes, robot: Watcher, seeds: Points) -> Options:
    """Where the robot is, the roomiest reachable node of each square, and those nearest to the seeds (n, 2)."""
    places = np.argwhere(np.isfinite(routes.cost_m))
    nodes: list[Node | None] = [None]
    if len(places):
        positions = routes.positions(places)
        side_m = max(STAND_M, math.sqrt(len(places) * (0.5 * routes.grid.cell_m) ** 2 / STANDS))
        squares = np.floor(positions / side_m).astype(int)
        order = np.argsort(-routes.spare_m[tuple(places.T)], kind="stable")
        _, first = np.unique(squares[order], axis=0, return_index=True)
        chosen = order[first].tolist()
        for seed in seeds.tolist():
            nearest = int(np.argmin(np.hypot(*(positions - seed).T)))
            if math.dist(positions[nearest], seed) < 0.5 * STAND_M:
                chosen.append(nearest)
        places = places[chosen]
        nodes += [(int(a), int(b)) for a, b in places]
    stands = np.vstack([[robot.robot.xy], routes.positions(places)])
    cost_m = np.array([0.0, *routes.cost_m[tuple(places.T)]])
    return Options(stands, tuple(nodes), cost_m / SPEED_M_S)


@dataclass(frozen=True)
class Choice:
    """The number of a stand, both headings, the rate (m^2/s) that they promise, and the ground (n, 2) of which."""

    stand: int
    heading: float
    partner_heading: float
    rate: float
    aim: Points


@dataclass(frozen=True)
class Outlook:
    """What a mover would see of the unmeasured ground: weights (s, h, k) by stand, heading (h,) and sample."""

    headings: NDArray[np.float64]
    weights: NDArray[np.float32]


def outlook_of(mover: Watcher, options: Options, ground: Ground, grid: BeliefGrid) -> Outlook:
    """The outlook of a robot at all its stands."""
    headings = np.concatenate([HEADINGS, [mover.robot.yaw]])
    seen = views(mover.sector.up_to(GROUND_RANGE_M), options.stands, headings, ground.points)
    clear = ~hidden(grid, options.stands, ground.points) * sparing(options.stands, ground.points)
    return Outlook(headings, seen * clear[:, None].astype(np.float32))


def best_pair(
    mover: Watcher, options: Options, outlook: Outlook, partner: Watcher, ground: Ground, grid: BeliefGrid
) -> Choice | None:
    """The best stand and headings with this partner, if any are worth it."""
    place = np.array([partner.robot.xy])
    near = np.hypot(*(ground.points - place[0]).T) < GROUND_RANGE_M
    points = ground.points[near]
    if not len(points):
        return None
    own, others = outlook.headings, np.concatenate([HEADINGS, [partner.robot.yaw]])
    seen = (
        outlook.weights[:, :, near] * certainty(parallax(options.stands, place[0], points)).astype(np.float32)[:, None]
    )
    worth = ground.worth[near] * sparing(place, points) * ~hidden(grid, place, points)
    seen_too = views(partner.sector.up_to(GROUND_RANGE_M), place, others, points)[0] * worth
    gain = (seen @ seen_too.T.astype(np.float32)).astype(np.float64)
    gain *= linked(mover.sector, partner.sector, options.stands, place, own, others, grid)
    turns = np.abs(_wrapped(own - mover.robot.yaw))[:, None] + np.abs(_wrapped(others - partner.robot.yaw))
    time_s = STOP_S + options.time_s[:, None, None] + turns[None] / TURN_RAD_S + SCAN_S_M2 * gain
    rate = np.where(gain > LEAST_M2, gain / time_s, 0.0)
    s, h, p = np.unravel_index(int(np.argmax(rate)), rate.shape)
    if rate[s, h, p] <= 0.0:
        return None
    aim = points[(seen[s, h] > 0.0) & (seen_too[p] > 0.0)]
    return Choice(int(s), float(own[h]), float(others[p]), float(rate[s, h, p]), aim)


def sparing(stands: Points, points: Points) -> NDArray[np.float64]:
    """What share (s, k) of a full worth points (k, 2) have for being near stands (s, 2): rays lie dense there."""
    offset = points[None] - stands[:, None]
    return np.minimum(np.hypot(offset[..., 0], offset[..., 1]) / SPARSE_M, 1.0)


def certainty(sine: NDArray[np.float64]) -> NDArray[np.float64]:
    """What share of a full worth points have whose lines of sight cross at an angle of this sine."""
    return np.where(sine > LEAST_PARALLAX, np.minimum(sine / GOOD_PARALLAX, 1.0) ** 2, 0.0)


def linked(
    sector: Sector, other: Sector, stands: Points, place: Points, own: NDArray[np.float64],
    others: NDArray[np.float64], grid: BeliefGrid,
) -> Mask:  # fmt: skip
    """Whether (s, h, p) a robot at a stand with a heading sees the hat at ``place`` (1, 2), or is seen from there."""
    distance = np.hypot(*(stands - place[0]).T)
    near = (distance > HAT_M[0]) & (distance < HAT_M[1]) & ~hidden(grid, stands, place)[:, 0]
    hat_view, other_hat_view = (Sector(s.half_rad - HAT_RAD, 0.0, HAT_M[1]) for s in (sector, other))
    sees = views(hat_view, stands, own, place)[:, :, 0]
    is_seen = views(other_hat_view, place, others, stands)[0].T
    return near[:, None, None] & (sees[:, :, None] | is_seen[:, None, :])


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi

"""Going about on scanned ground: routes, frontiers, and where nobody goes."""

from __future__ import annotations

import itertools
import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.atlas import Survey
from baselines.common_view import sector_of
from baselines.frontier import NearestFrontier
from baselines.inchworm_scan import NextBestPair
from baselines.rasters import Tries, Watcher
from baselines.scanned import FAILURES, ScannedRoutes, as_proven, frontier, going
from baselines.ways import Ways
from coop_envs.agents.catalog import load_team
from coop_envs.mapping.planning import BeliefGrid
from tests.baselines.test_common_view import robot

MEMBERS = load_team("surveyors").members
FREE, UNKNOWN, WALL = 12, 128, 243


def survey(obstacle: np.ndarray, losses: tuple[tuple[float, float], ...] = ()) -> Survey:
    ground = np.full_like(obstacle, UNKNOWN)
    grid = BeliefGrid(ground, obstacle, (0.0, 0.0), 0.05)
    return Survey(grid, np.zeros_like(obstacle), np.ones_like(obstacle), losses)


def open_room() -> np.ndarray:
    """3 x 3 m, of which the middle 1.5 x 1.5 m are seen to be free."""
    obstacle = np.full((60, 60), UNKNOWN, np.uint8)
    obstacle[15:45, 15:45] = FREE
    return obstacle


def team() -> list[Watcher]:
    places = ((1.3, 1.5, 0.0), (1.7, 1.3, 1.5), (1.7, 1.7, -1.5))
    return [
        Watcher(robot(*place, member.name), member, sector_of(member))
        for place, member in zip(places, MEMBERS, strict=True)
    ]


@given(st.integers(0, 2**32))
@settings(max_examples=15, deadline=None)
def test_a_body_on_its_way_touches_nothing_but_free_cells(seed: int) -> None:
    obstacle = open_room()
    spots = np.random.default_rng(seed).integers(15, 45, (12, 2))
    obstacle[spots[:, 0], spots[:, 1]] = WALL
    obstacle[spots[:6, 0], spots[:6, 1]] = UNKNOWN
    obstacle[26:34, 22:30] = FREE
    known = survey(obstacle)
    routes = ScannedRoutes(known, (1.5, 1.3), going(MEMBERS[1], 0.05, (), ()), ())
    nodes = np.argwhere(np.isfinite(routes.cost_m))
    a, b = nodes[int(np.argmax(routes.cost_m[tuple(nodes.T)]))].tolist()
    path = routes.path_to((a, b))
    assert path is not None
    bad = known.grid.centres(obstacle != FREE)
    for start, end in itertools.pairwise(path):
        for point in np.linspace(start, end, 20):
            corner = np.maximum(np.abs(bad - point) - 0.025, 0.0)
            assert np.hypot(*corner.T).min() > MEMBERS[1].robot.body_radius_m - 0.01


def test_where_robots_were_lost_or_failed_nobody_goes() -> None:
    known = survey(open_room(), losses=((1.5, 1.5),))
    known.doubt[40, 40] = FAILURES
    free = as_proven(known, (), going(MEMBERS[0], 0.05, (), known.losses).suspect).ground > 0
    assert not free[30, 30] and not free[40, 40]
    assert free[16, 16]


def test_set_down_ground_is_trusted_unless_something_stands_there() -> None:
    obstacle = np.full((60, 60), UNKNOWN, np.uint8)
    obstacle[32, 30] = WALL
    free = as_proven(survey(obstacle), ((1.5, 1.5, 0.22),), ()).ground > 0
    assert free[30, 30] and not free[32, 30] and not free[10, 10]


def test_the_frontier_lies_between_free_and_unknown_ground() -> None:
    mask = frontier(survey(open_room()), ((0.5, 0.5, 0.12),))
    assert mask[:12, :14].any() and mask[14:].sum() == 4 * 30
    assert mask[14, 20] and not mask[15, 20] and not mask[13, 20]


def test_the_nearest_frontier_is_that_of_the_one_who_goes() -> None:
    known, watchers = survey(open_room()), team()
    move = NearestFrontier().choose(Ways(watchers, known, ()), Tries(), "observer_0")
    assert move is not None and move.mover == "picket_0"
    assert math.dist(move.aim[0], (1.7, 1.3)) < 0.75
    stand = np.array(watchers[1].robot.xy) if move.path is None else move.path[-1]
    assert abs(math.atan2(*(move.aim[0] - stand)[::-1]) - move.heading) < 1e-6


def test_the_best_pair_sees_unknown_ground_in_common() -> None:
    known, watchers = survey(open_room()), team()
    move = NextBestPair().choose(Ways(watchers, known, ()), Tries(), None)
    assert move is not None and move.worth > 0.0 and len(move.aim) >= 3
    cells = known.grid.cell_of(move.aim)
    assert np.all(known.grid.obstacle[tuple(cells.T)] == UNKNOWN)


def test_nothing_is_left_to_do_where_all_is_known() -> None:
    known = survey(np.full((60, 60), FREE, np.uint8))
    for strategy in (NextBestPair(), NearestFrontier()):
        assert strategy.choose(Ways(team(), known, ()), Tries(), None) is None

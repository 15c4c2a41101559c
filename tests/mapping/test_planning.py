"""Safe paths against another library's graph search, and against what must never be crossed."""

from __future__ import annotations

import itertools

import networkx as nx
import numpy as np
import pytest

from coop_envs.mapping.planning import BeliefGrid, Clearance, Footprint, safe_path

CELL, CONTACT, BODY = 0.05, 0.05, 0.07
FOOTPRINT = Footprint(CONTACT, BODY, margin_m=0.02)
START, GOAL = (0.3, 0.3), (1.7, 1.7)


def random_grid(seed: int, share: float) -> BeliefGrid:
    """2 x 2 m of proven ground with unknown, hazardous and blocked cells strewn over it, start and goal left free."""
    rng = np.random.default_rng(seed)
    ground = np.full((40, 40), 250, dtype=np.uint8)
    obstacle = np.full((40, 40), 8, dtype=np.uint8)
    for layer, value in ((ground, 128), (ground, 5), (obstacle, 250)):
        layer[rng.random(layer.shape) < share] = value
    for x, y in (START, GOAL):
        i, j = int(x / CELL), int(y / CELL)
        ground[i - 4 : i + 5, j - 4 : j + 5], obstacle[i - 4 : i + 5, j - 4 : j + 5] = 250, 8
    return BeliefGrid(ground, obstacle, (0.0, 0.0), CELL)


def free_nodes(grid: BeliefGrid) -> nx.Graph:
    """Half-cell nodes at which the contact disc and margin hold no unproven cell centre and the body no obstacle."""
    n, m = grid.ground.shape
    centres = np.stack(np.meshgrid(*(CELL * (np.arange(k) + 0.5) for k in (n, m)), indexing="ij"), axis=-1)
    around = np.pad(np.zeros((n, m), dtype=bool), 1, constant_values=True)
    frame = CELL * (np.argwhere(around) - 0.5)
    unproven = np.vstack([centres[grid.ground < 230], frame])
    blocked = centres[grid.obstacle >= 166]
    graph = nx.Graph()
    for a in range(2 * n + 1):
        for b in range(2 * m + 1):
            p = np.array([a, b]) * CELL / 2
            if np.hypot(*(unproven - p).T).min() <= CONTACT + 0.02 + 1e-9:
                continue
            if len(blocked) and np.hypot(*(blocked - p).T).min() <= BODY + CELL / 2 + 1e-9:
                continue
            graph.add_node((a, b))
    for a, b in list(graph):
        for step in ((1, 0), (0, 1), (1, 1), (1, -1)):
            other = (a + step[0], b + step[1])
            if other in graph:
                graph.add_edge((a, b), other)
    return graph


def reachable(graph: nx.Graph) -> bool:
    """Whether networkx finds a way from the node at the start to one within 6 cm of the goal."""
    start = tuple(round(x / (CELL / 2)) for x in START)
    near = [node for node in graph if np.hypot(*(np.array(node) * CELL / 2 - GOAL)) <= 0.06]
    return start in graph and any(nx.has_path(graph, start, node) for node in near)


@pytest.mark.parametrize("seed", range(12))
def test_there_is_a_path_exactly_where_networkx_finds_one(seed: int) -> None:
    grid = random_grid(seed, share=0.004 + 0.002 * (seed % 4))
    path = safe_path(grid, START, GOAL, 0.06, FOOTPRINT)
    assert (path is not None) == reachable(free_nodes(grid))


@pytest.mark.parametrize("seed", range(8))
def test_a_path_keeps_clear_of_all_that_is_not_proven(seed: int) -> None:
    grid = random_grid(seed, share=0.004)
    path = safe_path(grid, START, GOAL, 0.06, FOOTPRINT)
    if path is None:
        assert not reachable(free_nodes(grid))
        return
    way = np.vstack([np.linspace(a, b, 50) for a, b in itertools.pairwise(path)])
    unproven, blocked = grid.centres(grid.ground < 230), grid.centres(grid.obstacle >= 166)
    assert np.min(np.linalg.norm(way[:, None] - unproven[None], axis=-1)) > CONTACT
    assert np.min(np.linalg.norm(way[:, None] - blocked[None], axis=-1)) > BODY
    assert np.allclose(path[0], START)
    assert np.hypot(*(path[-1] - GOAL)) <= 0.06


def test_a_wall_of_unknown_ground_leaves_no_path() -> None:
    grid = random_grid(0, share=0.0)
    grid.ground[20] = 128
    assert safe_path(grid, START, GOAL, 0.06, FOOTPRINT) is None
    grid.ground[20, 18:23] = 250
    assert safe_path(grid, START, GOAL, 0.06, FOOTPRINT) is not None


def test_other_robots_are_kept_clear_of() -> None:
    grid = random_grid(0, share=0.0)
    path = safe_path(grid, START, GOAL, 0.06, FOOTPRINT, ((1.0, 1.0, 0.3),))
    assert path is not None
    way = np.vstack([np.linspace(a, b, 50) for a, b in itertools.pairwise(path)])
    assert np.min(np.hypot(*(way - (1.0, 1.0)).T)) >= 0.3 - 0.005


def test_clearance_is_the_distance_left() -> None:
    grid = random_grid(0, share=0.0)
    grid.ground[30, 20] = 128
    spot = grid.centre_of((30, 20))
    spare = Clearance(grid, FOOTPRINT)(np.array([spot + (0.2, 0.0), spot + (0.05, 0.0)]))
    np.testing.assert_allclose(spare, [0.2 - 0.07, 0.05 - 0.07], atol=1e-12)

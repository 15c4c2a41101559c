from __future__ import annotations

import numpy as np
import pytest

from coop_envs.mapping import sweep
from coop_envs.mapping.block_map import BlockMap
from coop_envs.mapping.swept_volume import SweptVolume
from tests.mapping.test_volume import CELL, CORNER, FLOOR, LEVELS, NX, NY, Room


def some_rays(k: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    low, high = (*CORNER, FLOOR), (*(CORNER + np.array([NX, NY]) * CELL), FLOOR + LEVELS * CELL)
    return rng.uniform(low, high, (k, 3)), rng.uniform(low, high, (k, 3))


def by_cell(blocks: BlockMap) -> dict[tuple[int, ...], int]:
    known = blocks.known()
    return {tuple(map(int, index)): int(v) for index, v in zip(known.index, known.log_odds, strict=True)}


def test_blocks_hold_what_the_dense_map_holds():
    """The same rays, the dense map's corner taken to a grid point: equal but for cells at the edge of a ray."""
    starts, ends = some_rays(60, 1)
    room, blocks = Room(), BlockMap(CELL)
    shift = np.array([-23, -17, -5])
    origin = np.array([*CORNER, FLOOR]) - shift * CELL
    for start, end in zip(starts, ends, strict=True):
        room.ray(start, end, hit=True)
    blocks.enter(starts - origin, ends - origin)
    dense = room.volume.transpose(1, 2, 0)
    sparse = np.zeros_like(dense)
    for index, value in by_cell(blocks).items():
        i, j, k = index - shift
        if 0 <= i < NX and 0 <= j < NY and 0 <= k < LEVELS:
            sparse[i, j, k] = value
    assert np.count_nonzero(dense) > 1000
    assert np.mean(dense != sparse) < 0.002


def test_the_order_in_which_rays_come_does_not_matter_until_cells_saturate():
    starts, ends = some_rays(12, 2)
    at_once, one_by_one = BlockMap(CELL), BlockMap(CELL)
    at_once.enter(starts, ends)
    for k in reversed(range(12)):
        one_by_one.enter(starts[k], ends[k])
    assert by_cell(at_once) == by_cell(one_by_one)


def test_it_grows_to_all_sides_and_stays_sparse():
    blocks = BlockMap(CELL)
    for way in np.vstack([np.eye(3), -np.eye(3)]) * 30.0:
        blocks.enter(way, way * 1.05)
    assert len({tuple(np.sign(index)) for index in blocks.known().index}) >= 6
    assert blocks.blocks < 6 * 40
    known = blocks.known()
    assert np.abs(known.middles_m).max() > 30.0 and known.cell_m == CELL


def test_nothing_is_known_of_an_empty_map():
    blocks = BlockMap(CELL)
    blocks.enter(np.zeros((0, 3)), np.zeros((0, 3)))
    assert len(blocks.known().index) == 0 and blocks.blocks == 0


@pytest.mark.parametrize("ends", [[[np.nan, 0, 0]], [[0, 0, 0], [1, 1, 1]]])
def test_broken_rays_are_refused(ends):
    with pytest.raises(ValueError, match="rays: got shapes"):
        BlockMap().enter([[1.0, 1.0, 1.0]], ends)


def test_h_v_is_the_union_of_the_cylinders():
    """Against the exact union of meshes; cells of 5 cm are coarse, but err either way."""
    rng = np.random.default_rng(5)
    eye, angle = np.array([0.013, 0.021, 0.15]), rng.uniform(-0.6, 0.6, 60)
    ends = eye + np.stack([2 * np.cos(angle), 2 * np.sin(angle), rng.uniform(-0.2, 0.3, 60)], axis=-1)
    exact = SweptVolume()
    exact.add(np.broadcast_to(eye, ends.shape), ends)
    for cell_m, tolerance in ((0.05, 0.06), (0.025, 0.03)):
        blocks = BlockMap(cell_m)
        blocks.enter(np.broadcast_to(eye, ends.shape), ends)
        assert blocks.h_v == pytest.approx(exact.h_v, rel=tolerance)


def test_two_cameras_that_measured_one_point_mark_it_once():
    blocks = BlockMap(CELL)
    point = [1.02, 1.02, 0.02]
    blocks.enter([[0.0, 0.0, 0.1], [0.0, 1.0, 0.1]], [point, point])
    assert by_cell(blocks)[20, 20, 0] == int(sweep.HIT)

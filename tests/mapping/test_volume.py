"""Scan rays in the volume, against cells found by brute force in double precision."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from coop_envs.mapping import sweep
from coop_envs.mapping.ground_map import GroundMap, MapModel, allocate_map, begin_map
from coop_envs.mapping.volume import judge_changes, mark_point, sweep_ray
from tests.mapping.chart import changes_of

NX, NY, LEVELS, CELL, FLOOR, SWEEP = 40, 36, 6, 0.05, -0.075, 0.05
CORNER = np.array([-0.5, -0.9])
THROUGH, BESIDE, HIT, UNDER = (float(getattr(sweep, name)) for name in ("THROUGH", "BESIDE", "HIT", "UNDER"))


@wp.kernel
def enter(ground: GroundMap, model: MapModel, start: wp.vec3, end: wp.vec3, hit: int):
    ground.change_count[0] = 0
    sweep_ray(ground, model, 0, start, end)
    if hit == 1:
        mark_point(ground, model, 0, end)
    judge_changes(ground, model, 0)


class Room:
    """A map of 2 x 1.8 m with six levels; level 0 holds the floor at -0.05 m."""

    def __init__(self, step: int = 0) -> None:
        m = self.model = MapModel()
        m.stride = 1
        m.nx, m.ny, m.cell, m.mark_radius = NX, NY, CELL, 0.1
        m.levels, m.floor, m.clearance, m.step, m.sweep = LEVELS, FLOOR, 3, step, SWEEP
        self.map: GroundMap = allocate_map(1, 1, m, 0.2, "cpu", swept_cells=5000)
        corner, cells = wp.array([CORNER], dtype=wp.vec2), wp.array([(NX, NY)], dtype=wp.vec2i)
        start, chosen = wp.array([[(90.0, 90.0, 0.0)]], dtype=wp.vec3), wp.ones(1, dtype=int)
        wp.launch(begin_map, 1, inputs=[self.map, m, corner, cells, start, 0.0, chosen], device="cpu")

    def ray(self, start, end, hit=False, times=1) -> None:
        for _ in range(times):
            inputs = [self.map, self.model, wp.vec3(*start), wp.vec3(*end), int(hit)]
            wp.launch(enter, 1, inputs=inputs, device="cpu")

    @property
    def volume(self) -> np.ndarray:
        return self.map.volume.numpy()[0].reshape(NX, NY, LEVELS).transpose(2, 0, 1).astype(int)

    @property
    def obstacle(self) -> np.ndarray:
        return self.map.log_odds.numpy()[0, 1].reshape(NX, NY).astype(int)

    def changes(self) -> np.ndarray:
        return changes_of(self.map)


def middles() -> np.ndarray:
    """Middle of every cell (levels, nx, ny, 3)."""
    k, i, j = np.meshgrid(*map(np.arange, (LEVELS, NX, NY)), indexing="ij")
    return np.stack([CORNER[0] + (i + 0.5) * CELL, CORNER[1] + (j + 0.5) * CELL, FLOOR + (k + 0.5) * CELL], axis=-1)


def expected(start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evidence by brute force, and the cells so near to a limit that single precision may decide either way."""
    d = end - start
    length = np.linalg.norm(d)
    a = d / length
    e = middles() - start
    along = e @ a
    off = e - along[..., None] * a
    away = np.linalg.norm(off, axis=-1)
    m = int(np.argmax(np.abs(a)))
    t = e[..., m] / a[m]  # slices are cut square to the main axis, not to the ray
    within = (t > 0) & (t < length) & (along < length - CELL / 2) & (off[..., 2] >= UNDER * CELL)
    evidence = np.where(away <= CELL / 2, THROUGH, np.where(away <= SWEEP, BESIDE, 0.0)) * within
    margins = [away - CELL / 2, away - SWEEP, t, t - length, along - length + CELL / 2, off[..., 2] - UNDER * CELL]
    return evidence.astype(int), np.min(np.abs(margins), axis=0) < 1e-5


@pytest.fixture
def room():
    return Room()


@pytest.mark.parametrize("seed", range(30))
def test_a_ray_frees_the_cells_of_its_cylinder(room, seed):
    rng = np.random.default_rng(seed)
    low, high = CORNER - 0.2, CORNER + np.array([NX, NY]) * CELL + 0.2
    start, end = (np.array([*rng.uniform(low, high), rng.uniform(-0.1, 0.3)]) for _ in range(2))
    room.ray(start, end)
    evidence, unsure = expected(start, end)
    np.testing.assert_array_equal(room.volume[~unsure], evidence[~unsure])


def test_the_cell_of_the_point_is_occupied_and_the_one_before_it_free(room):
    room.ray((-0.2, 0.026, -0.01), (0.526, 0.026, -0.01), hit=True)
    i, j = column(0.526, 0.026)
    assert room.volume[1, i, j] == HIT and room.volume[1, i - 1, j] == THROUGH


def test_the_floor_that_rays_graze_is_not_called_free(room):
    """A ray from 15 cm above the floor that lands 1.2 m away passes its last cells lower than half a cell."""
    for y in np.arange(-0.6, 0.6, 0.02):
        room.ray((-0.3, 0.0, 0.10), (0.9, y, -0.05), hit=True)
    assert room.volume[0].min() >= 0 and (room.volume[0] > 0).sum() > 10
    assert (room.volume[1:] < 0).sum() > 250


def test_changes_tell_what_became_of_every_cell(room):
    before = room.volume
    room.ray((-0.3, 0.0, 0.1), (0.9, 0.3, 0.0), hit=True)
    rebuilt = before.copy()
    for layer, cell, old, new in room.changes():
        if layer >= 2:
            assert rebuilt[layer - 2, cell // NY, cell % NY] == old
            rebuilt[layer - 2, cell // NY, cell % NY] = new
    np.testing.assert_array_equal(rebuilt, room.volume)


def fan(room: Room, wall_x: float | None = 0.7, times: int = 3) -> None:
    """Scan straight ahead at all heights of a robot, up to a wall if there is one."""
    for y in np.arange(-0.3, 0.31, 0.025):
        for z in np.arange(-0.02, 0.18, 0.02):
            room.ray((-0.3, y, z), (wall_x or 1.6, y, z), hit=wall_x is not None, times=times)


def column(x: float, y: float) -> tuple[int, int]:
    i, j = np.floor((np.array([x, y]) - CORNER) / CELL).astype(int)
    return int(i), int(j)


def test_a_scanned_wall_is_an_obstacle_and_the_way_to_it_is_free(room):
    fan(room)
    assert room.obstacle[column(0.71, 0.0)] > 0
    assert room.obstacle[column(0.2, 0.0)] < 0
    assert room.obstacle[column(1.0, 0.0)] == 0, "nothing is known behind the wall"
    assert room.obstacle[column(0.2, 0.6)] == 0, "nothing is known beside the scan"


def test_one_low_step_is_driven_over_where_ground_may_rise():
    for step, verdict in ((0, 1), (1, 0)):
        room = Room(step)
        fan(room, wall_x=None)
        for _ in range(10):
            room.ray((-0.3, 0.0, 0.1), (0.71, 0.0, 0.0), hit=True)  # level 1: a ledge 5 cm high
        assert (room.obstacle[column(0.71, 0.0)] > 0) == bool(verdict)


def test_rays_off_the_map_do_no_harm(room):
    room.ray((5.0, 5.0, 5.0), (6.0, 6.0, 5.0), hit=True)
    room.ray((0.0, 0.0, 0.1), (0.0, 0.0, 0.1), hit=False)
    assert not room.volume.any()

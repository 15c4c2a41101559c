"""What is true of a map's cells, looked up in the world: ground, obstacles, reach, and the volume's levels.

Scoring and metrics read it; nothing of it reaches a policy.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from coop_envs.mapping.ground_map import GROUND, VOLUME, GroundMap, MapModel
from coop_envs.worlds.solid import SolidColumns
from coop_envs.worlds.truth import TruthGrid
from coop_envs.worlds.world import World

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

SAFE, OCCUPIED, REACHABLE = (wp.constant(k) for k in (1, 2, 4))


@wp.struct
class Truth:
    """Cells of all worlds: world w has ``shape[w]`` of size ``cell`` from ``origin[w]``; goals x, y, radius, known.

    ``solid`` holds a bit for each slab of ``slab`` m from the height ``base[w]`` up; see `worlds.solid`.
    """

    cells: wp.array[wp.uint8]
    solid: wp.array[wp.uint64]
    base: wp.array[float]
    slab: float
    offset: wp.array[int]
    shape: wp.array[wp.vec2i]
    origin: wp.array[wp.vec2]
    goal: wp.array[wp.vec4]
    cell: float


def pack_truth(
    worlds: Sequence[World], grids: Sequence[TruthGrid], solids: Sequence[SolidColumns], device: str
) -> Truth:
    """Truth of all worlds; ``solids`` may be empty where no team has a volume map."""
    truth = Truth()
    layers = [
        g.safe.astype(np.uint8) + 2 * g.obstacle.astype(np.uint8) + 4 * g.reachable.astype(np.uint8) for g in grids
    ]
    truth.cells = wp.array(np.concatenate([c.ravel() for c in layers]).astype(np.uint8), dtype=wp.uint8, device=device)
    truth.offset = wp.array(np.cumsum([0] + [c.size for c in layers[:-1]]), dtype=int, device=device)
    truth.shape = wp.array([c.shape for c in layers], dtype=wp.vec2i, device=device)
    truth.origin = wp.array([g.origin_m for g in grids], dtype=wp.vec2, device=device)
    goals = [(*w.goal, 1.0) if w.goal is not None else (0.0, 0.0, 0.0, 0.0) for w in worlds]
    truth.goal = wp.array(goals, dtype=wp.vec4, device=device)
    truth.cell = grids[0].cell_m
    bits = [s.bits.ravel() for s in solids] or [np.zeros(1, dtype=np.uint64)]
    truth.solid = wp.array(np.concatenate(bits), dtype=wp.uint64, device=device)
    truth.base = wp.array([s.base_m for s in solids] or [0.0], dtype=float, device=device)
    truth.slab = solids[0].slab_m if solids else 1.0
    return truth


@wp.func
def truth_cell(truth: Truth, w: int, frame: wp.vec4, ground: GroundMap, model: MapModel, b: int, cell: int) -> int:
    """Index of the truth at the centre of a map cell, -1 beyond the world."""
    corner = ground.corner[b]
    x = corner[0] + (float(cell // model.ny) + 0.5) * model.cell
    y = corner[1] + (float(cell % model.ny) + 0.5) * model.cell
    c = wp.cos(frame[3])
    s = wp.sin(frame[3])
    i = int(wp.floor((frame[0] + c * x - s * y - truth.origin[w][0]) / truth.cell))
    j = int(wp.floor((frame[1] + s * x + c * y - truth.origin[w][1]) / truth.cell))
    n = truth.shape[w]
    if i < 0 or j < 0 or i >= n[0] or j >= n[1]:
        return -1
    return truth.offset[w] + i * n[1] + j


@wp.func
def facts_at(truth: Truth, place: int) -> int:
    """What is true of the ground there; beyond the world nothing is safe and all is occupied."""
    if place < 0:
        return OCCUPIED
    return int(truth.cells[place])


@wp.func
def solid_at(truth: Truth, w: int, frame: wp.vec4, model: MapModel, place: int, level: int) -> bool:
    """Whether a level of the volume there holds anything solid: any of the slabs whose middle lies in it.

    Under the slabs, and beyond the world, all is solid.
    """
    low = (frame[2] + model.floor + float(level) * model.cell - truth.base[w]) / truth.slab
    if place < 0 or low < -0.5:
        return True
    first = wp.max(int(wp.ceil(low - 0.5)), 0)
    last = wp.min(int(wp.ceil(low + model.cell / truth.slab - 0.5)) - 1, 63)
    found = wp.uint64(0)
    for k in range(first, last + 1):
        found = found | (truth.solid[place] >> wp.uint64(k))
    return (found & wp.uint64(1)) != wp.uint64(0)


@wp.func
def is_fact(truth: Truth, w: int, frame: wp.vec4, model: MapModel, place: int, layer: int) -> bool:
    """Whether a cell's statement is true: ground carries, something stands there, or a level holds something."""
    if layer >= VOLUME:
        return solid_at(truth, w, frame, model, place, layer - VOLUME)
    facts = facts_at(truth, place)
    if layer == GROUND:
        return (facts & SAFE) != 0
    return (facts & OCCUPIED) != 0

"""What scan rays tell of the volume of a team's map, and which columns a robot can pass.

The cells around a ray become free (see `sweep`), that of the point at its end is occupied.
"""

from __future__ import annotations

import warp as wp

from coop_envs.mapping.ground_map import (
    NO_PASSAGE,
    OBSTACLE,
    VOLUME,
    GroundMap,
    MapModel,
    add_evidence,
    change_of,
    set_evidence,
)
from coop_envs.mapping.sweep import HIT, begin_sweep, span_in_slice, swept_evidence

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FREE, SOLID = wp.constant(-24), wp.constant(24)
CLEAR, STANDS = wp.constant(-48), wp.constant(48)


@wp.func
def axis_of(k: int) -> wp.vec3i:
    """The unit step along axis k."""
    return wp.vec3i(int(k == 0), int(k == 1), int(k == 2))


@wp.func
def sweep_ray(ground: GroundMap, model: MapModel, b: int, start: wp.vec3, end: wp.vec3):
    """Enter a ray between two points of the team frame; the cell at its end is left to `mark_point`."""
    corner = ground.corner[b]
    origin = wp.vec3(corner[0], corner[1], model.floor)
    high = wp.vec3i(ground.cells[b][0] - 1, ground.cells[b][1] - 1, model.levels - 1)
    cells = model.sweep / model.cell
    sweep = begin_sweep((start - origin) / model.cell, (end - origin) / model.cell, cells, wp.vec3i(0, 0, 0), high)
    u = (sweep.main + 1) % 3
    v = (sweep.main + 2) % 3
    ahead = axis_of(sweep.main)
    along_u = axis_of(u)
    along_v = axis_of(v)
    for s in range(sweep.first, sweep.last + 1):
        span_u = span_in_slice(sweep, s, u)
        span_v = span_in_slice(sweep, s, v)
        for i in range(span_u[0], span_u[1] + 1):
            row = ahead * s + along_u * i
            for j in range(span_v[0], span_v[1] + 1):
                cell = row + along_v * j
                evidence = swept_evidence(sweep, cell)
                if evidence != 0:
                    add_evidence(ground, model, b, VOLUME + cell[2], cell[0] * model.ny + cell[1], evidence)


@wp.func
def mark_point(ground: GroundMap, model: MapModel, b: int, point: wp.vec3):
    """Enter a measured point of the team frame: something is in its cell."""
    corner = ground.corner[b]
    i = int(wp.floor((point[0] - corner[0]) / model.cell))
    j = int(wp.floor((point[1] - corner[1]) / model.cell))
    k = int(wp.floor((point[2] - model.floor) / model.cell))
    inside = i >= 0 and j >= 0 and k >= 0 and i < ground.cells[b][0] and j < ground.cells[b][1] and k < model.levels
    if inside:
        add_evidence(ground, model, b, VOLUME + k, i * model.ny + j, HIT)


@wp.func
def find_passage(ground: GroundMap, model: MapModel, b: int, cell: int) -> int:
    """The lowest level from which on a robot's height of levels is free."""
    run = int(0)
    for level in range(model.levels):
        if int(ground.volume[b, cell, level]) <= FREE:
            run = run + 1
            if run == model.clearance:
                return level + 1 - run
        else:
            run = 0
    return NO_PASSAGE


@wp.func
def in_the_way(ground: GroundMap, model: MapModel, b: int, cell: int, beside: int) -> bool:
    """Whether a column holds something that stops a robot on its passage through the column ``beside``."""
    level = int(ground.passage[b, beside])
    if level == NO_PASSAGE:
        return False
    highest = int(0)
    for k in range(level + model.step, level + model.clearance):
        highest = wp.max(highest, int(ground.volume[b, cell, k]))
    return highest >= SOLID


@wp.func
def judge_column(ground: GroundMap, model: MapModel, b: int, i: int, j: int):
    """Set whether something stands in a column: seen from its neighbours' passages, or from its own."""
    nx = ground.cells[b][0]
    ny = ground.cells[b][1]
    if i < 0 or j < 0 or i >= nx or j >= ny:
        return
    cell = i * model.ny + j
    stops = i > 0 and in_the_way(ground, model, b, cell, cell - model.ny)
    stops = stops or (i < nx - 1 and in_the_way(ground, model, b, cell, cell + model.ny))
    stops = stops or (j > 0 and in_the_way(ground, model, b, cell, cell - 1))
    stops = stops or (j < ny - 1 and in_the_way(ground, model, b, cell, cell + 1))
    verdict = int(0)
    if stops:
        verdict = STANDS
    elif int(ground.passage[b, cell]) != NO_PASSAGE:
        verdict = CLEAR
    set_evidence(ground, model, b, OBSTACLE, cell, verdict)


@wp.func
def kind(log_odds: int) -> int:
    """-1 free, 1 solid, 0 unknown."""
    return int(log_odds >= SOLID) - int(log_odds <= FREE)


@wp.func
def judge_changes(ground: GroundMap, model: MapModel, b: int):
    """Judge anew the columns in which a cell became free, solid or doubtful in this decision, and those beside them."""
    for k in range(ground.change_count[b]):
        change = change_of(ground.changes[b, k])
        was = kind(change.was)
        now = kind(change.now)
        if change.layer >= VOLUME and was != now:
            cell = change.cell
            i = cell // model.ny
            j = cell % model.ny
            level = find_passage(ground, model, b, cell)
            if level != int(ground.passage[b, cell]):
                ground.passage[b, cell] = wp.int8(level)
                judge_column(ground, model, b, i, j)
                judge_column(ground, model, b, i - 1, j)
                judge_column(ground, model, b, i + 1, j)
                judge_column(ground, model, b, i, j - 1)
                judge_column(ground, model, b, i, j + 1)
            elif was == 1 or now == 1:
                judge_column(ground, model, b, i, j)

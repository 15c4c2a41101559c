"""What scan rays tell of the volume: free along the ray, something at its end, and which columns a robot can pass.

A ray from a camera to a point that it measured proves cells that it runs through to be free, and makes those within the
sweep radius likely free. It has to pass under a cell's middle: one that passes higher may graze the ground that fills the
lower half, as most rays do. The cell of the point is occupied.
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
    set_evidence,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

THROUGH, BESIDE, HIT = wp.constant(-24), wp.constant(-8), wp.constant(48)
UNDER = wp.constant(0.1)  # of a cell: how far under a cell's middle a ray has to pass to prove it
FREE, SOLID = wp.constant(-24), wp.constant(24)
CLEAR, STANDS = wp.constant(-48), wp.constant(48)


@wp.func
def slice_span(centre: float, reach: float, last: int) -> wp.vec2i:
    """First and last cell whose middle lies within ``reach`` of a coordinate, both in cells, cut at the map's edge."""
    low = int(wp.ceil(centre - reach - 0.5))
    high = int(wp.floor(centre + reach - 0.5))
    return wp.vec2i(wp.max(low, 0), wp.min(high, last))


@wp.func
def sweep_ray(ground: GroundMap, model: MapModel, b: int, start: wp.vec3, end: wp.vec3):
    """Enter a ray between two points of the team frame; the cell at its end is left to `mark_point`.

    Slice by slice along the ray's main axis, the cells around its centre line are tried.
    """
    corner = ground.corner[b]
    origin = wp.vec3(corner[0], corner[1], model.floor)
    p = (start - origin) / model.cell
    d = (end - origin) / model.cell - p
    length = wp.length(d)
    if length < 1.5:
        return
    a = d / length
    length = length - 0.5
    last = wp.vec3i(ground.cells[b][0] - 1, ground.cells[b][1] - 1, model.levels - 1)
    m = int(0)
    if wp.abs(a[1]) > wp.abs(a[0]):
        m = 1
    if wp.abs(a[2]) > wp.abs(a[m]):
        m = 2
    u = (m + 1) % 3
    v = (m + 2) % 3
    radius = wp.max(model.sweep / model.cell, 0.5)
    reach = radius / wp.abs(a[m])
    ends = wp.vec2(p[m], p[m] + a[m] * length)
    first = wp.max(int(wp.ceil(wp.min(ends[0], ends[1]) - 0.5)), 0)
    final = wp.min(int(wp.floor(wp.max(ends[0], ends[1]) - 0.5)), last[m])
    cell = wp.vec3i()
    for s in range(first, final + 1):
        t = (float(s) + 0.5 - p[m]) / a[m]
        cu = p[u] + a[u] * t
        cv = p[v] + a[v] * t
        along_u = slice_span(cu, reach, last[u])
        along_v = slice_span(cv, reach, last[v])
        cell[m] = s
        for i in range(along_u[0], along_u[1] + 1):
            cell[u] = i
            for j in range(along_v[0], along_v[1] + 1):
                cell[v] = j
                e = wp.vec3(float(cell[0]) + 0.5, float(cell[1]) + 0.5, float(cell[2]) + 0.5) - p
                off = e - a * wp.dot(e, a)
                distance2 = wp.dot(off, off)
                index = cell[0] * model.ny + cell[1]
                if off[2] >= UNDER:
                    if distance2 <= 0.25:
                        add_evidence(ground, b, VOLUME + cell[2], index, THROUGH)
                    elif distance2 <= radius * radius:
                        add_evidence(ground, b, VOLUME + cell[2], index, BESIDE)


@wp.func
def mark_point(ground: GroundMap, model: MapModel, b: int, point: wp.vec3):
    """Enter a measured point of the team frame: something is in its cell."""
    corner = ground.corner[b]
    i = int(wp.floor((point[0] - corner[0]) / model.cell))
    j = int(wp.floor((point[1] - corner[1]) / model.cell))
    k = int(wp.floor((point[2] - model.floor) / model.cell))
    inside = i >= 0 and j >= 0 and k >= 0 and i < ground.cells[b][0] and j < ground.cells[b][1] and k < model.levels
    if inside:
        add_evidence(ground, b, VOLUME + k, i * model.ny + j, HIT)


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
    for k in range(level + model.step, level + model.clearance):
        if int(ground.volume[b, cell, k]) >= SOLID:
            return True
    return False


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
    set_evidence(ground, b, OBSTACLE, cell, verdict)


@wp.func
def kind(log_odds: int) -> int:
    """-1 free, 1 solid, 0 unknown."""
    return int(log_odds >= SOLID) - int(log_odds <= FREE)


@wp.func
def judge_changes(ground: GroundMap, model: MapModel, b: int):
    """Judge anew the columns in which a cell became free, solid or doubtful in this decision, and those beside them."""
    for k in range(ground.change_count[b]):
        change = ground.changes[b, k]
        was = kind(change[2])
        now = kind(change[3])
        if change[0] >= VOLUME and was != now:
            cell = change[1]
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

"""What scan rays tell of the volume: free along the ray, something at its end, and which columns a robot can pass.

A ray from a camera to a point that it measured proves cells that it runs through to be free, and makes those within the
sweep radius likely free. It has to pass under a cell's middle: one that passes higher may graze the ground that fills the
lower half, as most rays do. The cell of the point is occupied.
"""

from __future__ import annotations

import warp as wp

from coop_envs.mapping.ground_map import (
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
FREE, SOLID = wp.constant(-16), wp.constant(24)
NONE = wp.constant(-1)


@wp.func
def slice_span(centre: float, reach: float, last: int) -> wp.vec2i:
    """First and last cell whose middle lies within ``reach`` of a coordinate, both in cells, cut at the map's edge."""
    low = int(wp.ceil(centre - reach - 0.5))
    high = int(wp.floor(centre + reach - 0.5))
    return wp.vec2i(wp.max(low, 0), wp.min(high, last))


@wp.func
def sweep_ray(ground: GroundMap, model: MapModel, b: int, start: wp.vec3, end: wp.vec3):
    """Enter a ray between two points of the team frame; the last cell before its end is left to `mark_point`.

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
    length = length - 1.0
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
def passage(ground: GroundMap, model: MapModel, b: int, cell: int) -> int:
    """The lowest level from which on a robot's height of levels is free, NONE where no such is known."""
    run = int(0)
    for level in range(model.levels):
        if int(ground.volume[b, level, cell]) <= FREE:
            run = run + 1
            if run == model.clearance:
                return level + 1 - run
        else:
            run = 0
    return NONE


@wp.func
def in_the_way(ground: GroundMap, model: MapModel, b: int, cell: int, level: int) -> int:
    """Strongest evidence in a column for something that stops a robot whose passage beside it starts at ``level``."""
    worst = int(0)
    for k in range(level + model.step, level + model.clearance):
        value = int(ground.volume[b, k, cell])
        if value >= SOLID:
            worst = wp.max(worst, value)
    return worst


@wp.func
def least_free(ground: GroundMap, model: MapModel, b: int, cell: int, level: int) -> int:
    """Log-odds of the least certain level of a passage that starts at ``level``."""
    least = int(-127)
    for k in range(level, level + model.clearance):
        least = wp.max(least, int(ground.volume[b, k, cell]))
    return least


@wp.func
def judge_column(ground: GroundMap, model: MapModel, b: int, i: int, j: int):
    """Set whether something stands in a column: seen from its neighbours' passages, or from its own."""
    cells = ground.cells[b]
    if i < 0 or j < 0 or i >= cells[0] or j >= cells[1]:
        return
    cell = i * model.ny + j
    verdict = int(0)
    for n in range(4):
        ni = i + (1 - n) * ((n + 1) % 2)
        nj = j + (2 - n) * (n % 2)
        if ni >= 0 and nj >= 0 and ni < cells[0] and nj < cells[1]:
            level = passage(ground, model, b, ni * model.ny + nj)
            if level != NONE:
                verdict = wp.max(verdict, in_the_way(ground, model, b, cell, level))
    if verdict == 0:
        own = passage(ground, model, b, cell)
        if own != NONE:
            verdict = least_free(ground, model, b, cell, own)
    set_evidence(ground, b, OBSTACLE, cell, verdict)


@wp.func
def kind(log_odds: int) -> int:
    """-1 free, 1 solid, 0 unknown."""
    return int(log_odds >= SOLID) - int(log_odds <= FREE)


@wp.func
def judge_changes(ground: GroundMap, model: MapModel, b: int):
    """Judge anew every column, and those beside it, in which a cell became free, solid or doubtful in this decision."""
    for k in range(ground.change_count[b]):
        change = ground.changes[b, k]
        if change[0] >= VOLUME and kind(change[2]) != kind(change[3]):
            i = change[1] // model.ny
            j = change[1] % model.ny
            judge_column(ground, model, b, i, j)
            judge_column(ground, model, b, i - 1, j)
            judge_column(ground, model, b, i + 1, j)
            judge_column(ground, model, b, i, j - 1)
            judge_column(ground, model, b, i, j + 1)

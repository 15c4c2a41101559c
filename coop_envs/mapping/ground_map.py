"""The team's map: log-odds, cell by cell, that the ground carries robots and that something stands in the way.

Ground is proven by robots passing over it (thesis section 2.2.4) and called hazardous around a robot that got stuck;
later passes may prove it after all (section 2.3 asks for that). Cells are counted in the team frame. Teams with lasers
also hold a volume, levels of cells above each other (see `volume`), from which they judge what stands in the way.
"""

from __future__ import annotations

import math

import warp as wp

from coop_envs.geometry.arrays import allocate

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

LOG_ODDS_SCALE = 16.0
LOG_ODDS = wp.constant(LOG_ODDS_SCALE)
LIMIT = wp.constant(112)
PASSED = wp.constant(56)
STUCK_HERE = wp.constant(-72)
STUCK_NEAR = wp.constant(-32)
TRUSTED = wp.constant(36)
STUCK, SILENT = wp.constant(1), wp.constant(2)
EXPLAINED_AWAY = wp.constant(4)
GROUND, OBSTACLE, VOLUME = wp.constant(0), wp.constant(1), wp.constant(2)
LAYERS = 2
PROBABLE = wp.constant(0.6)
UNKNOWN = wp.constant(128)  # how a chance of a half is shown
NO_PASSAGE = wp.constant(-1)
FIRST_STEP_M = wp.constant(0.02)
SIGMAS = wp.constant(2.0)


@wp.struct
class GroundMap:
    """Maps of B teams, C = nx ny cells each, row-major (x, y).

    log_odds
        (B, 2, C) of "the ground carries robots" and of "something stands here", in sixteenths.
    shown
        (B, 2, D) the same as observations show it: chances times 255 of blocks of ``stride`` x ``stride`` cells,
        row-major, see `shown_chance`.
    volume
        (B, C, L) of "something is here", levels from the lowest, in sixteenths.
    passage
        (B, C) the lowest level from which on a robot's height is free, `NO_PASSAGE` where none is known.
    corner, cells
        (B,) lower corner in the team frame (m); cells along x and y that the team's own ground has, at most nx and ny.
    proven_at
        (B, N) x, y, 1 where a robot's footprint was last entered.
    changes, change_count
        (B, K) cell, and layer, old and new value in one number (see `change_of`), of what this decision changed; (B,)
        how many. Layer `VOLUME` + k is level k.
    """

    log_odds: wp.array3d[wp.int8]
    shown: wp.array3d[wp.uint8]
    volume: wp.array3d[wp.int8]
    passage: wp.array2d[wp.int8]
    corner: wp.array[wp.vec2]
    cells: wp.array[wp.vec2i]
    proven_at: wp.array2d[wp.vec3]
    changes: wp.array2d[wp.vec2i]
    change_count: wp.array[int]


@wp.struct
class MapModel:
    """Cells along x and y, their size (m), and the radius of ground called hazardous around a stuck robot.

    Observations show blocks of ``stride`` by ``stride`` cells.
    ``levels`` (0: no volume) start at height ``floor`` in the team frame. A robot needs ``clearance`` free levels to
    pass, over ground that rises by at most ``step`` levels a cell. Rays sweep free what is within ``sweep`` m.
    """

    nx: int
    ny: int
    cell: float
    stride: int
    mark_radius: float
    levels: int
    floor: float
    clearance: int
    step: int
    sweep: float


@wp.struct
class Footprint:
    """A robot on the map: place (z: of the ground under it), uncertainty (m), radii, and whether it proves ground.

    ``marks`` is 1 where it was called stuck, 2 where it fell silent, else 0.
    """

    x: float
    y: float
    z: float
    height: float
    sigma: float
    contact_radius: float
    body_radius: float
    proves: int
    marks: int


def allocate_map(
    teams: int, robots: int, model: MapModel, reach_m: float, device: str, swept_cells: int = 0
) -> GroundMap:
    """Maps of nothing yet; ``reach_m`` is the largest radius that a robot changes around itself.

    ``swept_cells`` is how many cells of the volume the rays of one decision may change.
    """
    side = math.floor(2.0 * reach_m / model.cell) + 1
    changes = (teams, robots * (LAYERS + model.levels) * side * side + swept_cells)
    log_odds = (teams, LAYERS, model.nx * model.ny)
    volume = (teams, model.nx * model.ny, model.levels)
    passage = (teams, model.nx * model.ny * min(model.levels, 1))
    shown = (teams, LAYERS, math.ceil(model.nx / model.stride) * math.ceil(model.ny / model.stride))
    sizes = {"log_odds": log_odds, "shown": shown, "volume": volume, "passage": passage, "changes": changes}
    return allocate(GroundMap, (teams, robots), device, **sizes)


@wp.func
def evidence_at(ground: GroundMap, b: int, layer: int, cell: int) -> int:
    """Log-odds of a cell of a layer or, from `VOLUME` on, of a level."""
    if layer >= VOLUME:
        return int(ground.volume[b, cell, layer - VOLUME])
    return int(ground.log_odds[b, layer, cell])


@wp.struct
class Change:
    """What became of a cell of a layer: log-odds before and after."""

    layer: int
    cell: int
    was: int
    now: int


@wp.func
def packed_change(layer: int, cell: int, old: int, new: int) -> wp.vec2i:
    """The entry of a change in `GroundMap.changes`."""
    return wp.vec2i(cell, (layer << 16) | ((old + 128) << 8) | (new + 128))


@wp.func
def change_of(entry: wp.vec2i) -> Change:
    """The change that an entry of `GroundMap.changes` tells of."""
    change = Change()
    change.cell = entry[0]
    change.layer = entry[1] >> 16
    change.was = ((entry[1] >> 8) & 255) - 128
    change.now = (entry[1] & 255) - 128
    return change


@wp.func
def probability(log_odds: int) -> float:
    """Probability of a cell's statement."""
    if log_odds == 0:
        return 0.5
    return 1.0 / (1.0 + wp.exp(-float(log_odds) / LOG_ODDS))


@wp.func
def shown_chance(ground: GroundMap, model: MapModel, b: int, layer: int, i0: int, j0: int) -> int:
    """Probability times 255 of the block from cell (i0, j0): of its likeliest hazard or obstacle, else their mean."""
    total = float(0.0)
    worst = float(0.5)
    for i in range(i0, i0 + model.stride):
        for j in range(j0, j0 + model.stride):
            p = float(0.5)
            if i < model.nx and j < model.ny:
                p = probability(int(ground.log_odds[b, layer, i * model.ny + j]))
            total = total + p
            bad = p
            if layer == GROUND:
                bad = 1.0 - p
            worst = wp.max(worst, bad)
    p = total / float(model.stride * model.stride)
    if worst > PROBABLE:
        p = worst
        if layer == GROUND:
            p = 1.0 - worst
    return int(wp.floor(p * 255.0 + 0.5))


@wp.func
def show(ground: GroundMap, model: MapModel, b: int, layer: int, cell: int):
    """Bring what is shown of a cell's block up to date."""
    i = (cell // model.ny) // model.stride
    j = (cell % model.ny) // model.stride
    across = (model.ny + model.stride - 1) // model.stride
    chance = shown_chance(ground, model, b, layer, i * model.stride, j * model.stride)
    ground.shown[b, layer, i * across + j] = wp.uint8(chance)


@wp.func
def set_evidence(ground: GroundMap, model: MapModel, b: int, layer: int, cell: int, new: int):
    """Overwrite the log-odds of a cell and note the change."""
    old = evidence_at(ground, b, layer, cell)
    if new == old:
        return
    if layer >= VOLUME:
        ground.volume[b, cell, layer - VOLUME] = wp.int8(new)
    else:
        ground.log_odds[b, layer, cell] = wp.int8(new)
        show(ground, model, b, layer, cell)
    k = ground.change_count[b]
    if k < ground.changes.shape[1]:
        ground.changes[b, k] = packed_change(layer, cell, old, new)
        ground.change_count[b] = k + 1


@wp.func
def add_evidence(ground: GroundMap, model: MapModel, b: int, layer: int, cell: int, evidence: int):
    """Add log-odds to one cell and note the change."""
    new = wp.clamp(evidence_at(ground, b, layer, cell) + evidence, -LIMIT, LIMIT)
    set_evidence(ground, model, b, layer, cell, new)


@wp.func
def stamp(
    ground: GroundMap, model: MapModel, b: int, layer: int, at: wp.vec2, radius: float, besides: wp.vec2, beside: float,
    evidence: int,
):  # fmt: skip
    """Add evidence to every cell whose centre is within ``radius`` of a point, but not within ``beside`` of another."""
    corner = ground.corner[b]
    i0 = wp.max(int(wp.floor((at[0] - radius - corner[0]) / model.cell)), 0)
    j0 = wp.max(int(wp.floor((at[1] - radius - corner[1]) / model.cell)), 0)
    i1 = wp.min(int(wp.floor((at[0] + radius - corner[0]) / model.cell)), ground.cells[b][0] - 1)
    j1 = wp.min(int(wp.floor((at[1] + radius - corner[1]) / model.cell)), ground.cells[b][1] - 1)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            centre = corner + wp.vec2((float(i) + 0.5) * model.cell, (float(j) + 0.5) * model.cell)
            if wp.length(centre - at) <= radius and wp.length(centre - besides) > beside:
                add_evidence(ground, model, b, layer, i * model.ny + j, evidence)


@wp.func
def blame(ground: GroundMap, model: MapModel, b: int, at: wp.vec2, foot: Footprint):
    """Mark the ground that may hold a stuck robot, most under its contact disc, less around it.

    Ground that passes have proven is blamed a quarter as much: what is not proven explains better what caught a robot
    by its rim. One that fell silent may lie further on than where it was last known to be, so silence spares none.
    """
    corner = ground.corner[b]
    doubt = wp.min(foot.sigma, model.mark_radius)
    core = foot.contact_radius + doubt
    radius = wp.max(model.mark_radius + doubt, core)
    i0 = wp.max(int(wp.floor((at[0] - radius - corner[0]) / model.cell)), 0)
    j0 = wp.max(int(wp.floor((at[1] - radius - corner[1]) / model.cell)), 0)
    i1 = wp.min(int(wp.floor((at[0] + radius - corner[0]) / model.cell)), ground.cells[b][0] - 1)
    j1 = wp.min(int(wp.floor((at[1] + radius - corner[1]) / model.cell)), ground.cells[b][1] - 1)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            away = wp.length(corner + wp.vec2((float(i) + 0.5) * model.cell, (float(j) + 0.5) * model.cell) - at)
            if away <= radius:
                cell = i * model.ny + j
                evidence = STUCK_NEAR
                if away <= core:
                    evidence = STUCK_HERE
                if foot.marks == STUCK and int(ground.log_odds[b, GROUND, cell]) >= TRUSTED:
                    evidence = evidence // EXPLAINED_AWAY
                add_evidence(ground, model, b, GROUND, cell, evidence)


@wp.func
def draw_footprint(ground: GroundMap, model: MapModel, b: int, r: int, foot: Footprint):
    """Enter what one robot's whereabouts tell: ground it passed, or the hazard that holds it.

    Only cells that its contact disc covers for sure (less two sigma) and did not cover at its last entry are counted,
    so standing still proves nothing.
    """
    at = wp.vec2(foot.x, foot.y)
    nowhere = wp.vec2(1.0e9, 1.0e9)
    if foot.proves == 1:
        last = ground.proven_at[b, r]
        before = wp.vec2(last[0], last[1])
        if last[2] == 0.0:
            before = nowhere
        if wp.length(at - before) > FIRST_STEP_M:
            contact = foot.contact_radius - SIGMAS * foot.sigma
            body = foot.body_radius - SIGMAS * foot.sigma
            if contact > 0.0:
                stamp(ground, model, b, GROUND, at, contact, before, contact, PASSED)
            if body > 0.0 and model.levels == 0:
                stamp(ground, model, b, OBSTACLE, at, body, before, body, -PASSED)
            for level in range(model.levels):
                above = model.floor + (float(level) + 0.5) * model.cell - foot.z
                if body > 0.0 and above > 0.5 * model.cell and above < foot.height:
                    stamp(ground, model, b, VOLUME + level, at, body, before, body, -PASSED)
            ground.proven_at[b, r] = wp.vec3(foot.x, foot.y, 1.0)
    if foot.marks > 0:
        blame(ground, model, b, at, foot)


@wp.kernel
def begin_map(
    ground: GroundMap,
    model: MapModel,
    corner: wp.array[wp.vec2],
    cells: wp.array[wp.vec2i],
    start: wp.array2d[wp.vec3],
    known_radius: float,
    chosen: wp.array[int],
):
    """Start the maps of the chosen teams anew: nothing is known but the ground on which people set the robots down."""
    b = wp.tid()
    ground.change_count[b] = 0
    if chosen[b] == 0:
        return
    ground.corner[b] = corner[b]
    ground.cells[b] = cells[b]
    for layer in range(ground.log_odds.shape[1]):
        for c in range(ground.log_odds.shape[2]):
            ground.log_odds[b, layer, c] = wp.int8(0)
        for d in range(ground.shown.shape[2]):
            ground.shown[b, layer, d] = wp.uint8(UNKNOWN)
    for c in range(ground.passage.shape[1]):
        ground.passage[b, c] = wp.int8(NO_PASSAGE)
        for level in range(model.levels):
            ground.volume[b, c, level] = wp.int8(0)
    for r in range(ground.proven_at.shape[1]):
        ground.proven_at[b, r] = wp.vec3(0.0, 0.0, 0.0)
        at = wp.vec2(start[b, r][0], start[b, r][1])
        nowhere = wp.vec2(1.0e9, 1.0e9)
        stamp(ground, model, b, GROUND, at, known_radius, nowhere, 0.0, PASSED)
        stamp(ground, model, b, OBSTACLE, at, known_radius, nowhere, 0.0, -PASSED)
    ground.change_count[b] = 0

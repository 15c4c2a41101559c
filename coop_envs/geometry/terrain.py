"""Ground heights and ray casts over a batch of worlds, each a height field or a height field with a mesh over it.

Heights are linear on two triangles a cell, split along the diagonal between nodes (i, j+1) and (i+1, j), so a ray's
first crossing is exact. A world's rays meet its mesh (BVH) where it has one, else the height field.

Source (grid traversal): Amanatides, Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

NO_GROUND_M = -1000.0
NO_GROUND = wp.constant(NO_GROUND_M)
MISS = wp.constant(-1.0)
ENDLESS = wp.constant(1.0e30)


@wp.struct
class Terrain:
    """All worlds: heights of world w start at ``offset[w]``, row-major (x, y); ``mesh[w]`` is 0 where there is none.

    A cell has the index of its lower corner: ``top`` is the highest of its corners, and ``level`` 1 where the ground
    within ``level_reach`` (m) of the cell has one height.
    """

    heights: wp.array[float]
    top: wp.array[float]
    level: wp.array[wp.int8]
    level_reach: float
    offset: wp.array[int]
    shape: wp.array[wp.vec2i]
    origin: wp.array[wp.vec2]
    cell: wp.array[float]
    mesh: wp.array[wp.uint64]


@wp.func
def corner_heights(terrain: Terrain, w: int, i: int, j: int) -> wp.vec4:
    """Heights at (i, j), (i, j+1), (i+1, j), (i+1, j+1)."""
    ny = terrain.shape[w][1]
    k = terrain.offset[w] + i * ny + j
    return wp.vec4(terrain.heights[k], terrain.heights[k + 1], terrain.heights[k + ny], terrain.heights[k + ny + 1])


@wp.func
def in_cell(h: wp.vec4, u: float, v: float) -> float:
    """Height at (u, v) within a cell with these corners, u and v in [0, 1]."""
    if u + v <= 1.0:
        return h[0] + (h[2] - h[0]) * u + (h[1] - h[0]) * v
    return h[3] + (h[1] - h[3]) * (1.0 - u) + (h[2] - h[3]) * (1.0 - v)


@wp.func
def ground_height(terrain: Terrain, w: int, x: float, y: float) -> float:
    """Height of the ground at (x, y) in metres, NO_GROUND beyond the world's edge."""
    n = terrain.shape[w]
    inverse = 1.0 / terrain.cell[w]
    gx = (x - terrain.origin[w][0]) * inverse
    gy = (y - terrain.origin[w][1]) * inverse
    if gx < 0.0 or gy < 0.0 or gx > float(n[0] - 1) or gy > float(n[1] - 1):
        return NO_GROUND
    i = wp.min(int(gx), n[0] - 2)
    j = wp.min(int(gy), n[1] - 2)
    return in_cell(corner_heights(terrain, w, i, j), gx - float(i), gy - float(j))


@wp.func
def is_level(terrain: Terrain, w: int, x: float, y: float, reach: float) -> bool:
    """Whether the ground within ``reach`` (m) of a point in the world is known to have one height."""
    inverse = 1.0 / terrain.cell[w]
    i = int((x - terrain.origin[w][0]) * inverse)
    j = int((y - terrain.origin[w][1]) * inverse)
    return reach <= terrain.level_reach and terrain.level[terrain.offset[w] + i * terrain.shape[w][1] + j] != wp.int8(0)


@wp.func
def crossing(t0: float, f0: float, t1: float, f1: float) -> float:
    """Where a function linear in t falls to zero within [t0, t1], MISS where it stays above."""
    if f0 <= 0.0:
        return t0
    if f1 > 0.0:
        return MISS
    return t0 + (t1 - t0) * f0 / (f0 - f1)


@wp.func
def cell_crossing(h: wp.vec4, p0: wp.vec3, p1: wp.vec3, t0: float, t1: float) -> float:
    """First crossing of the surface by the segment p0-p1 (cell units in x and y) inside one cell, MISS where none."""
    f0 = p0[2] - in_cell(h, p0[0], p0[1])
    f1 = p1[2] - in_cell(h, p1[0], p1[1])
    s0 = p0[0] + p0[1] - 1.0
    s1 = p1[0] + p1[1] - 1.0
    if s0 * s1 < 0.0:
        k = s0 / (s0 - s1)
        pm = p0 + (p1 - p0) * k
        fm = pm[2] - in_cell(h, pm[0], 1.0 - pm[0])
        tm = t0 + (t1 - t0) * k
        t = crossing(t0, f0, tm, fm)
        if t >= 0.0:
            return t
        return crossing(tm, fm, t1, f1)
    return crossing(t0, f0, t1, f1)


@wp.func
def span(g: float, d: float, last: float) -> wp.vec2:
    """The t between which g + d t lies within [0, last]; the first is the greater one where it never does."""
    if d == 0.0:
        if g < 0.0 or g > last:
            return wp.vec2(1.0, 0.0)
        return wp.vec2(0.0, ENDLESS)
    a = -g / d
    b = (last - g) / d
    return wp.vec2(wp.min(a, b), wp.max(a, b))


@wp.func
def next_border(g: float, d: float, cell: int) -> float:
    """The t at which g + d t leaves a cell [cell, cell + 1]."""
    if d > 0.0:
        return (float(cell + 1) - g) / d
    if d < 0.0:
        return (float(cell) - g) / d
    return ENDLESS


@wp.func
def cast_height_field(terrain: Terrain, w: int, start: wp.vec3, direction: wp.vec3, limit: float) -> float:
    """As `cast_ray`, at the height field alone; a ray that starts under the ground hits at once."""
    n = terrain.shape[w]
    inverse = 1.0 / terrain.cell[w]
    gx = (start[0] - terrain.origin[w][0]) * inverse
    gy = (start[1] - terrain.origin[w][1]) * inverse
    dx = direction[0] * inverse
    dy = direction[1] * inverse
    in_x = span(gx, dx, float(n[0] - 1))
    in_y = span(gy, dy, float(n[1] - 1))
    t = wp.max(wp.max(in_x[0], in_y[0]), 0.0)
    far = wp.min(wp.min(in_x[1], in_y[1]), limit)
    i = wp.clamp(int(wp.floor(gx + dx * t)), 0, n[0] - 2)
    j = wp.clamp(int(wp.floor(gy + dy * t)), 0, n[1] - 2)
    next_x = next_border(gx, dx, i)
    next_y = next_border(gy, dy, j)
    across_x = wp.abs(1.0 / dx)
    across_y = wp.abs(1.0 / dy)
    step_i = int(wp.sign(dx))
    step_j = int(wp.sign(dy))
    k = terrain.offset[w] + i * n[1] + j
    z0 = start[2] + direction[2] * t
    while t <= far and i >= 0 and j >= 0 and i < n[0] - 1 and j < n[1] - 1:
        leave = wp.max(t, wp.min(wp.min(next_x, next_y), far))
        z1 = start[2] + direction[2] * leave
        if wp.min(z0, z1) <= terrain.top[k]:
            h = corner_heights(terrain, w, i, j)
            p0 = wp.vec3(gx + dx * t - float(i), gy + dy * t - float(j), z0)
            p1 = wp.vec3(gx + dx * leave - float(i), gy + dy * leave - float(j), z1)
            hit = cell_crossing(h, p0, p1, t, leave)
            if hit >= 0.0:
                return hit
        if leave >= far:
            return MISS
        t = leave
        z0 = z1
        if next_x < next_y:
            i = i + step_i
            k = k + step_i * n[1]
            next_x = next_x + across_x
        else:
            j = j + step_j
            k = k + step_j
            next_y = next_y + across_y
    return MISS


@wp.func
def cast_ray(terrain: Terrain, w: int, start: wp.vec3, direction: wp.vec3, limit: float) -> float:
    """Distance in metres along a unit direction to the first surface within the limit, MISS (-1) where none."""
    if terrain.mesh[w] != wp.uint64(0):
        query = wp.mesh_query_ray(terrain.mesh[w], start, direction, limit)
        if query.result:
            return query.t
        return MISS
    return cast_height_field(terrain, w, start, direction, limit)


@wp.func
def blocked(terrain: Terrain, w: int, a: wp.vec3, b: wp.vec3, slack: float) -> bool:
    """Whether a surface lies between two points, the last `slack` metres before b not counted."""
    d = b - a
    length = wp.length(d)
    if length <= slack:
        return False
    if terrain.mesh[w] != wp.uint64(0):
        return wp.mesh_query_ray_anyhit(terrain.mesh[w], a, d / length, length - slack)
    return cast_height_field(terrain, w, a, d / length, length - slack) >= 0.0


@wp.func
def slope_normal(h: wp.vec4, u: float, v: float, cell: float) -> wp.vec3:
    """Upward unit normal of the triangle at (u, v) within a cell with these corners."""
    if u + v <= 1.0:
        return wp.normalize(wp.vec3(h[0] - h[2], h[0] - h[1], cell))
    return wp.normalize(wp.vec3(h[1] - h[3], h[2] - h[3], cell))


@wp.struct
class Surface:
    """Where a ray first meets a surface: the way there (m), `MISS` where it does not; unit normal towards its start."""

    t: float
    normal: wp.vec3


@wp.func
def field_normal(terrain: Terrain, w: int, at: wp.vec3) -> wp.vec3:
    """Upward unit normal of the height field at a point on it."""
    cell = terrain.cell[w]
    n = terrain.shape[w]
    gx = (at[0] - terrain.origin[w][0]) / cell
    gy = (at[1] - terrain.origin[w][1]) / cell
    i = wp.clamp(int(gx), 0, n[0] - 2)
    j = wp.clamp(int(gy), 0, n[1] - 2)
    return slope_normal(corner_heights(terrain, w, i, j), gx - float(i), gy - float(j), cell)


@wp.func
def cast_to_surface(terrain: Terrain, w: int, start: wp.vec3, direction: wp.vec3, limit: float) -> Surface:
    """As `cast_ray`, with the normal of the surface that it meets."""
    found = Surface()
    found.t = MISS
    if terrain.mesh[w] != wp.uint64(0):
        query = wp.mesh_query_ray(terrain.mesh[w], start, direction, limit)
        if query.result:
            found.t = query.t
            found.normal = query.normal
    else:
        found.t = cast_height_field(terrain, w, start, direction, limit)
        if found.t >= 0.0:
            found.normal = field_normal(terrain, w, start + direction * found.t)
    if wp.dot(found.normal, direction) > 0.0:
        found.normal = -found.normal
    return found

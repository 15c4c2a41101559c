"""The cells around a ray, slice by slice along its main axis, and what the ray tells of each. All lengths in cells.

A ray to a measured point proves cells that it runs through to be free, and makes those within its radius likely free.
It has to pass under a cell's middle: one that passes higher may graze the ground that fills the lower half.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

THROUGH, BESIDE, HIT = wp.constant(-24), wp.constant(-8), wp.constant(20)
UNDER = wp.constant(0.1)  # of a cell: how far under a cell's middle a ray has to pass to prove it
SHORT = wp.constant(1.5)  # a ray shorter than this tells nothing


@wp.struct
class Sweep:
    """A ray from ``start`` along the unit vector ``along``; it tells nothing of the half cell before its end.

    ``main`` is the axis it follows most; its slices are ``first`` to ``last``, in which cells within ``reach`` of the
    ray are tried, ``low`` to ``high`` of each axis. A ray that tells nothing has ``last`` before ``first``.
    """

    start: wp.vec3
    along: wp.vec3
    length: float
    radius: float
    reach: float
    main: int
    first: int
    last: int
    low: wp.vec3i
    high: wp.vec3i


@wp.func
def begin_sweep(start: wp.vec3, end: wp.vec3, radius: float, low: wp.vec3i, high: wp.vec3i) -> Sweep:
    """A ray between two points, in a map whose cells go from ``low`` to ``high``."""
    sweep = Sweep()
    sweep.last = -1
    length = wp.length(end - start)
    if length < SHORT:
        return sweep
    a = (end - start) / length
    m = int(0)
    if wp.abs(a[1]) > wp.abs(a[0]):
        m = 1
    if wp.abs(a[2]) > wp.abs(a[m]):
        m = 2
    tip = start[m] + a[m] * length
    sweep.start = start
    sweep.along = a
    sweep.length = length
    sweep.radius = wp.max(radius, 0.5)
    sweep.reach = sweep.radius / wp.abs(a[m])
    sweep.main = m
    sweep.first = wp.max(int(wp.ceil(wp.min(start[m], tip) - 0.5)), low[m])
    sweep.last = wp.min(int(wp.floor(wp.max(start[m], tip) - 0.5)), high[m])
    sweep.low = low
    sweep.high = high
    return sweep


@wp.func
def span_in_slice(sweep: Sweep, s: int, axis: int) -> wp.vec2i:
    """First and last cell along an axis within reach of the ray where it crosses the middle of slice s."""
    t = (float(s) + 0.5 - sweep.start[sweep.main]) / sweep.along[sweep.main]
    centre = sweep.start[axis] + sweep.along[axis] * t
    first = int(wp.ceil(centre - sweep.reach - 0.5))
    last = int(wp.floor(centre + sweep.reach - 0.5))
    return wp.vec2i(wp.max(first, sweep.low[axis]), wp.min(last, sweep.high[axis]))


@wp.func
def from_start(sweep: Sweep, cell: wp.vec3i) -> wp.vec3:
    """From the ray's start to a cell's middle."""
    return wp.vec3(float(cell[0]) + 0.5, float(cell[1]) + 0.5, float(cell[2]) + 0.5) - sweep.start


@wp.func
def in_cylinder(sweep: Sweep, cell: wp.vec3i) -> bool:
    """Whether a cell's middle lies within the radius."""
    e = from_start(sweep, cell)
    return wp.length_sq(e - sweep.along * wp.dot(e, sweep.along)) <= sweep.radius * sweep.radius


@wp.func
def swept_evidence(sweep: Sweep, cell: wp.vec3i) -> int:
    """Log-odds, in sixteenths, that the ray gives a cell of one of its slices; 0 beyond its radius or under it."""
    e = from_start(sweep, cell)
    t = wp.dot(e, sweep.along)
    off = e - sweep.along * t
    distance2 = wp.length_sq(off)
    if off[2] < UNDER or distance2 > sweep.radius * sweep.radius or t > sweep.length - 0.5:
        return 0
    if distance2 <= 0.25:
        return THROUGH
    return BESIDE

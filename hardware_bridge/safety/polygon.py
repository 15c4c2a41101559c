"""Polygons on the ground: how far inside a point is."""

from __future__ import annotations

import math

Point = tuple[float, float]
Polygon = tuple[Point, ...]


def rectangle(x_min: float, y_min: float, x_max: float, y_max: float) -> Polygon:
    """Its corners, counter-clockwise; none where a minimum is not below its maximum."""
    if not (x_min < x_max and y_min < y_max):
        return ()
    return (x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)


def depth(corners: Polygon, point: Point) -> float:
    """Distance (m) to the nearest side, positive inside, negative outside."""
    away = min(_distance(a, b, point) for a, b in _sides(corners))
    return away if _inside(corners, point) else -away


def encloses(corners: Polygon) -> bool:
    """Whether the sides enclose ground: three or more, finite, none that meets another but at a shared corner."""
    sides = _sides(corners)
    n = len(sides)
    if n < 3 or not all(math.isfinite(value) for corner in corners for value in corner) or _area(corners) == 0.0:
        return False
    apart = [(sides[i], sides[j]) for i in range(n) for j in range(i + 2, n) if (i, j) != (0, n - 1)]
    return all(a != b for a, b in sides) and not any(_meet(*one, *other) for one, other in apart)


def _sides(corners: Polygon) -> list[tuple[Point, Point]]:
    return list(zip(corners, corners[1:] + corners[:1], strict=True))


def _area(corners: Polygon) -> float:
    """Signed, twice."""
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in _sides(corners))


def _distance(a: Point, b: Point, p: Point) -> float:
    """From a point to a side."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    along = ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy)
    along = min(1.0, max(0.0, along))
    return math.hypot(p[0] - a[0] - along * dx, p[1] - a[1] - along * dy)


def _inside(corners: Polygon, p: Point) -> bool:
    """Whether a ray from the point to the right crosses the sides an odd number of times."""
    inside = False
    for a, b in _sides(corners):
        if (a[1] > p[1]) != (b[1] > p[1]) and p[0] < a[0] + (p[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]):
            inside = not inside
    return inside


def _meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Whether two sides cross or touch."""

    def turn(p: Point, q: Point, r: Point) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    apart_cd = turn(a, b, c) * turn(a, b, d)
    apart_ab = turn(c, d, a) * turn(c, d, b)
    boxes = all(max(min(a[k], b[k]), min(c[k], d[k])) <= min(max(a[k], b[k]), max(c[k], d[k])) for k in (0, 1))
    return boxes and apart_cd <= 0 and apart_ab <= 0

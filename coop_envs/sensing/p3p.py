"""Three points at known places, seen along three known directions: the poses from which they look so.

The squared distances between the points are three quadratic forms in the depths. Two of their combinations vanish, one
combination of those two is degenerate, a pair of planes through the origin; on each plane the depths follow from a
quadratic equation. Newton steps on the distances polish them.

Source: Persson, Nordberg, "Lambda Twist: an accurate fast robust perspective three point (P3P) solver", ECCV 2018;
splitting a degenerate conic: Richter-Gebert, "Perspectives on projective geometry", 2011, section 11.1.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

NEWTON_STEPS = wp.constant(30)
POLISHING_STEPS = wp.constant(2)
ROOT_REACHED = wp.constant(wp.float64(1.0e-14))


class mat43d(wp.types.matrix(shape=(4, 3), dtype=wp.float64)):  # noqa: N801 - a Warp type, named as Warp names its own
    """Up to four solutions, one a row."""


@wp.func
def cubic_root(b: wp.float64, c: wp.float64, d: wp.float64) -> wp.float64:
    """A real root of x^3 + b x^2 + c x + d, away from a double root where there is a choice."""
    three = wp.float64(3.0)
    x = -b / three
    spread = b * b - three * c
    if spread > wp.float64(0.0):
        v = wp.sqrt(spread)
        left = (-b - v) / three
        right = (-b + v) / three
        at_left = ((left + b) * left + c) * left + d
        at_right = ((right + b) * right + c) * right + d
        if at_left > wp.float64(0.0):
            x = left - wp.sqrt(wp.max(-at_left / (three * left + b), wp.float64(0.0)))
        if at_right < wp.float64(0.0) and (at_left <= wp.float64(0.0) or -at_right > at_left):
            x = right + wp.sqrt(wp.max(-at_right / (three * right + b), wp.float64(0.0)))
    elif wp.abs((three * x + wp.float64(2.0) * b) * x + c) < wp.float64(1.0e-4):
        x = x + wp.float64(1.0)
    for _k in range(NEWTON_STEPS):
        slope = (three * x + wp.float64(2.0) * b) * x + c
        if slope == wp.float64(0.0):
            break
        step = (((x + b) * x + c) * x + d) / slope
        x = x - step
        if wp.abs(step) <= ROOT_REACHED * wp.abs(x):
            break
    return x


@wp.func
def row(m: wp.mat33d, i: int) -> wp.vec3d:
    """Row i of a matrix."""
    return wp.vec3d(m[i, 0], m[i, 1], m[i, 2])


@wp.func
def cofactors(m: wp.mat33d) -> wp.mat33d:
    """Adjugate of a symmetric matrix."""
    return wp.matrix_from_rows(
        wp.cross(row(m, 1), row(m, 2)), wp.cross(row(m, 2), row(m, 0)), wp.cross(row(m, 0), row(m, 1))
    )


@wp.func
def degenerate(first: wp.mat33d, second: wp.mat33d) -> wp.vec2d:
    """Weights (w1, w2), the larger 1 or both below it, of a singular combination of two symmetric matrices."""
    of_first = cofactors(first)
    of_second = cofactors(second)
    c0 = wp.dot(row(first, 0), row(of_first, 0))
    c1 = wp.ddot(of_first, second)
    c2 = wp.ddot(of_second, first)
    c3 = wp.dot(row(second, 0), row(of_second, 0))
    if wp.abs(c3) >= wp.abs(c0):
        return wp.vec2d(wp.float64(1.0), cubic_root(c2 / c3, c1 / c3, c0 / c3))
    return wp.vec2d(cubic_root(c1 / c0, c2 / c0, c3 / c0), wp.float64(1.0))


@wp.func
def plane_pair(conic: wp.mat33d) -> wp.mat33d:
    """C = 2 l m^T of a degenerate conic l m^T + m l^T; zero where the planes l and m are not real."""
    adjugate = cofactors(conic)
    i = int(0)
    for k in range(1, 3):
        if wp.abs(adjugate[k, k]) > wp.abs(adjugate[i, i]):
            i = k
    if adjugate[i, i] >= wp.float64(0.0):
        return wp.mat33d()
    return conic + wp.skew(row(adjugate, i) / wp.sqrt(-adjugate[i, i]))


@wp.func
def polished(depths: wp.vec3d, square: wp.vec3d, cosine: wp.vec3d) -> wp.vec3d:
    """Newton steps on the three squared distances."""
    d = depths
    for _k in range(POLISHING_STEPS):
        e = wp.vec3d(
            d[0] * d[0] + d[1] * d[1] - wp.float64(2.0) * cosine[0] * d[0] * d[1] - square[0],
            d[0] * d[0] + d[2] * d[2] - wp.float64(2.0) * cosine[1] * d[0] * d[2] - square[1],
            d[1] * d[1] + d[2] * d[2] - wp.float64(2.0) * cosine[2] * d[1] * d[2] - square[2],
        ) * wp.float64(0.5)
        a1 = d[0] - cosine[0] * d[1]
        a2 = d[1] - cosine[0] * d[0]
        b1 = d[0] - cosine[1] * d[2]
        b3 = d[2] - cosine[1] * d[0]
        c2 = d[1] - cosine[2] * d[2]
        c3 = d[2] - cosine[2] * d[1]
        det = -a1 * b3 * c2 - a2 * b1 * c3
        if det == wp.float64(0.0):
            return d
        x = (-b3 * c2 * e[0] - a2 * c3 * e[1] + a2 * b3 * e[2]) / det
        y = (-b1 * c3 * e[0] + a1 * c3 * e[1] - a1 * b3 * e[2]) / det
        z = (b1 * c2 * e[0] - a1 * c2 * e[1] - a2 * b1 * e[2]) / det
        d = d - wp.vec3d(x, y, z)
    return d


@wp.func
def all_ahead(d: wp.vec3d) -> bool:
    """Whether all depths are positive."""
    zero = wp.float64(0.0)
    return d[0] > zero and d[1] > zero and d[2] > zero


@wp.func
def largest(m: wp.mat33d) -> wp.vec2i:
    """Row and column of the entry that is largest in size."""
    i = int(0)
    j = int(0)
    for r in range(3):
        for c in range(3):
            if wp.abs(m[r, c]) > wp.abs(m[i, j]):
                i = r
                j = c
    return wp.vec2i(i, j)


@wp.func
def scaled(direction: wp.vec3d, square: wp.vec3d, cosine: wp.vec3d) -> wp.vec3d:
    """Depths from their ratios; zero where they cannot all be positive."""
    d = direction
    if d[0] < wp.float64(0.0):
        d = -d
    two = wp.float64(2.0)
    cross = cosine[0] * d[0] * d[1] + cosine[1] * d[0] * d[2] + cosine[2] * d[1] * d[2]
    s = two * (wp.dot(d, d) - cross)
    if not (all_ahead(d) and s > wp.float64(0.0)):
        return wp.vec3d()
    d = polished(d * wp.sqrt((square[0] + square[1] + square[2]) / s), square, cosine)
    if all_ahead(d):
        return d
    return wp.vec3d()


@wp.func
def depths_on_plane(conic: wp.mat33d, normal: wp.vec3d, square: wp.vec3d, cosine: wp.vec3d) -> mat43d:
    """Depths on a plane through the origin where a quadratic form vanishes: none, one or two rows."""
    found = mat43d()
    n = wp.normalize(normal)
    e = wp.vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
    if wp.abs(n[0]) > wp.float64(0.6):
        e = wp.vec3d(wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
    g = wp.normalize(wp.cross(n, e))
    h = wp.cross(n, g)
    a = wp.dot(g, conic * g)
    b = wp.dot(h, conic * g)
    c = wp.dot(h, conic * h)
    under = b * b - a * c
    if not under >= wp.float64(0.0):
        return found
    q = -b - wp.sqrt(under)
    if b < wp.float64(0.0):
        q = -b + wp.sqrt(under)
    found[0] = scaled(g * q + h * a, square, cosine)
    found[1] = scaled(g * c + h * q, square, cosine)
    return found


@wp.func
def p3p_depths(square: wp.vec3d, cosine: wp.vec3d) -> mat43d:
    """Depths of points 1, 2, 3 along their rays; rows of zeros where there are fewer than four solutions.

    ``square`` holds the squared distances between points 12, 13, 23, ``cosine`` the cosines between their rays.
    """
    found = mat43d()
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    a = square[0] / square[2]
    b = square[1] / square[2]
    D1 = wp.mat33d(one, -cosine[0], zero, -cosine[0], one - a, a * cosine[2], zero, a * cosine[2], -a)
    D2 = wp.mat33d(one, zero, -cosine[1], zero, -b, b * cosine[2], -cosine[1], b * cosine[2], one - b)
    weight = degenerate(D1, D2)
    planes = plane_pair(D1 * weight[0] + D2 * weight[1])
    conic = D2
    if weight[0] * weight[0] <= weight[1] * weight[1]:
        conic = D1
    at = largest(planes)
    if not planes[at[0], at[1]] * planes[at[0], at[1]] > zero:
        return found
    column = wp.vec3d(planes[0, at[1]], planes[1, at[1]], planes[2, at[1]])
    one_side = depths_on_plane(conic, row(planes, at[0]), square, cosine)
    other_side = depths_on_plane(conic, column, square, cosine)
    for s in range(2):
        for c in range(3):
            found[s, c] = one_side[s, c]
            found[2 + s, c] = other_side[s, c]
    return found


@wp.func
def triad(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.mat33d:
    """Right-handed axes, as columns, of the triangle a b c."""
    x = wp.normalize(b - a)
    z = wp.normalize(wp.cross(b - a, c - a))
    return wp.matrix_from_cols(x, wp.cross(z, x), z)

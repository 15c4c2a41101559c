"""What a set of LED pixels says about a pose: derivatives, Fisher information, covariance.

The error of a relative pose is (theta, delta) in camera axes: R = Exp(theta) R_true, p = p_true + delta.

Source: thesis eq (5.7), with each LED's own pixel noise in place of one pixel.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

from coop_envs.sensing.camera import CameraModel

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


class mat66d(wp.types.matrix(shape=(6, 6), dtype=wp.float64)):  # noqa: N801 - a Warp type, named as Warp names its own
    """Six by six numbers in double precision."""


class vec6d(wp.types.vector(length=6, dtype=wp.float64)):  # noqa: N801
    """Six numbers in double precision."""


@wp.struct
class LedRows:
    """Where an LED's pixel ``uv`` should be, and the derivatives of u and v by the pose's error (theta, delta)."""

    uv: wp.vec2d
    u: vec6d
    v: vec6d


@wp.func
def led_rows(camera: CameraModel, arm: wp.vec3d, position: wp.vec3d) -> LedRows:
    """An LED at ``arm + position`` before the camera; ``arm`` is R_camera_body times its body position."""
    out = LedRows()
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    six = wp.float64(6.0)
    k1 = wp.float64(camera.radial[0])
    k2 = wp.float64(camera.radial[1])
    k3 = wp.float64(camera.radial[2])
    p1 = wp.float64(camera.tangential[0])
    p2 = wp.float64(camera.tangential[1])
    fx = wp.float64(camera.focal[0])
    fy = wp.float64(camera.focal[1])
    iz = one / (arm[2] + position[2])
    x = (arm[0] + position[0]) * iz
    y = (arm[1] + position[1]) * iz
    r2 = x * x + y * y
    radial = one + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = two * (k1 + r2 * (two * k2 + r2 * wp.float64(3.0) * k3))
    xd = x * radial + two * p1 * x * y + p2 * (r2 + two * x * x)
    yd = y * radial + p1 * (r2 + two * y * y) + two * p2 * x * y
    a = radial + x * x * slope + two * p1 * y + six * p2 * x
    b = x * y * slope + two * (p1 * x + p2 * y)
    d = radial + y * y * slope + two * p2 * x + six * p1 * y
    gu = wp.vec3d(a, b, -(a * x + b * y)) * (fx * iz)
    gv = wp.vec3d(b, d, -(b * x + d * y)) * (fy * iz)
    tu = wp.cross(arm, gu)
    tv = wp.cross(arm, gv)
    out.uv = wp.vec2d(fx * xd + wp.float64(camera.centre[0]), fy * yd + wp.float64(camera.centre[1]))
    out.u = vec6d(tu[0], tu[1], tu[2], gu[0], gu[1], gu[2])
    out.v = vec6d(tv[0], tv[1], tv[2], gv[0], gv[1], gv[2])
    return out


@wp.func
def information_of(rows: LedRows, weight: wp.float64) -> mat66d:
    """Information of an LED whose pixel has the variance 1 / ``weight`` along both axes."""
    return (wp.outer(rows.u, rows.u) + wp.outer(rows.v, rows.v)) * weight


@wp.func
def cholesky6(a: mat66d) -> mat66d:
    """Lower Cholesky factor; its [0, 0] is 0 where the matrix is not positive definite."""
    low = mat66d()
    for i in range(6):
        for j in range(i + 1):
            s = a[i, j]
            for k in range(j):
                s = s - low[i, k] * low[j, k]
            if i == j:
                if s <= wp.float64(0.0):
                    low[0, 0] = wp.float64(0.0)
                    return low
                low[i, i] = wp.sqrt(s)
            else:
                low[i, j] = s / low[j, j]
    return low


@wp.func
def solve_cholesky6(low: mat66d, right: vec6d) -> vec6d:
    """x of L L^T x = right."""
    x = right
    for i in range(6):
        s = x[i]
        for k in range(i):
            s = s - low[i, k] * x[k]
        x[i] = s / low[i, i]
    for back in range(6):
        i = 5 - back
        s = x[i]
        for k in range(i + 1, 6):
            s = s - low[k, i] * x[k]
        x[i] = s / low[i, i]
    return x


@wp.func
def inverse_from_cholesky6(low: mat66d) -> mat66d:
    """(L L^T)^-1."""
    inv = mat66d()
    for c in range(6):
        for i in range(c, 6):
            s = wp.float64(0.0)
            if i == c:
                s = wp.float64(1.0)
            for k in range(c, i):
                s = s - low[i, k] * inv[k, c]
            inv[i, c] = s / low[i, i]
    return wp.transpose(inv) * inv

"""What a set of LED pixels says about a pose: Fisher information, covariance, a draw from it.

The error of a relative pose is (theta, delta) in camera axes: R = Exp(theta) R_true, p = p_true + delta.

Source: thesis eq (5.7), with each LED's own pixel noise in place of one pixel.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


class mat66d(wp.types.matrix(shape=(6, 6), dtype=wp.float64)):  # noqa: N801 - a Warp type, named as Warp names its own
    """Six by six numbers in double precision."""


class vec6d(wp.types.vector(length=6, dtype=wp.float64)):  # noqa: N801
    """Six numbers in double precision."""


@wp.func
def led_information(focal: wp.vec2, arm: wp.vec3, position: wp.vec3, noise_px: float) -> mat66d:
    """Information of an LED at ``arm + position`` in the camera; ``arm`` is R_camera_body times its body position."""
    p = arm + position
    z = wp.float64(p[2])
    fx = wp.float64(focal[0]) / z
    fy = wp.float64(focal[1]) / z
    x = wp.float64(p[0]) / z
    y = wp.float64(p[1]) / z
    ax = wp.float64(arm[0])
    ay = wp.float64(arm[1])
    az = wp.float64(arm[2])
    weight = wp.float64(1.0) / (wp.float64(noise_px) * wp.float64(noise_px))
    zero = wp.float64(0.0)
    u = vec6d(-fx * x * ay, fx * (az + x * ax), -fx * ay, fx, zero, -fx * x)
    v = vec6d(-fy * (az + y * ay), fy * y * ax, fy * ax, zero, fy, -fy * y)
    return wp.outer(u, u) * weight + wp.outer(v, v) * weight


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

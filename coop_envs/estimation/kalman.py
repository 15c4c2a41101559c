# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.
"""Kalman updates of the team filter with up to six rows, gated.

Only H P is formed; the covariance falls by N^T N with N = L^-1 H P and S = L L^T, so that it stays symmetric.
"""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import ACCEL, GYRO, POSITION, THETA, VELOCITY, Belief
from coop_envs.estimation.propagation import block3
from coop_envs.geometry.so3 import exp_so3, orthonormal
from coop_envs.sensing.poses import cholesky6, mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

GATE_ONE = wp.constant(wp.float64(6.63))
GATE_SIX = wp.constant(wp.float64(22.46))
NO_GATE = wp.constant(wp.float64(1.0e30))


@wp.func
def row_times_covariance(
    belief: Belief, rows: wp.array3d[wp.float64], b: int, m: int, block: wp.mat33d, column: int,
    first: int, last: int,
):  # fmt: skip
    """rows[m .. m+2] += block P[column .. column+2], columns ``first`` up to ``last``."""
    for c in range(first, last):
        x = block * block3(belief.covariance, b, column, c)
        for k in range(3):
            rows[b, m + k, c] = rows[b, m + k, c] + x[k]


@wp.func
def clear_rows(rows: wp.array3d[wp.float64], b: int, count: int, first: int, last: int):
    """Set columns ``first`` up to ``last`` to zero."""
    for m in range(count):
        for c in range(first, last):
            rows[b, m, c] = wp.float64(0.0)


@wp.func
def add_to_innovation(
    S: mat66d, rows: wp.array3d[wp.float64], b: int, count: int, m: int, block: wp.mat33d, column: int
) -> mat66d:
    """S[:, m .. m+2] += rows[:, column .. column+2] block^T."""
    out = S
    for i in range(count):
        x = block * wp.vec3d(rows[b, i, column], rows[b, i, column + 1], rows[b, i, column + 2])
        for k in range(3):
            out[i, m + k] = out[i, m + k] + x[k]
    return out


@wp.func
def whitened(L: mat66d, residual: vec6d, count: int) -> vec6d:
    """L^-1 times the residual; its squared length is what the gate compares."""
    y = vec6d()
    for m in range(count):
        s = residual[m]
        for k in range(m):
            s = s - L[m, k] * y[k]
        y[m] = s / L[m, m]
    return y


@wp.func
def correct(
    belief: Belief, rows: wp.array3d[wp.float64], b: int, count: int, S: mat66d, residual: vec6d, gate: wp.float64
) -> bool:
    """Kalman update with ``rows`` = H P and innovation covariance S; False, and nothing done, beyond the gate.

    Unused rows of S must be those of the identity. With S = L L^T and N = L^-1 H P, P falls by N^T N.
    """
    size = 15 * belief.slots[b]
    L = cholesky6(S)
    if L[0, 0] <= wp.float64(0.0):
        return False
    y = whitened(L, residual, count)
    if wp.dot(y, y) > gate:
        return False
    for m in range(count):
        inverse = wp.float64(1.0) / L[m, m]
        for c in range(size):
            s = rows[b, m, c]
            for k in range(m):
                s = s - L[m, k] * rows[b, k, c]
            rows[b, m, c] = s * inverse
    for i in range(size):
        n = vec6d()
        for m in range(count):
            n[m] = rows[b, m, i]
        for c in range(i + 1):
            s = belief.covariance[b, i, c]
            for m in range(count):
                s = s - n[m] * rows[b, m, c]
            belief.covariance[b, i, c] = s
            belief.covariance[b, c, i] = s
    for r in range(belief.slot.shape[1]):
        if belief.slot[b, r] >= 0:
            shift_state(belief, rows, b, r, count, y)
    return True


@wp.func
def gain3(rows: wp.array3d[wp.float64], b: int, count: int, y: vec6d, column: int) -> wp.vec3d:
    """Three entries of the state correction N^T y."""
    d = wp.vec3d()
    for m in range(count):
        d = d + wp.vec3d(rows[b, m, column], rows[b, m, column + 1], rows[b, m, column + 2]) * y[m]
    return d


@wp.func
def shift_state(belief: Belief, rows: wp.array3d[wp.float64], b: int, r: int, count: int, y: vec6d):
    """Apply the correction N^T y to robot r."""
    o = 15 * belief.slot[b, r]
    belief.rotation[b, r] = orthonormal(exp_so3(gain3(rows, b, count, y, o + THETA)) * belief.rotation[b, r])
    belief.position[b, r] = belief.position[b, r] + gain3(rows, b, count, y, o + POSITION)
    belief.velocity[b, r] = belief.velocity[b, r] + gain3(rows, b, count, y, o + VELOCITY)
    belief.gyro_bias[b, r] = belief.gyro_bias[b, r] + gain3(rows, b, count, y, o + GYRO)
    belief.accel_bias[b, r] = belief.accel_bias[b, r] + gain3(rows, b, count, y, o + ACCEL)


@wp.func
def correct_pair(
    belief: Belief, rows: wp.array3d[wp.float64], b: int, A: wp.mat33d, a: int, B: wp.mat33d, c: int,
    residual: wp.vec3d, variance: wp.vec3d, gate: wp.float64,
) -> bool:  # fmt: skip
    """Update with three rows, A at column a and B at column c."""
    size = 15 * belief.slots[b]
    clear_rows(rows, b, 3, 0, size)
    row_times_covariance(belief, rows, b, 0, A, a, 0, size)
    row_times_covariance(belief, rows, b, 0, B, c, 0, size)
    noise = wp.identity(n=6, dtype=wp.float64)
    for k in range(3):
        noise[k, k] = variance[k]
    half = add_to_innovation(noise, rows, b, 3, 0, A, a)
    S = add_to_innovation(half, rows, b, 3, 0, B, c)
    zero = wp.float64(0.0)
    return correct(belief, rows, b, 3, S, vec6d(residual[0], residual[1], residual[2], zero, zero, zero), gate)

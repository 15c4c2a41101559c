# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.
"""Kalman updates of the team filter with three or six rows, gated.

Only H P is formed; the covariance falls by N^T N with N = L^-1 H P and S = L L^T, either at once or, when several
sightings follow each other, for all of them in one pass. It stays symmetric to the last bit.
"""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import ACCEL, GYRO, POSITION, THETA, VELOCITY, Belief, vec15d
from coop_envs.estimation.rows import Rows
from coop_envs.geometry.so3 import exp_so3, orthonormal
from coop_envs.sensing.poses import mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

GATE_ONE = wp.constant(wp.float64(6.63))
FEW_SLOTS = wp.constant(8)
GATE_SIX = wp.constant(wp.float64(22.46))


@wp.func
def row3(rows: Rows, b: int, m: int, column: int) -> wp.vec3d:
    """Three entries of a projected row."""
    return wp.vec3d(rows.entries[b, m, column], rows.entries[b, m, column + 1], rows.entries[b, m, column + 2])


@wp.func
def kept3(rows: Rows, b: int, p: int, column: int) -> wp.vec3d:
    """Three entries of a kept row."""
    entries = rows.kept_entries
    return wp.vec3d(entries[b, p, column], entries[b, p, column + 1], entries[b, p, column + 2])


@wp.func
def inverse_factor(S: wp.mat33d) -> wp.mat33d:
    """L^-1 of S = L L^T, from S's lower triangle; its [0, 0] is 0 where S is not positive definite."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    if not S[0, 0] > zero:
        return wp.mat33d()
    a = one / wp.sqrt(S[0, 0])
    l10 = S[1, 0] * a
    l20 = S[2, 0] * a
    d1 = S[1, 1] - l10 * l10
    if not d1 > zero:
        return wp.mat33d()
    c = one / wp.sqrt(d1)
    l21 = (S[2, 1] - l20 * l10) * c
    d2 = S[2, 2] - l20 * l20 - l21 * l21
    if not d2 > zero:
        return wp.mat33d()
    f = one / wp.sqrt(d2)
    i10 = -l10 * a * c
    return wp.mat33d(a, zero, zero, i10, c, zero, -(l20 * a + l21 * i10) * f, -l21 * c * f, f)


@wp.func
def weigh(rows: Rows, b: int, first: int, slots: int, factor: wp.mat33d):
    """Multiply three projected rows by a lower triangular factor."""
    for s in range(slots):
        x = rows.projected[b, first, s]
        y = rows.projected[b, first + 1, s]
        z = rows.projected[b, first + 2, s]
        rows.projected[b, first, s] = x * factor[0, 0]
        rows.projected[b, first + 1, s] = x * factor[1, 0] + y * factor[1, 1]
        rows.projected[b, first + 2, s] = x * factor[2, 0] + y * factor[2, 1] + z * factor[2, 2]


@wp.func
def deduct(rows: Rows, b: int, slots: int, block: wp.mat33d):
    """Projected rows 3 to 5 fall by a block times rows 0 to 2."""
    for s in range(slots):
        x = rows.projected[b, 0, s]
        y = rows.projected[b, 1, s]
        z = rows.projected[b, 2, s]
        for k in range(3):
            fallen = rows.projected[b, 3 + k, s] - x * block[k, 0] - y * block[k, 1] - z * block[k, 2]
            rows.projected[b, 3 + k, s] = fallen


@wp.func
def fall_by_three(rows: Rows, b: int, slots: int):
    """P falls by N^T N of three projected rows."""
    for s in range(slots):
        n0 = rows.projected[b, 0, s]
        n1 = rows.projected[b, 1, s]
        n2 = rows.projected[b, 2, s]
        for i in range(15 * slots):
            n = column3(rows, b, 0, i)
            rows.covariance[b, i, s] = rows.covariance[b, i, s] - n0 * n[0] - n1 * n[1] - n2 * n[2]


@wp.func
def column3(rows: Rows, b: int, m: int, column: int) -> wp.vec3d:
    """One column's entries of three projected rows."""
    return wp.vec3d(rows.entries[b, m, column], rows.entries[b, m + 1, column], rows.entries[b, m + 2, column])


@wp.func
def correct_three(belief: Belief, rows: Rows, b: int, S: wp.mat33d, residual: wp.vec3d) -> bool:
    """Kalman update with three projected rows and the innovation covariance S; False, and nothing done, without one."""
    slots = belief.slots[b]
    factor = inverse_factor(S)
    if factor[0, 0] == wp.float64(0.0):
        return False
    weigh(rows, b, 0, slots, factor)
    fall_by_three(rows, b, slots)
    y = factor * residual
    for r in range(belief.slot.shape[1]):
        slot = belief.slot[b, r]
        if slot >= 0:
            shift_state(belief, b, r, gain(rows, b, 0, slot, y))
    for k in range(belief.calibration.shape[1]):
        belief.calibration[b, k] = belief.calibration[b, k] + gain(rows, b, 0, k, y)
    return True


@wp.struct
class Whitening:
    """L^-1 of a 6 x 6 S = L L^T: the inverses of L's diagonal blocks, the block under them, and whether there is one.

    ``y`` is L^-1 times the residual; its squared length is what the gate compares.
    """

    upper: wp.mat33d
    lower: wp.mat33d
    between: wp.mat33d
    definite: int
    first: wp.vec3d
    last: wp.vec3d


@wp.func
def corner(S: mat66d, i: int, j: int) -> wp.mat33d:
    """The 3 x 3 block of S whose first entry is (i, j)."""
    return wp.mat33d(
        S[i, j], S[i, j + 1], S[i, j + 2],
        S[i + 1, j], S[i + 1, j + 1], S[i + 1, j + 2],
        S[i + 2, j], S[i + 2, j + 1], S[i + 2, j + 2],
    )  # fmt: skip


@wp.func
def whitening(S: mat66d, residual: vec6d) -> Whitening:
    """Factor S and apply it to a residual."""
    out = Whitening()
    out.upper = inverse_factor(corner(S, 0, 0))
    out.between = corner(S, 3, 0) * wp.transpose(out.upper)
    out.lower = inverse_factor(corner(S, 3, 3) - out.between * wp.transpose(out.between))
    out.definite = int(out.upper[0, 0] > wp.float64(0.0) and out.lower[0, 0] > wp.float64(0.0))
    out.first = out.upper * wp.vec3d(residual[0], residual[1], residual[2])
    out.last = out.lower * (wp.vec3d(residual[3], residual[4], residual[5]) - out.between * out.first)
    return out


@wp.func
def passes(white: Whitening, gate: wp.float64) -> bool:
    """Whether a whitened residual is within the gate."""
    return white.definite == 1 and wp.length_sq(white.first) + wp.length_sq(white.last) <= gate


@wp.func
def settle(rows: Rows, b: int, slots: int):
    """Let P fall by the rows that are kept: of a large team its upper blocks, which are then mirrored."""
    pending = rows.pending[b]
    rows.pending[b] = 0
    last = 15 * slots
    for s in range(slots):
        if slots > FEW_SLOTS:
            last = 15 * (s + 1)
        for i in range(last):
            entry = rows.covariance[b, i, s]
            for p in range(pending):
                entry = entry - rows.kept[b, p, s] * rows.kept_entries[b, p, i]
            rows.covariance[b, i, s] = entry
    if slots <= FEW_SLOTS:
        return
    for s in range(slots):
        for r in range(s):
            for k in range(15):
                mirrored = vec15d()
                for c in range(15):
                    mirrored[c] = rows.covariance[b, 15 * r + c, s][k]
                rows.covariance[b, 15 * s + k, r] = mirrored


@wp.func
def keep_six(belief: Belief, rows: Rows, b: int, white: Whitening):
    """Kalman update with six projected rows; P falls by them when `settle` is called, or for want of room."""
    slots = belief.slots[b]
    weigh(rows, b, 0, slots, white.upper)
    deduct(rows, b, slots, white.between)
    weigh(rows, b, 3, slots, white.lower)
    if rows.pending[b] + 6 > rows.kept.shape[1]:
        settle(rows, b, slots)
    first = rows.pending[b]
    for m in range(6):
        for s in range(slots):
            rows.kept[b, first + m, s] = rows.projected[b, m, s]
    rows.pending[b] = first + 6
    for r in range(belief.slot.shape[1]):
        slot = belief.slot[b, r]
        if slot >= 0:
            shift_state(belief, b, r, gain(rows, b, 0, slot, white.first) + gain(rows, b, 3, slot, white.last))
    for k in range(belief.calibration.shape[1]):
        shift = gain(rows, b, 0, k, white.first) + gain(rows, b, 3, k, white.last)
        belief.calibration[b, k] = belief.calibration[b, k] + shift


@wp.func
def correct_six(belief: Belief, rows: Rows, b: int, white: Whitening):
    """Kalman update with six projected rows."""
    keep_six(belief, rows, b, white)
    settle(rows, b, belief.slots[b])


@wp.func
def gain(rows: Rows, b: int, m: int, slot: int, y: wp.vec3d) -> vec15d:
    """What three projected rows add to the state correction N^T y of a slot."""
    x = rows.projected[b, m, slot] * y[0]
    return x + rows.projected[b, m + 1, slot] * y[1] + rows.projected[b, m + 2, slot] * y[2]


@wp.func
def part(d: vec15d, first: int) -> wp.vec3d:
    """Three of fifteen numbers."""
    return wp.vec3d(d[first], d[first + 1], d[first + 2])


@wp.func
def shift_state(belief: Belief, b: int, r: int, d: vec15d):
    """Apply a correction to robot r."""
    belief.rotation[b, r] = orthonormal(exp_so3(part(d, THETA)) * belief.rotation[b, r])
    belief.position[b, r] = belief.position[b, r] + part(d, POSITION)
    belief.velocity[b, r] = belief.velocity[b, r] + part(d, VELOCITY)
    belief.gyro_bias[b, r] = belief.gyro_bias[b, r] + part(d, GYRO)
    belief.accel_bias[b, r] = belief.accel_bias[b, r] + part(d, ACCEL)


@wp.func
def times_rows(rows: Rows, b: int, block: wp.mat33d, k: int, row: int, s: int) -> vec15d:
    """Row k of block P[row .. row+2], the entries of slot s."""
    x = rows.covariance[b, row, s] * block[k, 0]
    return x + rows.covariance[b, row + 1, s] * block[k, 1] + rows.covariance[b, row + 2, s] * block[k, 2]


@wp.func
def correct_pair(
    belief: Belief, rows: Rows, b: int, A: wp.mat33d, a: int, B: wp.mat33d, c: int,
    residual: wp.vec3d, variance: wp.vec3d,
) -> bool:  # fmt: skip
    """Update with three rows, A at column a and B at column c."""
    for s in range(belief.slots[b]):
        for k in range(3):
            rows.projected[b, k, s] = times_rows(rows, b, A, k, a, s) + times_rows(rows, b, B, k, c, s)
    S = wp.diag(variance)
    for k in range(3):
        column = A * row3(rows, b, k, a) + B * row3(rows, b, k, c)
        for i in range(3):
            S[k, i] = S[k, i] + column[i]
    return correct_three(belief, rows, b, S, residual)

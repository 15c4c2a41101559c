"""Measurement updates of the team filter: LED poses, wheel odometry, rest.

Relative pose of robot j from the camera C of robot i, with residuals in camera axes (theta, p):

    p_hat = R_CG (p_j - p_i) - R_CB p_BC        dp = R_CG ([p_j - p_i]x theta_i - dp_i + dp_j)
    R_hat = R_CG R_j                            dtheta = R_CG (theta_j - theta_i)

Source: thesis eqs (5.11)-(5.13), corrected (the lever arm belongs in the body frame and not into the rotation block)
and written for Hamilton rotations with R = Exp(theta) R_hat.
"""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import ACCEL, GYRO, POSITION, THETA, VELOCITY, WORKING, Belief, MemberModel
from coop_envs.estimation.propagation import FilterModel, add_diagonal, block3
from coop_envs.geometry.so3 import exp_so3, log_so3, orthonormal
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import cholesky6, mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

GATE_POSE = wp.constant(wp.float64(22.46))
GATE_THREE = wp.constant(wp.float64(16.27))
NO_GATE = wp.constant(wp.float64(1.0e30))
ENOUGH_SIGHTINGS = wp.constant(25)
REJECTIONS = wp.constant(3)
REST_SETTLED_S = wp.constant(2.0)
REST_EVERY = wp.constant(10)
SPINNING_S = wp.constant(0.7)
ODOMETRY_FLOOR_M_S = wp.constant(0.004)


@wp.func
def row_times_covariance(
    belief: Belief, rows: wp.array3d(dtype=wp.float64), b: int, m: int, block: wp.mat33d, column: int, size: int
):
    """rows[m .. m+2] += block P[column .. column+2]."""
    for c in range(size):
        x = block * block3(belief.covariance, b, column, c)
        for k in range(3):
            rows[b, m + k, c] = rows[b, m + k, c] + x[k]


@wp.func
def clear_rows(rows: wp.array3d(dtype=wp.float64), b: int, count: int, size: int):
    for m in range(count):
        for c in range(size):
            rows[b, m, c] = wp.float64(0.0)


@wp.func
def add_to_innovation(
    S: mat66d, rows: wp.array3d(dtype=wp.float64), b: int, count: int, m: int, block: wp.mat33d, column: int
) -> mat66d:
    """S[:, m .. m+2] += rows[:, column .. column+2] block^T."""
    out = S
    for i in range(count):
        x = block * wp.vec3d(rows[b, i, column], rows[b, i, column + 1], rows[b, i, column + 2])
        for k in range(3):
            out[i, m + k] = out[i, m + k] + x[k]
    return out


@wp.func
def correct(
    belief: Belief, rows: wp.array3d(dtype=wp.float64), b: int, count: int, S: mat66d, residual: vec6d, gate: wp.float64
) -> bool:
    """Kalman update with ``rows`` = H P and innovation covariance S; False, and nothing done, beyond the gate.

    Unused rows of S must be those of the identity. With S = L L^T and N = L^-1 H P, P falls by N^T N.
    """
    size = 15 * belief.slots[b]
    L = cholesky6(S)
    if L[0, 0] <= wp.float64(0.0):
        return False
    y = vec6d()
    for m in range(count):
        s = residual[m]
        for k in range(m):
            s = s - L[m, k] * y[k]
        y[m] = s / L[m, m]
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
def gain3(rows: wp.array3d(dtype=wp.float64), b: int, count: int, y: vec6d, column: int) -> wp.vec3d:
    """Three entries of the state correction N^T y."""
    d = wp.vec3d()
    for m in range(count):
        d = d + wp.vec3d(rows[b, m, column], rows[b, m, column + 1], rows[b, m, column + 2]) * y[m]
    return d


@wp.func
def shift_state(belief: Belief, rows: wp.array3d(dtype=wp.float64), b: int, r: int, count: int, y: vec6d):
    """Apply the correction N^T y to robot r."""
    o = 15 * belief.slot[b, r]
    belief.rotation[b, r] = orthonormal(exp_so3(gain3(rows, b, count, y, o + THETA)) * belief.rotation[b, r])
    belief.position[b, r] = belief.position[b, r] + gain3(rows, b, count, y, o + POSITION)
    belief.velocity[b, r] = belief.velocity[b, r] + gain3(rows, b, count, y, o + VELOCITY)
    belief.gyro_bias[b, r] = belief.gyro_bias[b, r] + gain3(rows, b, count, y, o + GYRO)
    belief.accel_bias[b, r] = belief.accel_bias[b, r] + gain3(rows, b, count, y, o + ACCEL)


@wp.func
def correct_pair(
    belief: Belief, rows: wp.array3d(dtype=wp.float64), b: int, A: wp.mat33d, a: int, B: wp.mat33d, c: int,
    residual: wp.vec3d, variance: wp.vec3d, gate: wp.float64,
) -> bool:  # fmt: skip
    """Update with three rows, A at column a and B at column c."""
    size = 15 * belief.slots[b]
    clear_rows(rows, b, 3, size)
    row_times_covariance(belief, rows, b, 0, A, a, size)
    row_times_covariance(belief, rows, b, 0, B, c, size)
    S = wp.identity(n=6, dtype=wp.float64)
    for k in range(3):
        S[k, k] = variance[k]
    S = add_to_innovation(S, rows, b, 3, 0, A, a)
    S = add_to_innovation(S, rows, b, 3, 0, B, c)
    zero = wp.float64(0.0)
    return correct(belief, rows, b, 3, S, vec6d(residual[0], residual[1], residual[2], zero, zero, zero), gate)


@wp.func
def correct_rest(
    belief: Belief, measured: Measurements, member: MemberModel, model: FilterModel, rows: wp.array3d(dtype=wp.float64),
    b: int, r: int,
):  # fmt: skip
    """A robot at rest has no velocity, its gyro shows its bias, its accelerometer shows gravity."""
    o = 15 * belief.slot[b, r]
    eye = wp.identity(n=3, dtype=wp.float64)
    none = wp.mat33d()
    one = wp.vec3d(wp.float64(1.0), wp.float64(1.0), wp.float64(1.0))
    ticks = measured.gyro.shape[2]
    turn = wp.vec3d()
    force = wp.vec3d()
    for t in range(ticks):
        turn = turn + wp.vec3d(measured.gyro[b, r, t]) / wp.float64(ticks)
        force = force + wp.vec3d(measured.accel[b, r, t]) / wp.float64(ticks)
    span = model.tick_s * wp.float64(ticks)
    still = one * wp.float64(1.0e-6)
    correct_pair(belief, rows, b, eye, o + VELOCITY, none, o + THETA, -belief.velocity[b, r], still, NO_GATE)
    gyro_variance = one * (member.gyro_noise * member.gyro_noise / span)
    correct_pair(belief, rows, b, eye, o + GYRO, none, o + THETA, turn - belief.gyro_bias[b, r], gyro_variance, NO_GATE)
    up = wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(9.81))
    Rt = wp.transpose(belief.rotation[b, r])
    expected = Rt * up + belief.accel_bias[b, r]
    accel_variance = one * (member.accel_noise * member.accel_noise / span)
    correct_pair(
        belief, rows, b, Rt * wp.skew(up), o + THETA, eye, o + ACCEL, force - expected, accel_variance, NO_GATE
    )


@wp.func
def correct_odometry(
    belief: Belief, measured: Measurements, member: MemberModel, model: FilterModel, rows: wp.array3d(dtype=wp.float64),
    b: int, r: int,
):  # fmt: skip
    """Wheels give the body's mean forward speed over the decision and say that it moves neither sideways nor up.

    Both sides slip on their own, and slip wanders slower than decisions follow each other, so its variance counts
    2 tau / T times. Not in the thesis, whose filter has no odometry: it bounds the IMU's drift while no landmark is in
    sight. A spinning wheel on a trapped robot is thrown out by the gate, and not listened to once a camera has seen it
    spin in vain.
    """
    o = 15 * belief.slot[b, r]
    rim = measured.wheels[b, r] * member.wheel_radius
    speed = 0.5 * (rim[0] + rim[1])
    slip = member.slip * wp.sqrt(2.0 * member.slip_time / model.decision_s)
    share = wp.sqrt(slip * slip + member.odometry_noise * member.odometry_noise)
    noise = wp.float64((ODOMETRY_FLOOR_M_S + share * 0.5 * wp.length(rim)) * model.odometry_scale)
    Rt = wp.transpose(belief.rotation[b, r])
    v = belief.velocity[b, r]
    zero = wp.float64(0.0)
    residual = wp.vec3d(wp.float64(speed), zero, zero) - (Rt * v - belief.lag[b, r])
    variance = wp.vec3d(noise * noise, noise * noise, noise * noise)
    correct_pair(belief, rows, b, Rt * wp.skew(v), o + THETA, Rt, o + VELOCITY, residual, variance, GATE_THREE)


@wp.func
def spins_in_sight(belief: Belief, b: int, r: int) -> bool:
    """Whether a robot's wheels have turned for a while under a camera's eye without moving it."""
    return belief.tried_s[b, r] > SPINNING_S and belief.unseen_s[b, r] < SPINNING_S


@wp.func
def correct_pose(
    belief: Belief,
    measured: Measurements,
    member: MemberModel,
    rows: wp.array3d(dtype=wp.float64),
    b: int,
    i: int,
    j: int,
) -> bool:
    """Update with the pose of robot j from the camera of robot i."""
    size = 15 * belief.slots[b]
    R_CG = wp.transpose(belief.rotation[b, i] * member.R_body_camera)
    d = belief.position[b, j] - belief.position[b, i]
    p_hat = R_CG * d - wp.transpose(member.R_body_camera) * member.p_body_camera
    R_hat = R_CG * belief.rotation[b, j]
    turn = log_so3(wp.mat33d(measured.R_camera_body[b, i, j]) * wp.transpose(R_hat))
    shift = wp.vec3d(measured.p_camera_body[b, i, j]) - p_hat
    oi = 15 * belief.slot[b, i]
    oj = 15 * belief.slot[b, j]
    lever = R_CG * wp.skew(d)
    clear_rows(rows, b, 6, size)
    row_times_covariance(belief, rows, b, 0, -R_CG, oi + THETA, size)
    row_times_covariance(belief, rows, b, 0, R_CG, oj + THETA, size)
    row_times_covariance(belief, rows, b, 3, lever, oi + THETA, size)
    row_times_covariance(belief, rows, b, 3, -R_CG, oi + POSITION, size)
    row_times_covariance(belief, rows, b, 3, R_CG, oj + POSITION, size)
    S = measured.covariance[b, i, j]
    S = add_to_innovation(S, rows, b, 6, 0, -R_CG, oi + THETA)
    S = add_to_innovation(S, rows, b, 6, 0, R_CG, oj + THETA)
    S = add_to_innovation(S, rows, b, 6, 3, lever, oi + THETA)
    S = add_to_innovation(S, rows, b, 6, 3, -R_CG, oi + POSITION)
    S = add_to_innovation(S, rows, b, 6, 3, R_CG, oj + POSITION)
    return correct(belief, rows, b, 6, S, vec6d(turn[0], turn[1], turn[2], shift[0], shift[1], shift[2]), GATE_POSE)


@wp.func
def doubt(belief: Belief, b: int, r: int):
    """After sightings that the gate rejected in a row a robot's pose is not believed any more: it was moved or slipped."""
    o = 15 * belief.slot[b, r]
    add_diagonal(belief.covariance, b, o + THETA, wp.float64(0.01))
    add_diagonal(belief.covariance, b, o + POSITION, wp.float64(0.01))
    belief.rejected[b, r] = 0
    belief.stationary[b, r] = 0
    belief.rest_s[b, r] = 0.0


@wp.func
def fuse_sightings(
    belief: Belief, measured: Measurements, members: wp.array(dtype=MemberModel), rows: wp.array3d(dtype=wp.float64),
    b: int, i: int,
):  # fmt: skip
    """Fuse what camera i saw. Between two robots at rest the same view tells nothing new after a while."""
    for j in range(members.shape[0]):
        belief.seen[b, i, j] = 0
        if measured.seen[b, i, j] == 1 and belief.slot[b, i] >= 0 and belief.slot[b, j] >= 0:
            belief.seen[b, i, j] = 1
            resting = belief.stationary[b, i] == 1 and belief.stationary[b, j] == 1
            if not resting or belief.averaged[b, i, j] < ENOUGH_SIGHTINGS:
                if correct_pose(belief, measured, members[i], rows, b, i, j):
                    belief.rejected[b, j] = 0
                    belief.averaged[b, i, j] = belief.averaged[b, i, j] + 1
                else:
                    belief.seen[b, i, j] = 0
                    belief.rejected[b, j] = belief.rejected[b, j] + 1
                    if belief.rejected[b, j] >= REJECTIONS:
                        doubt(belief, b, j)


@wp.kernel
def fuse(
    belief: Belief, measured: Measurements, members: wp.array(dtype=MemberModel), model: FilterModel,
    rows: wp.array3d(dtype=wp.float64), running: wp.array(dtype=int),
):  # fmt: skip
    """Fuse one decision's measurements into the belief of every running team."""
    b = wp.tid()
    if running[b] == 0:
        return
    n = members.shape[0]
    for r in range(n):
        if belief.slot[b, r] >= 0 and measured.heard[b, r] == 1:
            if belief.stationary[b, r] == 1:
                if belief.rest_s[b, r] < REST_SETTLED_S or belief.clock[b] % REST_EVERY == 0:
                    correct_rest(belief, measured, members[r], model, rows, b, r)
            elif belief.declared[b, r] == WORKING and not spins_in_sight(belief, b, r):
                correct_odometry(belief, measured, members[r], model, rows, b, r)
    for i in range(n):
        if members[i].camera == 1:
            fuse_sightings(belief, measured, members, rows, b, i)
    for r in range(n):
        belief.battery[b, r] = measured.battery[b, r]
        sighted = bool(False)
        for i in range(n):
            if belief.seen[b, i, r] == 1 or belief.seen[b, r, i] == 1:
                sighted = bool(True)
        belief.unseen_s[b, r] = belief.unseen_s[b, r] + model.decision_s
        if sighted:
            belief.unseen_s[b, r] = 0.0
        slot = belief.slot[b, r]
        if slot >= 0:
            pose = mat66d()
            for i in range(6):
                for k in range(6):
                    pose[i, k] = belief.covariance[b, 15 * slot + i, 15 * slot + k]
            belief.pose_covariance[b, r] = pose

"""IMU propagation of the team filter: robots that move integrate their IMU, robots that stand still keep their pose.

Source: thesis section 5.2.2 (eqs 5.5, 5.6) with the error R = Exp(theta) R_hat; the transition over all ticks of a
decision is built up tick by tick and applied to the covariance once.
"""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.estimation.belief import (
    ACCEL,
    GYRO,
    POSITION,
    THETA,
    VELOCITY,
    WAITING,
    Belief,
    MemberModel,
    vec15d,
)
from coop_envs.estimation.joining import Plans, Prior, welcome
from coop_envs.estimation.rows import Rows
from coop_envs.geometry.so3 import exp_so3, orthonormal
from coop_envs.sensing.measurements import Measurements

wp.set_module_options({"enable_backward": False, "max_unroll": 15})

STILL_RAD_S = wp.constant(1.0e-3)
QUIET_GYRO = wp.constant(wp.float64(0.02))
QUIET_ACCEL = wp.constant(wp.float64(0.25))
SETTLED_M2 = wp.constant(wp.float64(1.0e-9))


@wp.struct
class FilterModel:
    """Settings of the filter; times in s, ``slip_*`` the random walk of a robot at rest per root second."""

    tick_s: wp.float64
    decision_s: float
    rest_s: float
    slip_position: wp.float64
    slip_heading: wp.float64
    odometry_scale: float


@wp.struct
class Transition:
    """Blocks of the 15 x 15 error transition over a decision that are neither zero nor identity, and its length."""

    theta_gyro: wp.mat33d
    velocity_theta: wp.mat33d
    velocity_gyro: wp.mat33d
    velocity_accel: wp.mat33d
    position_theta: wp.mat33d
    position_gyro: wp.mat33d
    position_accel: wp.mat33d
    time: wp.float64
    force: wp.vec3d


@wp.func
def integrate(belief: Belief, measured: Measurements, model: FilterModel, b: int, r: int) -> Transition:
    """Integrate robot r's IMU over the decision, in place, and return the error transition."""
    phi = Transition()
    ticks = measured.gyro.shape[2]
    dt = model.tick_s
    half = wp.float64(0.5)
    attitude = belief.rotation[b, r]
    p = belief.position[b, r]
    v = belief.velocity[b, r]
    gravity = wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(-9.81))
    mean = wp.vec3d()
    for t in range(ticks):
        force = attitude * (wp.vec3d(measured.accel[b, r, t]) - belief.accel_bias[b, r])
        turn = (wp.vec3d(measured.gyro[b, r, t]) - belief.gyro_bias[b, r]) * dt
        middle = v + (force + gravity) * (half * dt)
        mean = mean + wp.transpose(attitude) * middle / wp.float64(ticks)
        p = p + middle * dt
        v = v + (force + gravity) * dt
        lever = wp.skew(force) * (-dt)
        bend = lever * phi.theta_gyro
        phi.position_theta = phi.position_theta + phi.velocity_theta * dt + lever * (half * dt)
        phi.position_gyro = phi.position_gyro + phi.velocity_gyro * dt + bend * (half * dt)
        phi.position_accel = phi.position_accel + phi.velocity_accel * dt - attitude * (half * dt * dt)
        phi.velocity_theta = phi.velocity_theta + lever
        phi.velocity_gyro = phi.velocity_gyro + bend
        phi.velocity_accel = phi.velocity_accel - attitude * dt
        phi.theta_gyro = phi.theta_gyro - attitude * dt
        phi.force = phi.force + force / wp.float64(ticks)
        attitude = attitude * exp_so3(turn)
    phi.time = dt * wp.float64(ticks)
    belief.position[b, r] = p
    belief.velocity[b, r] = v
    belief.rotation[b, r] = orthonormal(attitude)
    belief.lag[b, r] = wp.transpose(attitude) * v - mean
    return phi


@wp.func
def block3(P: wp.array3d[wp.float64], b: int, row: int, column: int) -> wp.vec3d:
    """Three stacked entries of one column."""
    return wp.vec3d(P[b, row, column], P[b, row + 1, column], P[b, row + 2, column])


@wp.func
def transform_rows(rows: Rows, b: int, row: int, s: int, phi: Transition):
    """Multiply a robot's 15 rows by its transition, the entries of slot s."""
    P = rows.covariance
    time = phi.time
    x = P[b, row + THETA, s]
    y = P[b, row + THETA + 1, s]
    z = P[b, row + THETA + 2, s]
    u = P[b, row + GYRO, s]
    v = P[b, row + GYRO + 1, s]
    w = P[b, row + GYRO + 2, s]
    for k in range(3):
        by_theta = x * phi.position_theta[k, 0] + y * phi.position_theta[k, 1] + z * phi.position_theta[k, 2]
        by_gyro = u * phi.position_gyro[k, 0] + v * phi.position_gyro[k, 1] + w * phi.position_gyro[k, 2]
        moved = P[b, row + POSITION + k, s] + P[b, row + VELOCITY + k, s] * time
        P[b, row + POSITION + k, s] = moved + by_theta + by_gyro
    for k in range(3):
        by_theta = x * phi.velocity_theta[k, 0] + y * phi.velocity_theta[k, 1] + z * phi.velocity_theta[k, 2]
        by_gyro = u * phi.velocity_gyro[k, 0] + v * phi.velocity_gyro[k, 1] + w * phi.velocity_gyro[k, 2]
        P[b, row + VELOCITY + k, s] = P[b, row + VELOCITY + k, s] + by_theta + by_gyro
    for k in range(3):
        turned = u * phi.theta_gyro[k, 0] + v * phi.theta_gyro[k, 1] + w * phi.theta_gyro[k, 2]
        P[b, row + THETA + k, s] = P[b, row + THETA + k, s] + turned
    x = P[b, row + ACCEL, s]
    y = P[b, row + ACCEL + 1, s]
    z = P[b, row + ACCEL + 2, s]
    for k in range(3):
        pushed = x * phi.position_accel[k, 0] + y * phi.position_accel[k, 1] + z * phi.position_accel[k, 2]
        P[b, row + POSITION + k, s] = P[b, row + POSITION + k, s] + pushed
        pushed = x * phi.velocity_accel[k, 0] + y * phi.velocity_accel[k, 1] + z * phi.velocity_accel[k, 2]
        P[b, row + VELOCITY + k, s] = P[b, row + VELOCITY + k, s] + pushed


@wp.func
def transpose_block(P: wp.array3d[wp.float64], b: int, row: int):
    """Transpose the 15 x 15 diagonal block at ``row`` in place."""
    for i in range(15):
        for j in range(i):
            upper = P[b, row + j, row + i]
            P[b, row + j, row + i] = P[b, row + i, row + j]
            P[b, row + i, row + j] = upper


@wp.func
def column15(P: wp.array3d[wp.float64], b: int, row: int, c: int) -> vec15d:
    """Fifteen stacked entries of one column."""
    column = vec15d()
    for k in range(15):
        column[k] = P[b, row + k, c]
    return column


@wp.func
def mirror(belief: Belief, rows: Rows, b: int, slot: int):
    """Make a robot's columns those of its rows."""
    P = belief.covariance
    row = 15 * slot
    for s in range(belief.slots[b]):
        if s != slot:
            for c in range(15 * s, 15 * s + 15):
                rows.covariance[b, c, slot] = column15(P, b, row, c)
    for i in range(15):
        for k in range(i):
            P[b, row + k, row + i] = P[b, row + i, row + k]


@wp.func
def propagate_covariance(belief: Belief, rows: Rows, b: int, slot: int, phi: Transition):
    """P = Phi P Phi^T for one robot's transition, the other robots standing."""
    P = belief.covariance
    row = 15 * slot
    for s in range(belief.slots[b]):
        transform_rows(rows, b, row, s, phi)
    transpose_block(P, b, row)
    transform_rows(rows, b, row, slot, phi)
    mirror(belief, rows, b, slot)


@wp.func
def linearise(belief: Belief, b: int):
    """Updates from here on take their derivatives at the poses as they are now."""
    for r in range(belief.slot.shape[1]):
        belief.first_position[b, r] = belief.position[b, r]
        belief.first_velocity[b, r] = belief.velocity[b, r]


@wp.func
def add_turned(rows: Rows, b: int, row: int, s: int, moved: wp.mat33d, gained: wp.mat33d):
    """Add a robot's rows of theta, times a block each, to those of p and v, the entries of slot s."""
    P = rows.covariance
    x = P[b, row + THETA, s]
    y = P[b, row + THETA + 1, s]
    z = P[b, row + THETA + 2, s]
    for k in range(3):
        p = row + POSITION + k
        v = row + VELOCITY + k
        P[b, p, s] = P[b, p, s] + x * moved[k, 0] + y * moved[k, 1] + z * moved[k, 2]
        P[b, v, s] = P[b, v, s] + x * gained[k, 0] + y * gained[k, 1] + z * gained[k, 2]


@wp.func
def carry_over(belief: Belief, rows: Rows, b: int, slot: int, moved: wp.mat33d, gained: wp.mat33d):
    """P = T P T^T for one robot, where T adds ``moved`` theta to p and ``gained`` theta to v."""
    P = belief.covariance
    row = 15 * slot
    for s in range(belief.slots[b]):
        add_turned(rows, b, row, s, moved, gained)
    transpose_block(P, b, row)
    add_turned(rows, b, row, slot, moved, gained)
    mirror(belief, rows, b, slot)


@wp.func
def follow_shift(belief: Belief, rows: Rows, b: int):
    """Carry the covariance from where updates were linearised to where they moved the team.

    A turn of the whole team about gravity moves a robot by ``theta x p``: what nobody can observe depends on p. So that
    updates, each at another p, do not seem to tell of it, errors are carried over by p - [shift]x theta, as they are in
    an invariant filter, whose position error is p + [p_hat]x theta and knows no p_hat in what it cannot observe.

    Source: Barrau and Bonnabel, The invariant extended Kalman filter as a stable observer, 2017; Huang, Mourikis,
    Roumeliotis, Observability-based rules for consistent EKF SLAM, 2010, for the derivatives at first estimates.
    """
    for r in range(belief.slot.shape[1]):
        if belief.slot[b, r] >= 0:
            moved = belief.position[b, r] - belief.first_position[b, r]
            gained = belief.velocity[b, r] - belief.first_velocity[b, r]
            if wp.length_sq(moved) + wp.length_sq(gained) > SETTLED_M2:
                carry_over(belief, rows, b, belief.slot[b, r], wp.skew(-moved), wp.skew(-gained))


@wp.func
def add_block(P: wp.array3d[wp.float64], b: int, row: int, column: int, block: wp.mat33d):
    """Add a block and, off the diagonal, its transpose across it."""
    for i in range(3):
        for j in range(3):
            P[b, row + i, column + j] = P[b, row + i, column + j] + block[i, j]
            if row != column:
                P[b, column + j, row + i] = P[b, column + j, row + i] + block[i, j]


@wp.func
def add_noise(belief: Belief, member: MemberModel, b: int, slot: int, phi: Transition, shake: wp.float64):
    """Add the integral of white IMU noise and bias walk over the decision, the force taken as constant."""
    P = belief.covariance
    row = 15 * slot
    t = phi.time
    t2 = t * t
    t3 = t2 * t
    eye = wp.identity(n=3, dtype=wp.float64)
    gyro = member.gyro_noise + shake * member.moving_gyro_noise
    accel = member.accel_noise + shake * member.moving_accel_noise
    g = gyro * gyro
    a = accel * accel
    lever = wp.skew(phi.force)
    lever2 = lever * wp.transpose(lever)
    add_block(P, b, row + THETA, row + THETA, eye * (g * t))
    add_block(P, b, row + VELOCITY, row + THETA, lever * (-g * t2 / wp.float64(2.0)))
    add_block(P, b, row + POSITION, row + THETA, lever * (-g * t3 / wp.float64(6.0)))
    add_block(P, b, row + VELOCITY, row + VELOCITY, eye * (a * t) + lever2 * (g * t3 / wp.float64(3.0)))
    shake_pv = eye * (a * t2 / wp.float64(2.0)) + lever2 * (g * t3 * t / wp.float64(8.0))
    shake_pp = eye * (a * t3 / wp.float64(3.0)) + lever2 * (g * t3 * t2 / wp.float64(20.0))
    add_block(P, b, row + POSITION, row + VELOCITY, shake_pv)
    add_block(P, b, row + POSITION, row + POSITION, shake_pp)
    add_block(P, b, row + GYRO, row + GYRO, eye * (member.gyro_walk * member.gyro_walk * t))
    add_block(P, b, row + ACCEL, row + ACCEL, eye * (member.accel_walk * member.accel_walk * t))


@wp.func
def add_diagonal(P: wp.array3d[wp.float64], b: int, row: int, extra: wp.float64):
    """Add the same variance to three diagonal entries."""
    for k in range(3):
        P[b, row + k, row + k] = P[b, row + k, row + k] + extra


@wp.func
def rests(belief: Belief, command: Command, measured: Measurements, b: int, r: int) -> bool:
    """Whether a robot was told to stand, its wheels stood and its IMU was quiet for the whole decision."""
    wheels = measured.wheels[b, r]
    if wp.length(command.wheels[b, r]) > STILL_RAD_S or wp.length(wheels) > STILL_RAD_S:
        return False
    ticks = measured.gyro.shape[2]
    turn = wp.vec3d()
    force = wp.vec3d()
    for t in range(ticks):
        turn = turn + wp.vec3d(measured.gyro[b, r, t])
        force = force + wp.vec3d(measured.accel[b, r, t])
    turn = turn / wp.float64(ticks) - belief.gyro_bias[b, r]
    force = force / wp.float64(ticks) - belief.accel_bias[b, r]
    return wp.length(turn) < QUIET_GYRO and wp.abs(wp.length(force) - wp.float64(9.81)) < QUIET_ACCEL


@wp.func
def stand_still(belief: Belief, member: MemberModel, model: FilterModel, b: int, slot: int):
    """Covariance of a robot at rest over a decision: the ground may give a little, the IMU's biases walk on."""
    t = wp.float64(model.decision_s)
    row = 15 * slot
    yaw = row + THETA + 2
    add_diagonal(belief.covariance, b, row + POSITION, model.slip_position * model.slip_position * t)
    belief.covariance[b, yaw, yaw] = belief.covariance[b, yaw, yaw] + model.slip_heading * model.slip_heading * t
    add_diagonal(belief.covariance, b, row + GYRO, member.gyro_walk * member.gyro_walk * t)
    add_diagonal(belief.covariance, b, row + ACCEL, member.accel_walk * member.accel_walk * t)


@wp.kernel
def propagate(
    belief: Belief, command: Command, measured: Measurements, plans: Plans, prior: Prior,
    members: wp.array[MemberModel], model: FilterModel, rows: Rows, running: wp.array[int],
):  # fmt: skip
    """Carry the belief of every running team over one decision."""
    b = wp.tid()
    if running[b] == 0:
        return
    welcome(belief, plans, prior, measured, members, b)
    belief.clock[b] = belief.clock[b] + 1
    for r in range(members.shape[0]):
        slot = belief.slot[b, r]
        if slot >= 0 and measured.heard[b, r] == 1 and belief.declared[b, r] != WAITING:
            if rests(belief, command, measured, b, r):
                belief.rest_s[b, r] = belief.rest_s[b, r] + model.decision_s
                belief.spinning[b, r] = 0
            else:
                belief.rest_s[b, r] = 0.0
            still = int(belief.rest_s[b, r] >= model.rest_s)
            if still == 0 or belief.stationary[b, r] == 0:
                for j in range(members.shape[0]):
                    belief.averaged[b, r, j] = 0
                    belief.averaged[b, j, r] = 0
            belief.stationary[b, r] = still
            if still == 1:
                stand_still(belief, members[r], model, b, slot)
            else:
                phi = integrate(belief, measured, model, b, r)
                shake = wp.float64(0.0)
                driven = wp.length(command.wheels[b, r]) > STILL_RAD_S
                if driven or wp.length(measured.wheels[b, r]) > STILL_RAD_S:
                    shake = wp.float64(1.0)
                propagate_covariance(belief, rows, b, slot, phi)
                add_noise(belief, members[r], b, slot, phi, shake)

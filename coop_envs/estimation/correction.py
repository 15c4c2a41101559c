"""Measurement updates of the team filter in a decision: rest and wheels, then what the cameras saw."""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import ACCEL, GYRO, THETA, VELOCITY, Belief, MemberModel
from coop_envs.estimation.calibration import Optics
from coop_envs.estimation.kalman import GATE_ONE, correct_pair
from coop_envs.estimation.propagation import FilterModel, block3, follow_shift, linearise
from coop_envs.estimation.rows import Rows
from coop_envs.estimation.sightings import fuse_sightings
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import mat66d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

REST_SETTLED_S = wp.constant(2.0)
REST_EVERY_S = wp.constant(2.0)
SPINNING_S = wp.constant(0.7)
HELD_SHARE = wp.constant(0.2)
ODOMETRY_FLOOR_M_S = wp.constant(0.004)


@wp.func
def correct_rest(
    belief: Belief, measured: Measurements, member: MemberModel, model: FilterModel, rows: Rows,
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
    swung = wp.skew(belief.first_velocity[b, r])
    correct_pair(belief, rows, b, eye, o + VELOCITY, swung, o + THETA, -belief.velocity[b, r], still)
    gyro_variance = one * (member.gyro_noise * member.gyro_noise / span)
    correct_pair(belief, rows, b, eye, o + GYRO, none, o + THETA, turn - belief.gyro_bias[b, r], gyro_variance)
    up = wp.vec3d(wp.float64(0.0), wp.float64(0.0), wp.float64(9.81))
    Rt = wp.transpose(belief.rotation[b, r])
    expected = Rt * up + belief.accel_bias[b, r]
    accel_variance = one * (member.accel_noise * member.accel_noise / span)
    correct_pair(belief, rows, b, Rt * wp.skew(up), o + THETA, eye, o + ACCEL, force - expected, accel_variance)


@wp.func
def contradicts(belief: Belief, b: int, r: int, excess: wp.float64, sigma: wp.float64) -> bool:
    """Whether the wheels' speed exceeds the body's by more than its variance and a slip of ``sigma`` can explain."""
    R = belief.rotation[b, r]
    ahead = wp.vec3d(R[0, 0], R[1, 0], R[2, 0])
    row = 15 * belief.slot[b, r] + VELOCITY
    variance = sigma * sigma
    for k in range(3):
        variance = variance + ahead[k] * wp.dot(block3(belief.covariance, b, row, row + k), ahead)
    return excess * excess > GATE_ONE * variance


@wp.func
def tried_in_sight(belief: Belief, b: int, r: int) -> bool:
    """Whether a robot's wheels have turned for a while under a camera's eye without moving it."""
    return belief.tried_s[b, r] > SPINNING_S and belief.unseen_s[b, r] < SPINNING_S


@wp.func
def correct_odometry(
    belief: Belief, measured: Measurements, member: MemberModel, model: FilterModel, rows: Rows,
    b: int, r: int,
):  # fmt: skip
    """Wheels give the body's mean forward speed over the decision and say that it moves neither sideways nor up.

    Both sides slip on their own, and slip wanders slower than decisions follow each other, so its variance counts
    2 tau / T times. Wheels that turn while the IMU tells of standing spin on a robot held fast: from then on it is
    taken to stand, give or take a share of the wheels' speed, until the IMU tells of going. Where the IMU tells of
    something in between, as while a robot is being caught, the wheels do not count. Not in the thesis, whose filter
    has no odometry: it bounds the IMU's drift while no landmark is in sight.
    """
    o = 15 * belief.slot[b, r]
    rim = measured.wheels[b, r] * member.wheel_radius
    pace = 0.5 * wp.length(rim) * model.odometry_scale
    floor = ODOMETRY_FLOOR_M_S * model.odometry_scale
    Rt = wp.transpose(belief.rotation[b, r])
    v = belief.velocity[b, r]
    mean = Rt * v - belief.lag[b, r]
    speed = wp.float64(0.5 * (rim[0] + rim[1]))
    share = wp.sign(speed) * mean[0] - wp.float64(0.5) * wp.abs(speed)
    now = wp.float64(floor + pace * wp.length(wp.vec2(member.slip, member.odometry_noise)))
    slower = wp.sign(speed) * (speed - mean[0]) > wp.float64(0.0) and contradicts(belief, b, r, speed - mean[0], now)
    if share > wp.float64(0.0):
        belief.spinning[b, r] = 0
    elif slower or tried_in_sight(belief, b, r):
        belief.spinning[b, r] = 1
    if slower and belief.spinning[b, r] == 0:
        return
    slip = member.slip * wp.sqrt(2.0 * member.slip_time / model.decision_s)
    noise = floor + pace * wp.length(wp.vec2(slip, member.odometry_noise))
    if belief.spinning[b, r] == 1:
        speed = wp.float64(0.0)
        noise = floor + pace * HELD_SHARE
    variance = wp.float64(noise * noise)
    residual = wp.vec3d(speed, wp.float64(0.0), wp.float64(0.0)) - mean
    variances = wp.vec3d(variance, variance, variance)
    swung = Rt * wp.skew(belief.first_velocity[b, r])
    correct_pair(belief, rows, b, swung, o + THETA, Rt, o + VELOCITY, residual, variances)


@wp.func
def note(belief: Belief, measured: Measurements, model: FilterModel, b: int, r: int):
    """Keep what is read off after the updates: battery, time out of sight, covariance of the pose."""
    belief.battery[b, r] = measured.battery[b, r]
    belief.unseen_s[b, r] = belief.unseen_s[b, r] + model.decision_s
    for i in range(belief.slot.shape[1]):
        if belief.seen[b, i, r] == 1 or belief.seen[b, r, i] == 1:
            belief.unseen_s[b, r] = 0.0
    slot = belief.slot[b, r]
    if slot >= 0:
        pose = mat66d()
        for i in range(6):
            for k in range(6):
                pose[i, k] = belief.covariance[b, 15 * slot + i, 15 * slot + k]
        belief.pose_covariance[b, r] = pose


@wp.func
def shows_rest(belief: Belief, model: FilterModel, b: int, r: int) -> bool:
    """Whether a robot's rest is fused in this decision: always at first, now and then once it tells little new."""
    rest = belief.rest_s[b, r]
    return rest < REST_SETTLED_S or wp.floor(rest / REST_EVERY_S) > wp.floor((rest - model.decision_s) / REST_EVERY_S)


@wp.kernel
def fuse(
    belief: Belief, measured: Measurements, members: wp.array[MemberModel], optics: Optics, model: FilterModel,
    rows: Rows, running: wp.array[int],
):  # fmt: skip
    """Fuse one decision's measurements into the belief of every running team."""
    b = wp.tid()
    if running[b] == 0:
        return
    linearise(belief, b)
    n = members.shape[0]
    for r in range(n):
        belief.demoted[b, r] = 0
        if belief.slot[b, r] >= 0 and measured.heard[b, r] == 1:
            if belief.stationary[b, r] == 1:
                if shows_rest(belief, model, b, r):
                    correct_rest(belief, measured, members[r], model, rows, b, r)
            elif members[r].odometry == 1:
                correct_odometry(belief, measured, members[r], model, rows, b, r)
    for i in range(n):
        if members[i].camera == 1:
            fuse_sightings(belief, measured, members, optics, model, rows, b, i)
    follow_shift(belief, rows, b)
    for r in range(n):
        note(belief, measured, model, b, r)

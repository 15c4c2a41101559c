"""Robots enter the filter at reset and from the dock, and leave it when their slot is needed or they fall silent."""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import (
    ACCEL,
    GYRO,
    LOST,
    NO_SLOT,
    POSITION,
    THETA,
    VELOCITY,
    WAITING,
    WORKING,
    Belief,
    MemberModel,
    vec15d,
)
from coop_envs.estimation.calibration import CalibrationPrior, begin_calibration
from coop_envs.sensing.hats import Hats
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class Plans:
    """Where people say they put the robots, in the team frame: ``start`` (B, N) and ``dock`` (B,) are x, y, yaw.

    ``goal`` (B,) is x, y, radius, 1 if there is one.
    """

    start: wp.array2d[wp.vec3]
    dock: wp.array[wp.vec3]
    goal: wp.array[wp.vec4]


@wp.struct
class Prior:
    """How exactly people put robots where they say: standard deviations (m, rad)."""

    position: wp.float64
    height: wp.float64
    yaw: wp.float64
    tilt: wp.float64


@wp.func
def clear_block(belief: Belief, b: int, slot: int):
    """Forget a slot: its rows and columns become zero."""
    size = belief.covariance.shape[1]
    for k in range(15):
        row = 15 * slot + k
        for c in range(size):
            belief.covariance[b, row, c] = wp.float64(0.0)
            belief.covariance[b, c, row] = wp.float64(0.0)


@wp.func
def set_variance(belief: Belief, b: int, row: int, sigma: wp.float64):
    """Put the same variance on three diagonal entries."""
    for k in range(3):
        belief.covariance[b, row + k, row + k] = sigma * sigma


@wp.func
def free_slot(belief: Belief, b: int) -> int:
    """An unused slot, or that of the robot lost first."""
    total = belief.covariance.shape[1] // 15
    if belief.slots[b] < total:
        belief.slots[b] = belief.slots[b] + 1
        return belief.slots[b] - 1
    for s in range(belief.calibration.shape[1], total):
        taken = bool(False)
        for r in range(belief.slot.shape[1]):
            if belief.slot[b, r] == s:
                taken = bool(True)
        if not taken:
            return s
    for r in range(belief.slot.shape[1]):
        if belief.slot[b, r] >= 0 and belief.declared[b, r] == LOST:
            s = belief.slot[b, r]
            belief.slot[b, r] = NO_SLOT
            return s
    return NO_SLOT


@wp.func
def join(belief: Belief, prior: Prior, model: MemberModel, b: int, r: int, pose: wp.vec3, exact: bool):
    """Put robot r into the filter at x, y, yaw, at rest; ``exact`` for the one that defines the frame."""
    slot = free_slot(belief, b)
    belief.slot[b, r] = slot
    c = wp.cos(wp.float64(pose[2]))
    s = wp.sin(wp.float64(pose[2]))
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    belief.position[b, r] = wp.vec3d(wp.float64(pose[0]), wp.float64(pose[1]), zero)
    belief.rotation[b, r] = wp.mat33d(c, -s, zero, s, c, zero, zero, zero, one)
    belief.velocity[b, r] = wp.vec3d()
    belief.gyro_bias[b, r] = wp.vec3d()
    belief.accel_bias[b, r] = wp.vec3d()
    belief.declared[b, r] = WORKING
    belief.stationary[b, r] = 0
    belief.rest_s[b, r] = 0.0
    belief.unseen_s[b, r] = 0.0
    belief.silent_s[b, r] = 0.0
    belief.rejected[b, r] = 0
    belief.rejected_s[b, r] = 0.0
    belief.demoted[b, r] = 0
    belief.spinning[b, r] = 0
    belief.tried_s[b, r] = 0.0
    belief.turn_tried[b, r] = 0.0
    belief.turn_felt[b, r] = 0.0
    belief.anchor[b, r] = wp.vec3()
    belief.undock[b, r] = 0
    if slot == NO_SLOT:
        return
    clear_block(belief, b, slot)
    row = 15 * slot
    tiny = wp.float64(1.0e-5)
    set_variance(belief, b, row + THETA, prior.tilt)
    set_variance(belief, b, row + POSITION, prior.position)
    yaw = prior.yaw
    height = prior.height
    if exact:
        set_variance(belief, b, row + POSITION, tiny)
        yaw = tiny
        height = tiny
    belief.covariance[b, row + THETA + 2, row + THETA + 2] = yaw * yaw
    belief.covariance[b, row + POSITION + 2, row + POSITION + 2] = height * height
    set_variance(belief, b, row + VELOCITY, wp.float64(1.0e-3))
    set_variance(belief, b, row + GYRO, model.gyro_bias)
    set_variance(belief, b, row + ACCEL, model.accel_bias)


@wp.kernel
def begin(
    belief: Belief, plans: Plans, prior: Prior, members: wp.array[MemberModel], hats: Hats,
    calibration: CalibrationPrior, chosen: wp.array[int],
):  # fmt: skip
    """Start the belief of the chosen teams anew."""
    b = wp.tid()
    if chosen[b] == 0:
        return
    calibrated = belief.calibration.shape[1]
    belief.slots[b] = calibrated
    for s in range(calibrated):
        clear_block(belief, b, s)
        belief.calibration[b, s] = vec15d()
    belief.clock[b] = 0
    belief.goal[b] = plans.goal[b]
    n = members.shape[0]
    for r in range(n):
        belief.slot[b, r] = NO_SLOT
        begin_calibration(belief, members[r], calibration, hats, b, r)
        belief.battery[b, r] = 1.0
        belief.marked[b, r] = 0
        belief.pose_covariance[b, r] = mat66d()
        for j in range(n):
            belief.seen[b, r, j] = 0
            belief.averaged[b, r, j] = 0
            belief.refused[b, r, j] = vec6d()
            belief.wandered[b, r, j] = vec6d()
    for r in range(n):
        if members[r].reserve == 1:
            dock = plans.dock[b]
            belief.position[b, r] = wp.vec3d(wp.float64(dock[0]), wp.float64(dock[1]), wp.float64(0.0))
            belief.rotation[b, r] = wp.identity(n=3, dtype=wp.float64)
            belief.velocity[b, r] = wp.vec3d()
            belief.gyro_bias[b, r] = wp.vec3d()
            belief.declared[b, r] = WAITING
            belief.stationary[b, r] = 1
            belief.rest_s[b, r] = 0.0
            belief.undock[b, r] = 0
            belief.tried_s[b, r] = 0.0
        else:
            join(belief, prior, members[r], b, r, plans.start[b, r], r == 0)


@wp.func
def welcome(belief: Belief, plans: Plans, prior: Prior, measured: Measurements, members: wp.array[MemberModel], b: int):
    """Robots that have left the dock join; lost ones that are silent give up their slot."""
    for r in range(members.shape[0]):
        if belief.declared[b, r] == WAITING and measured.docked[b, r] == 0:
            join(belief, prior, members[r], b, r, plans.dock[b], False)
        if belief.declared[b, r] == LOST and measured.heard[b, r] == 0 and belief.slot[b, r] >= 0:
            clear_block(belief, b, belief.slot[b, r])
            belief.slot[b, r] = NO_SLOT

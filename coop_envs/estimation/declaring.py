"""Which robots the belief declares lost: stuck, silent or upside down; and which reserve it then calls.

A robot is called stuck when it has tried to drive and to turn for a while and neither was noticed: the gyro felt no
turn, and the cameras saw no shift that their noise could not explain. Turning is part of the test because a robot
against a wall can turn and one in a trap cannot; a robot that only pushes is called stuck after four times as long, and
only in sight: one that drives straight on out of sight cannot be told from it. A robot whose radio carries no IMU is
told by that alone.
"""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import LOST, WAITING, WORKING, Belief, MemberModel
from coop_envs.sensing.measurements import Measurements

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

TURN_RAD_S = wp.constant(0.2)
DRIVE_M_S = wp.constant(0.02)
TURN_NOTICED = wp.constant(0.15)
TURN_TESTED = wp.constant(0.6)
GYRO_NOISE_RAD_S = wp.constant(0.01)
SHIFT_M = wp.constant(0.02)
MUCH_SHIFT_M = wp.constant(0.1)
SHIFT_SIGMAS = wp.constant(5.0)
IN_SIGHT_S = wp.constant(1.0)
PUSHING = wp.constant(4.0)
UPSIDE_DOWN = wp.constant(-5.0)
EMPTY = wp.constant(0.002)


@wp.struct
class StuckModel:
    """Seconds of fruitless trying, or of silence, after which a robot is declared lost; length of a decision."""

    stuck_s: float
    silent_s: float
    decision_s: float


@wp.func
def position_sigma(belief: Belief, b: int, r: int) -> float:
    """Larger standard deviation of a robot's position in the ground plane (m)."""
    c = belief.pose_covariance[b, r]
    a = float(c[3, 3])
    d = float(c[4, 4])
    o = float(c[3, 4])
    return wp.sqrt(wp.max(0.5 * (a + d) + wp.sqrt(0.25 * (a - d) * (a - d) + o * o), 0.0))


@wp.func
def forget_trying(belief: Belief, b: int, r: int):
    """A motion was noticed: start counting anew."""
    belief.tried_s[b, r] = 0.0
    belief.turn_tried[b, r] = 0.0
    belief.turn_felt[b, r] = 0.0
    belief.anchor[b, r] = wp.vec3()


@wp.func
def seen_to_shift(belief: Belief, b: int, r: int) -> bool:
    """Whether a camera sees the robot now away from where one saw it first since its last motion."""
    if belief.unseen_s[b, r] > 0.0:
        return False
    p = belief.position[b, r]
    here = wp.vec3(float(p[0]), float(p[1]), 1.0)
    if belief.anchor[b, r][2] == 0.0:
        belief.anchor[b, r] = here
    noise = SHIFT_SIGMAS * position_sigma(belief, b, r)
    return wp.length(here - belief.anchor[b, r]) > wp.clamp(noise, SHIFT_M, MUCH_SHIFT_M)


@wp.func
def count_trying(belief: Belief, measured: Measurements, member: MemberModel, model: StuckModel, b: int, r: int):
    """Add this decision to what the robot has tried, and forget it all if a motion was noticed."""
    rim = measured.wheels[b, r] * member.wheel_radius
    drive = 0.5 * (rim[0] + rim[1])
    turn = (rim[1] - rim[0]) / member.track
    if wp.abs(drive) < DRIVE_M_S and wp.abs(turn) < TURN_RAD_S:
        return
    belief.tried_s[b, r] = belief.tried_s[b, r] + model.decision_s
    ticks = measured.gyro.shape[2]
    rate = float(0.0)
    for t in range(ticks):
        rate = rate + measured.gyro[b, r, t][2] / float(ticks)
    rate = rate - float(belief.gyro_bias[b, r][2])
    belief.turn_felt[b, r] = belief.turn_felt[b, r] + wp.max(wp.abs(rate) - GYRO_NOISE_RAD_S, 0.0) * model.decision_s
    if wp.abs(turn) > TURN_RAD_S:
        belief.turn_tried[b, r] = belief.turn_tried[b, r] + wp.abs(turn) * model.decision_s
    shifted = seen_to_shift(belief, b, r)
    turned = member.radio_imu == 1 and belief.turn_felt[b, r] > wp.max(TURN_NOTICED * belief.turn_tried[b, r], 0.05)
    if shifted:
        belief.spinning[b, r] = 0
    if shifted or turned:
        forget_trying(belief, b, r)


@wp.func
def stuck(belief: Belief, member: MemberModel, model: StuckModel, b: int, r: int) -> bool:
    """Whether a robot has tried in vain for long enough."""
    tried = belief.tried_s[b, r]
    if member.radio_imu == 1 and tried >= model.stuck_s and belief.turn_tried[b, r] >= TURN_TESTED:
        return True
    return tried >= PUSHING * model.stuck_s and belief.unseen_s[b, r] < IN_SIGHT_S


@wp.func
def call_reserve(belief: Belief, b: int):
    """Ask the next waiting robot to leave the dock."""
    for r in range(belief.declared.shape[1]):
        if belief.declared[b, r] == WAITING and belief.undock[b, r] == 0:
            belief.undock[b, r] = 1
            return


@wp.kernel
def declare(
    belief: Belief, measured: Measurements, members: wp.array[MemberModel], model: StuckModel,
    running: wp.array[int],
):  # fmt: skip
    """Declare losses in every running team, mark where they happened and call reserves."""
    b = wp.tid()
    if running[b] == 0:
        return
    for r in range(members.shape[0]):
        belief.marked[b, r] = 0
        if belief.declared[b, r] == WORKING:
            fallen = measured.heard[b, r] == 1 and measured.accel[b, r, 0][2] < UPSIDE_DOWN
            if measured.heard[b, r] == 0 or fallen:
                belief.silent_s[b, r] = belief.silent_s[b, r] + model.decision_s
            else:
                belief.silent_s[b, r] = 0.0
                count_trying(belief, measured, members[r], model, b, r)
            silent = belief.silent_s[b, r] >= model.silent_s
            if silent or stuck(belief, members[r], model, b, r):
                belief.declared[b, r] = LOST
                belief.marked[b, r] = int(belief.battery[b, r] > EMPTY)
                belief.undock[b, r] = 0
                if members[r].picket == 1:
                    call_reserve(belief, b)

"""Sightings: poses of robots from LED images, fused or doubted.

Relative pose of robot j from the camera C of robot i, with residuals in camera axes (theta, p):

    p_hat = R_CG (p_j - p_i) - R_CB p_BC        dp = R_CG ([p_j - p_i]x theta_i - dp_i + dp_j)
    R_hat = R_CG R_j                            dtheta = R_CG (theta_j - theta_i)

Source: thesis eqs (5.11)-(5.13), corrected (the lever arm belongs in the body frame and not into the rotation block)
and written for Hamilton rotations with R = Exp(theta) R_hat.
"""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import POSITION, THETA, Belief, MemberModel
from coop_envs.estimation.kalman import (
    GATE_SIX,
    add_to_innovation,
    clear_rows,
    correct,
    row_times_covariance,
    whitened,
)
from coop_envs.geometry.so3 import log_so3
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import cholesky6, mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

ENOUGH_SIGHTINGS = wp.constant(25)
REJECTIONS = wp.constant(3)
FRESH_S = wp.constant(2.0)
DOUBT = wp.constant(wp.float64(0.01))


@wp.struct
class Sighting:
    """How a camera's view of a robot departs from the belief, and how the belief's errors move it.

    ``axes`` is R_CG, ``lever`` R_CG [p_j - p_i]x; ``camera`` and ``robot`` are the first columns of robots i and j.
    """

    axes: wp.mat33d
    lever: wp.mat33d
    residual: vec6d
    camera: int
    robot: int


@wp.func
def compare(belief: Belief, measured: Measurements, member: MemberModel, b: int, i: int, j: int) -> Sighting:
    """The pose of robot j from the camera of robot i against the belief."""
    view = Sighting()
    R_CG = wp.transpose(belief.rotation[b, i] * member.R_body_camera)
    d = belief.position[b, j] - belief.position[b, i]
    p_hat = R_CG * d - wp.transpose(member.R_body_camera) * member.p_body_camera
    turn = log_so3(wp.mat33d(measured.R_camera_body[b, i, j]) * wp.transpose(R_CG * belief.rotation[b, j]))
    shift = wp.vec3d(measured.p_camera_body[b, i, j]) - p_hat
    view.axes = R_CG
    view.lever = R_CG * wp.skew(d)
    view.residual = vec6d(turn[0], turn[1], turn[2], shift[0], shift[1], shift[2])
    view.camera = 15 * belief.slot[b, i]
    view.robot = 15 * belief.slot[b, j]
    return view


@wp.func
def project_rows(belief: Belief, rows: wp.array3d[wp.float64], b: int, view: Sighting, first: int, last: int):
    """rows = H P of a sighting, columns ``first`` up to ``last``."""
    clear_rows(rows, b, 6, first, last)
    row_times_covariance(belief, rows, b, 0, -view.axes, view.camera + THETA, first, last)
    row_times_covariance(belief, rows, b, 0, view.axes, view.robot + THETA, first, last)
    row_times_covariance(belief, rows, b, 3, view.lever, view.camera + THETA, first, last)
    row_times_covariance(belief, rows, b, 3, -view.axes, view.camera + POSITION, first, last)
    row_times_covariance(belief, rows, b, 3, view.axes, view.robot + POSITION, first, last)


@wp.func
def innovation(rows: wp.array3d[wp.float64], b: int, view: Sighting, noise: mat66d) -> mat66d:
    """S = H P H^T + noise from rows = H P."""
    total = add_to_innovation(noise, rows, b, 6, 0, -view.axes, view.camera + THETA)
    total = add_to_innovation(total, rows, b, 6, 0, view.axes, view.robot + THETA)
    total = add_to_innovation(total, rows, b, 6, 3, view.lever, view.camera + THETA)
    total = add_to_innovation(total, rows, b, 6, 3, -view.axes, view.camera + POSITION)
    return add_to_innovation(total, rows, b, 6, 3, view.axes, view.robot + POSITION)


@wp.func
def calibration_noise(member: MemberModel, p: wp.vec3d) -> mat66d:
    """What errors of the focal length and the principal point add to the covariance of a pose at p (camera axes).

    A longer focal length brings the robot nearer, a shifted centre turns all that the camera sees. Such errors do not
    average out, but sightings are fused as if they did: so they count as often as a pair at rest is averaged.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    nearer = vec6d(zero, zero, zero, zero, zero, p[2]) * member.focal_sigma
    pitched = vec6d(one, zero, zero, zero, -p[2], p[1]) * member.centre_sigma
    panned = vec6d(zero, one, zero, p[2], zero, -p[0]) * member.centre_sigma
    total = wp.outer(nearer, nearer) + wp.outer(pitched, pitched) + wp.outer(panned, panned)
    return total * wp.float64(ENOUGH_SIGHTINGS)


@wp.func
def pose_noise(measured: Measurements, member: MemberModel, b: int, i: int, j: int) -> mat66d:
    """Covariance of the pose of robot j from the camera of robot i."""
    return measured.covariance[b, i, j] + calibration_noise(member, wp.vec3d(measured.p_camera_body[b, i, j]))


@wp.func
def correct_pose(
    belief: Belief, measured: Measurements, member: MemberModel, rows: wp.array3d[wp.float64],
    b: int, i: int, j: int,
) -> bool:  # fmt: skip
    """Update with the pose of robot j from the camera of robot i."""
    view = compare(belief, measured, member, b, i, j)
    project_rows(belief, rows, b, view, 0, 15 * belief.slots[b])
    S = innovation(rows, b, view, pose_noise(measured, member, b, i, j))
    return correct(belief, rows, b, 6, S, view.residual, GATE_SIX)


@wp.func
def confirm_pose(
    belief: Belief, measured: Measurements, member: MemberModel, rows: wp.array3d[wp.float64],
    b: int, i: int, j: int,
) -> bool:  # fmt: skip
    """Whether a pose would pass the gate; nothing is updated."""
    view = compare(belief, measured, member, b, i, j)
    project_rows(belief, rows, b, view, view.camera, view.camera + 6)
    project_rows(belief, rows, b, view, view.robot, view.robot + 6)
    L = cholesky6(innovation(rows, b, view, pose_noise(measured, member, b, i, j)))
    y = whitened(L, view.residual, 6)
    return L[0, 0] > wp.float64(0.0) and wp.dot(y, y) <= GATE_SIX


@wp.func
def doubt(belief: Belief, b: int, r: int):
    """A robot whose sightings fail the gate in a row was moved or slipped: its pose is believed ever less."""
    row = 15 * belief.slot[b, r]
    for k in range(6):
        belief.covariance[b, row + k, row + k] = wp.float64(2.0) * belief.covariance[b, row + k, row + k] + DOUBT
    belief.rejected[b, r] = 0
    belief.stationary[b, r] = 0
    belief.rest_s[b, r] = 0.0


@wp.func
def blame(belief: Belief, b: int, i: int, j: int, refused: int, accepted: int) -> int:
    """Whose pose is off when camera i sees robot j elsewhere.

    The camera's, if it sees all elsewhere, or alone moves among robots that it saw in their places just before.
    """
    alone = belief.stationary[b, i] == 0 and belief.stationary[b, j] == 1 and belief.unseen_s[b, j] < FRESH_S
    if accepted == 0 and (refused > 1 or alone):
        return i
    return j


@wp.func
def fuse_sightings(
    belief: Belief, measured: Measurements, members: wp.array[MemberModel], rows: wp.array3d[wp.float64],
    b: int, i: int,
):  # fmt: skip
    """Fuse what camera i saw. Between two robots at rest the same view is only checked after a while."""
    accepted = int(0)
    refused = int(0)
    suspect = int(-1)
    for j in range(members.shape[0]):
        belief.seen[b, i, j] = 0
        if measured.seen[b, i, j] == 1 and belief.slot[b, i] >= 0 and belief.slot[b, j] >= 0:
            resting = belief.stationary[b, i] == 1 and belief.stationary[b, j] == 1
            if resting and belief.averaged[b, i, j] >= ENOUGH_SIGHTINGS:
                belief.seen[b, i, j] = int(confirm_pose(belief, measured, members[i], rows, b, i, j))
            elif correct_pose(belief, measured, members[i], rows, b, i, j):
                belief.seen[b, i, j] = 1
                belief.averaged[b, i, j] = belief.averaged[b, i, j] + 1
            if belief.seen[b, i, j] == 1:
                accepted = accepted + 1
                belief.rejected[b, j] = 0
            else:
                refused = refused + 1
    if accepted > 0:
        belief.rejected[b, i] = 0
    for j in range(members.shape[0]):
        out_of_place = measured.seen[b, i, j] == 1 and belief.seen[b, i, j] == 0
        if out_of_place and belief.slot[b, i] >= 0 and belief.slot[b, j] >= 0:
            culprit = blame(belief, b, i, j, refused, accepted)
            if culprit != suspect:
                suspect = culprit
                belief.rejected[b, culprit] = belief.rejected[b, culprit] + 1
                if belief.rejected[b, culprit] >= REJECTIONS:
                    doubt(belief, b, culprit)

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
from coop_envs.estimation.kalman import GATE_SIX, correct_six, passes, row3, whitening
from coop_envs.estimation.rows import Rows
from coop_envs.geometry.so3 import log_so3
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import mat66d, vec6d

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
def project(rows: Rows, b: int, view: Sighting, s: int):
    """The rows H P of a sighting, the entries of slot s."""
    i = view.camera
    j = view.robot
    x = rows.covariance[b, i + THETA, s]
    y = rows.covariance[b, i + THETA + 1, s]
    z = rows.covariance[b, i + THETA + 2, s]
    tx = rows.covariance[b, j + THETA, s] - x
    ty = rows.covariance[b, j + THETA + 1, s] - y
    tz = rows.covariance[b, j + THETA + 2, s] - z
    px = rows.covariance[b, j + POSITION, s] - rows.covariance[b, i + POSITION, s]
    py = rows.covariance[b, j + POSITION + 1, s] - rows.covariance[b, i + POSITION + 1, s]
    pz = rows.covariance[b, j + POSITION + 2, s] - rows.covariance[b, i + POSITION + 2, s]
    for k in range(3):
        rows.projected[b, k, s] = tx * view.axes[k, 0] + ty * view.axes[k, 1] + tz * view.axes[k, 2]
        arm = x * view.lever[k, 0] + y * view.lever[k, 1] + z * view.lever[k, 2]
        rows.projected[b, 3 + k, s] = arm + px * view.axes[k, 0] + py * view.axes[k, 1] + pz * view.axes[k, 2]


@wp.func
def innovation(rows: Rows, b: int, view: Sighting, noise: mat66d) -> mat66d:
    """S = H P H^T + noise from the projected rows."""
    total = noise
    for m in range(6):
        own = row3(rows, b, m, view.camera + THETA)
        turn = view.axes * (row3(rows, b, m, view.robot + THETA) - own)
        shift = row3(rows, b, m, view.robot + POSITION) - row3(rows, b, m, view.camera + POSITION)
        place = view.lever * own + view.axes * shift
        for k in range(3):
            total[m, k] = total[m, k] + turn[k]
            total[m, 3 + k] = total[m, 3 + k] + place[k]
    return total


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
    covariance = measured.covariance[b, i, j]
    if member.focal_sigma > wp.float64(0.0) or member.centre_sigma > wp.float64(0.0):
        covariance = covariance + calibration_noise(member, wp.vec3d(measured.p_camera_body[b, i, j]))
    return covariance


@wp.func
def correct_pose(
    belief: Belief, measured: Measurements, member: MemberModel, rows: Rows, b: int, i: int, j: int
) -> bool:
    """Update with the pose of robot j from the camera of robot i."""
    view = compare(belief, measured, member, b, i, j)
    for s in range(belief.slots[b]):
        project(rows, b, view, s)
    white = whitening(innovation(rows, b, view, pose_noise(measured, member, b, i, j)), view.residual)
    if not passes(white, GATE_SIX):
        return False
    correct_six(belief, rows, b, white)
    return True


@wp.func
def confirm_pose(
    belief: Belief, measured: Measurements, member: MemberModel, rows: Rows, b: int, i: int, j: int
) -> bool:
    """Whether a pose would pass the gate; nothing is updated."""
    view = compare(belief, measured, member, b, i, j)
    project(rows, b, view, belief.slot[b, i])
    project(rows, b, view, belief.slot[b, j])
    S = innovation(rows, b, view, pose_noise(measured, member, b, i, j))
    return passes(whitening(S, view.residual), GATE_SIX)


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
    belief: Belief, measured: Measurements, members: wp.array[MemberModel], rows: Rows,
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

"""Sightings: poses of robots from LED images, fused or doubted.

Relative pose of robot j from the camera C of robot i, with residuals in camera axes (theta, p):

    p_hat = R_CG (p_j - p_i) - R_CB p_BC        dp = R_CG ([p_j - p_i]x theta_i - dp_i + dp_j)
    R_hat = R_CG R_j                            dtheta = R_CG (theta_j - theta_i)

Source: thesis eqs (5.11)-(5.13), corrected (the lever arm belongs in the body frame and not into the rotation block)
and written for Hamilton rotations with R = Exp(theta) R_hat.
"""

# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import POSITION, THETA, Belief, MemberModel
from coop_envs.estimation.calibration import (
    Optics,
    Seen,
    add_effects,
    effect_innovation,
    effect_of_kept,
    effect_shift,
    find_effects,
)
from coop_envs.estimation.kalman import GATE_SIX, Whitening, keep_six, kept3, passes, row3, settle, whitening
from coop_envs.estimation.propagation import FilterModel
from coop_envs.estimation.rows import Rows
from coop_envs.geometry.so3 import log_so3
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

ENOUGH_SIGHTINGS = wp.constant(25)
ACCEPTED, HELD, REFUSED, SINGLE = (wp.constant(k) for k in (1, 2, 3, 4))
"""What becomes of a sighting: fused or in its place, to be confirmed, elsewhere again, elsewhere for once."""
REJECTIONS = wp.constant(3)
REJECTED_S = wp.constant(0.3)
FRESH_S = wp.constant(2.0)
NEWEST = wp.constant(wp.float64(1.0 / 16.0))
GATE_WANDERING = wp.constant(wp.float64(38.3))
"""Chi-square with six degrees of freedom at a probability of 1e-6."""
FAR_OFF = wp.constant(wp.float64(100.0))
DOUBT = wp.constant(wp.float64(0.01))


@wp.struct
class Sighting:
    """How a camera's view of a robot departs from the belief, and how the belief's errors move it.

    ``rotation`` and ``position`` are the pose that it should give, ``axes`` is R_CG, ``lever`` R_CG [p_j - p_i]x at the
    first estimates; ``camera`` and ``robot`` are the first columns of robots i and j.
    """

    rotation: wp.mat33d
    position: wp.vec3d
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
    R_hat = R_CG * belief.rotation[b, j]
    turn = log_so3(wp.mat33d(measured.R_camera_body[b, i, j]) * wp.transpose(R_hat))
    shift = wp.vec3d(measured.p_camera_body[b, i, j]) - p_hat
    view.rotation = R_hat
    view.position = p_hat
    view.axes = R_CG
    view.lever = R_CG * wp.skew(belief.first_position[b, j] - belief.first_position[b, i])
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
def shake_noise(member: MemberModel, p: wp.vec3d) -> mat66d:
    """What a camera that shakes about its axes adds to the covariance of a pose at p (camera axes)."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    pitched = vec6d(one, zero, zero, zero, -p[2], p[1])
    panned = vec6d(zero, one, zero, p[2], zero, -p[0])
    rolled = vec6d(zero, zero, one, -p[1], p[0], zero)
    total = wp.outer(pitched, pitched) + wp.outer(panned, panned) + wp.outer(rolled, rolled)
    return total * (member.camera_shake * member.camera_shake)


@wp.func
def pose_noise(belief: Belief, measured: Measurements, member: MemberModel, b: int, i: int, j: int) -> mat66d:
    """Covariance of the pose of robot j from the camera of robot i."""
    covariance = measured.covariance[b, i, j]
    if belief.stationary[b, i] == 0 and member.camera_shake > wp.float64(0.0):
        covariance = covariance + shake_noise(member, wp.vec3d(measured.p_camera_body[b, i, j]))
    return covariance


@wp.func
def bend_noise(belief: Belief, view: Sighting, b: int) -> mat66d:
    """What the first order leaves out: a camera found elsewhere that is unsure of its axes cannot say just where.

    That is the shift across the camera's error of axes: centimetres when a robot is seen again after a long way in the
    dark, else nothing. Without it the correction would claim more than it can know.
    """
    row = view.camera + THETA
    P = belief.covariance
    variance = (P[b, row, row] + P[b, row + 1, row + 1] + P[b, row + 2, row + 2]) / wp.float64(3.0)
    shift = wp.vec3d(view.residual[3], view.residual[4], view.residual[5])
    bend = (wp.identity(n=3, dtype=wp.float64) * wp.dot(shift, shift) - wp.outer(shift, shift)) * variance
    total = mat66d()
    for m in range(3):
        for k in range(3):
            total[3 + m, 3 + k] = bend[m, k]
    return total


@wp.struct
class Verdict:
    """A sighting compared with the belief: its noise, its whitened residual and what it was whitened with."""

    view: Sighting
    noise: mat66d
    spread: mat66d
    white: Whitening


@wp.func
def is_far(residual: vec6d, noise: mat66d) -> bool:
    """Whether a robot is seen so far from where it is believed that the belief must be the one that is off."""
    off = wp.vec3d(residual[3], residual[4], residual[5])
    return wp.length_sq(off) > FAR_OFF * (noise[3, 3] + noise[4, 4] + noise[5, 5])


@wp.func
def surer_pose(
    measured: Measurements, other: MemberModel, view: Sighting, noise: mat66d, b: int, i: int, j: int
) -> Seen:
    """A pose at which to ask for the effect of calibrations: the predicted one, or where that is far off the measured.

    At the measured one, noise would make it seem as if every frame showed the hat from another side, which would feign
    knowledge; after a long way in the dark the predicted one is the worse guess.
    """
    seen = Seen()
    seen.i = i
    seen.j = j
    seen.leds = measured.leds[b, i, j]
    seen.R = view.rotation
    seen.p = view.position
    seen.hat_slot = other.hat_slot
    if is_far(view.residual, noise):
        seen.R = wp.mat33d(measured.R_camera_body[b, i, j])
        seen.p = wp.vec3d(measured.p_camera_body[b, i, j])
        seen.hat_slot = -1
    return seen


@wp.func
def judge(
    belief: Belief, measured: Measurements, members: wp.array[MemberModel], optics: Optics, rows: Rows,
    b: int, i: int, j: int, whole: bool,
) -> Verdict:  # fmt: skip
    """Compare a pose with the belief; its rows are projected for the two robots alone or for the ``whole`` team."""
    out = Verdict()
    out.view = compare(belief, measured, members[i], b, i, j)
    out.noise = pose_noise(belief, measured, members[i], b, i, j)
    calibrated = members[i].camera_slot >= 0 or members[j].hat_slot >= 0
    if calibrated:
        seen = surer_pose(measured, members[j], out.view, out.noise, b, i, j)
        find_effects(belief, rows, optics, members[i], members[j], b, seen)
        out.view.residual = out.view.residual - effect_shift(belief, rows, optics, members[i], members[j], b, j)
    for s in range(belief.slots[b]):
        if whole or calibrated or s == belief.slot[b, i] or s == belief.slot[b, j]:
            project(rows, b, out.view, s)
            if calibrated:
                add_effects(rows, optics, members[i], members[j], b, j, s)
    subtract_kept(belief, rows, optics, members, out.view, b, i, j)
    out.noise = out.noise + bend_noise(belief, out.view, b)
    out.spread = innovation(rows, b, out.view, out.noise)
    if calibrated:
        out.spread = out.spread + effect_innovation(rows, optics, members[i], members[j], b, j)
    out.white = whitening(out.spread, out.view.residual)
    return out


@wp.func
def wanders(belief: Belief, verdict: Verdict, b: int, i: int, j: int) -> bool:
    """Whether a pair that is taken to rest drifts apart: the mean of sightings shows it before a single one does.

    The newest counts a sixteenth, so the mean has a 31st of a sighting's noise, besides what the belief is unsure of.
    """
    mean = belief.wandered[b, i, j] + (verdict.view.residual - belief.wandered[b, i, j]) * NEWEST
    belief.wandered[b, i, j] = mean
    noise = verdict.noise * (NEWEST / (wp.float64(2.0) - NEWEST))
    return not passes(whitening(verdict.spread - verdict.noise + noise, mean), GATE_WANDERING)


@wp.func
def seen_of_kept(rows: Rows, view: Sighting, b: int, p: int) -> vec6d:
    """H n of a row n that is kept, without calibration states."""
    own = kept3(rows, b, p, view.camera + THETA)
    turn = view.axes * (kept3(rows, b, p, view.robot + THETA) - own)
    shift = kept3(rows, b, p, view.robot + POSITION) - kept3(rows, b, p, view.camera + POSITION)
    place = view.lever * own + view.axes * shift
    return vec6d(turn[0], turn[1], turn[2], place[0], place[1], place[2])


@wp.func
def subtract_kept(
    belief: Belief, rows: Rows, optics: Optics, members: wp.array[MemberModel], view: Sighting, b: int, i: int, j: int
):
    """Projected rows fall by what the kept ones mean for them: H (P - N^T N) = H P - (H N^T) N."""
    for p in range(rows.pending[b]):
        h = seen_of_kept(rows, view, b, p)
        if members[i].camera_slot >= 0 or members[j].hat_slot >= 0:
            h = h + effect_of_kept(rows, optics, members[i], members[j], b, j, p)
        for s in range(belief.slots[b]):
            kept = rows.kept[b, p, s]
            for m in range(6):
                rows.projected[b, m, s] = rows.projected[b, m, s] - kept * h[m]


@wp.func
def agrees(belief: Belief, verdict: Verdict, b: int, i: int, j: int) -> bool:
    """Whether a sighting that failed the gate shows a robot where the last one that did showed it; it is kept."""
    apart = whitening(verdict.spread * wp.float64(2.0), verdict.view.residual - belief.refused[b, i, j])
    belief.refused[b, i, j] = verdict.view.residual
    return passes(apart, GATE_SIX)


@wp.func
def waits(belief: Belief, verdict: Verdict, b: int, i: int, j: int) -> bool:
    """Whether a sighting has to be confirmed by the next one before it counts; it is kept.

    After a long way in the dark anything passes the gate, a reflection too. Two of them in a row do not agree.
    """
    if not is_far(verdict.view.residual, verdict.noise):
        return False
    apart = whitening(verdict.noise * wp.float64(2.0), verdict.view.residual - belief.refused[b, i, j])
    belief.refused[b, i, j] = verdict.view.residual
    return not passes(apart, GATE_SIX)


@wp.func
def doubt(belief: Belief, b: int, r: int):
    """A robot whose sightings fail the gate and agree was moved or slipped: its pose is believed ever less."""
    row = 15 * belief.slot[b, r]
    for k in range(6):
        belief.covariance[b, row + k, row + k] = wp.float64(2.0) * belief.covariance[b, row + k, row + k] + DOUBT
    belief.rejected[b, r] = 0
    belief.stationary[b, r] = 0
    belief.rest_s[b, r] = 0.0
    belief.demoted[b, r] = 1


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
def suspect(belief: Belief, model: FilterModel, b: int, r: int):
    """Count one more sighting that tells of robot r elsewhere; enough of them over a while bring doubt."""
    if belief.rejected[b, r] == 0:
        belief.rejected_s[b, r] = 0.0
    else:
        belief.rejected_s[b, r] = belief.rejected_s[b, r] + model.decision_s
    belief.rejected[b, r] = belief.rejected[b, r] + 1
    if belief.rejected[b, r] >= REJECTIONS and belief.rejected_s[b, r] >= REJECTED_S:
        doubt(belief, b, r)


@wp.func
def take_in(
    belief: Belief, measured: Measurements, members: wp.array[MemberModel], optics: Optics, rows: Rows,
    b: int, i: int, j: int,
) -> int:  # fmt: skip
    """Fuse, check or refuse what camera i saw of robot j. Between two at rest it is only checked after a while."""
    resting = belief.stationary[b, i] == 1 and belief.stationary[b, j] == 1
    only_check = resting and belief.averaged[b, i, j] >= ENOUGH_SIGHTINGS
    verdict = judge(belief, measured, members, optics, rows, b, i, j, not only_check)
    if not passes(verdict.white, GATE_SIX):
        if agrees(belief, verdict, b, i, j):
            return REFUSED
        return SINGLE
    if only_check:
        if wanders(belief, verdict, b, i, j):
            return REFUSED
        return ACCEPTED
    if waits(belief, verdict, b, i, j):
        return HELD
    keep_six(belief, rows, b, verdict.white)
    belief.averaged[b, i, j] = belief.averaged[b, i, j] + 1
    belief.wandered[b, i, j] = vec6d()
    return ACCEPTED


@wp.func
def fuse_sightings(
    belief: Belief, measured: Measurements, members: wp.array[MemberModel], optics: Optics, model: FilterModel,
    rows: Rows, b: int, i: int,
):  # fmt: skip
    """Fuse what camera i saw, and doubt robots that it keeps seeing elsewhere."""
    accepted = int(0)
    refused = int(0)
    for j in range(members.shape[0]):
        belief.seen[b, i, j] = 0
        if measured.seen[b, i, j] == 1 and belief.slot[b, i] >= 0 and belief.slot[b, j] >= 0:
            answer = take_in(belief, measured, members, optics, rows, b, i, j)
            belief.seen[b, i, j] = answer
            accepted = accepted + int(answer == ACCEPTED)
            refused = refused + int(answer == REFUSED)
            if answer == ACCEPTED:
                belief.rejected[b, j] = 0
            elif answer == SINGLE:
                belief.rejected[b, i] = 0
                belief.rejected[b, j] = 0
    if rows.pending[b] > 0:
        settle(rows, b, belief.slots[b])
    if accepted > 0:
        belief.rejected[b, i] = 0
    last = int(-1)
    for j in range(members.shape[0]):
        answer = belief.seen[b, i, j]
        belief.seen[b, i, j] = int(answer == ACCEPTED)
        if answer >= REFUSED:
            culprit = blame(belief, b, i, j, refused, accepted)
            if culprit != last:
                last = culprit
                suspect(belief, model, b, culprit)

"""Absolute fixes: a robot's position or pose told from outside, in the frame that the belief is held in.

A position has three rows, the identity on the robot's position errors; a pose six, the identity on (theta, p), with the
residual Log(R R_hat^T). Fixes beyond the gate, which 999 of 1000 right ones pass, change nothing.

Source: thesis section 4.1.2; `localization.placing` carries a belief into the frame of the first fixes.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.estimation.belief import POSITION, THETA, Belief
from coop_envs.estimation.kalman import (
    GATE_SIX,
    correct_six,
    correct_three,
    inverse_factor,
    passes,
    row3,
    whitening,
)
from coop_envs.estimation.propagation import follow_shift, linearise
from coop_envs.estimation.rows import Rows
from coop_envs.geometry.arrays import allocate
from coop_envs.geometry.so3 import log_so3
from coop_envs.sensing.poses import mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

GATE_THREE = wp.constant(wp.float64(16.27))


@wp.struct
class Fixes:
    """One fix for each of B teams.

    robot, whole
        which robot, -1 for none; 1 where its rotation is known too.
    position, rotation
        of its body, in the belief's frame.
    covariance
        of the fix's errors (theta, p), the rotation's from the left; of p alone counts where ``whole`` is 0.
    accepted
        1 where the fix was fused, set by `fuse_fixes`.
    """

    robot: wp.array[int]
    whole: wp.array[int]
    position: wp.array[wp.vec3d]
    rotation: wp.array[wp.mat33d]
    covariance: wp.array[mat66d]
    accepted: wp.array[int]


@wp.func
def copy_rows(rows: Rows, b: int, row: int, count: int):
    """Project by the identity on ``count`` states from ``row`` on."""
    for s in range(rows.projected.shape[2]):
        for m in range(count):
            rows.projected[b, m, s] = rows.covariance[b, row + m, s]


@wp.func
def correct_place(belief: Belief, rows: Rows, fixes: Fixes, b: int, r: int) -> bool:
    """Update with the position of robot r."""
    row = 15 * belief.slot[b, r] + POSITION
    copy_rows(rows, b, row, 3)
    S = wp.mat33d()
    for m in range(3):
        own = row3(rows, b, m, row)
        for k in range(3):
            S[m, k] = own[k] + fixes.covariance[b][3 + m, 3 + k]
    residual = fixes.position[b] - belief.position[b, r]
    factor = inverse_factor(S)
    if factor[0, 0] == wp.float64(0.0) or wp.length_sq(factor * residual) > GATE_THREE:
        return False
    return correct_three(belief, rows, b, S, residual)


@wp.func
def correct_whole(belief: Belief, rows: Rows, fixes: Fixes, b: int, r: int) -> bool:
    """Update with the pose of robot r."""
    row = 15 * belief.slot[b, r]
    copy_rows(rows, b, row, 6)
    S = fixes.covariance[b]
    for m in range(6):
        turn = row3(rows, b, m, row + THETA)
        shift = row3(rows, b, m, row + POSITION)
        for k in range(3):
            S[m, k] = S[m, k] + turn[k]
            S[m, 3 + k] = S[m, 3 + k] + shift[k]
    theta = log_so3(fixes.rotation[b] * wp.transpose(belief.rotation[b, r]))
    d = fixes.position[b] - belief.position[b, r]
    white = whitening(S, vec6d(theta[0], theta[1], theta[2], d[0], d[1], d[2]))
    if not passes(white, GATE_SIX):
        return False
    correct_six(belief, rows, b, white)
    return True


@wp.func
def keep_covariances(belief: Belief, b: int):
    """Copy the (theta, p) blocks to where they are read."""
    for r in range(belief.slot.shape[1]):
        slot = belief.slot[b, r]
        if slot >= 0:
            pose = mat66d()
            for i in range(6):
                for k in range(6):
                    pose[i, k] = belief.covariance[b, 15 * slot + i, 15 * slot + k]
            belief.pose_covariance[b, r] = pose


@wp.kernel
def fuse_fixes(belief: Belief, fixes: Fixes, rows: Rows):
    """Fuse a fix of one robot into the belief of every team that has one."""
    b = wp.tid()
    fixes.accepted[b] = 0
    r = fixes.robot[b]
    if r < 0:
        return
    if belief.slot[b, r] < 0:
        return
    linearise(belief, b)
    if fixes.whole[b] == 1:
        fixes.accepted[b] = int(correct_whole(belief, rows, fixes, b, r))
    else:
        fixes.accepted[b] = int(correct_place(belief, rows, fixes, b, r))
    follow_shift(belief, rows, b)
    keep_covariances(belief, b)


class FixFuser:
    """Fuses fixes into a belief whose covariance ``rows`` view, one fix of one robot at a time."""

    def __init__(self, belief: Belief, rows: Rows) -> None:
        self._fixes: Fixes = allocate(Fixes, (belief.slot.shape[0],), str(belief.slot.device))
        self._fixes.robot.fill_(-1)
        self._launch = wp.launch(
            fuse_fixes,
            belief.slot.shape[0],
            inputs=[belief, self._fixes, rows],
            device=belief.slot.device,
            record_cmd=True,
        )

    def fuse(
        self,
        robot: int,
        position: NDArray[np.float64],
        rotation: NDArray[np.float64] | None,
        covariance: NDArray[np.float64],
        team: int = 0,
    ) -> bool:
        """Fuse robot's position (3,) or, with ``rotation`` (3, 3), pose into one team's belief; False beyond the gate.

        ``covariance`` (3, 3) of the position or (6, 6) of (theta, p), the rotation's error from the left; axes of the
        belief's frame. Robots outside the filter cannot be fixed: False.
        """
        fixes, whole = self._fixes, np.zeros((6, 6))
        whole[6 - len(covariance) :, 6 - len(covariance) :] = covariance
        chosen = np.full(fixes.robot.shape, -1, dtype=np.int32)
        chosen[team] = robot
        turn = np.eye(3) if rotation is None else rotation
        fixes.robot.assign(chosen)
        fixes.whole.fill_(int(rotation is not None))
        fixes.position.assign(np.broadcast_to(position, (len(chosen), 3)))
        fixes.rotation.assign(np.broadcast_to(turn, (len(chosen), 3, 3)))
        fixes.covariance.assign(np.broadcast_to(whole, (len(chosen), 6, 6)))
        self._launch.launch()
        return bool(fixes.accepted.numpy()[team])

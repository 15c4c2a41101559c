"""Ranges: laser spots that two resting cameras saw at the same time become points of the team frame.

Where the laser pointed is not asked: nobody measures it. Of several pairs of cameras the one that places the spot best
counts.

Source: thesis section 6.2.1; stamps within 1 ms as the authors pair them.
"""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.estimation.belief import NO_SLOT, WORKING, Belief, MemberModel
from coop_envs.estimation.rows import Rows
from coop_envs.sensing.camera import CameraModel, bearing_d
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.triangulation import OK, Fix, Limits, SpotView, mat1212d, optimal

wp.set_module_options({"enable_backward": False, "max_unroll": 6})

SAME_TIME_S = wp.constant(1.0e-3)
GAP_GATE = 9.0
NO_PAIR = wp.constant(-1)


@wp.struct
class Points:
    """What the scan rays of a decision hit, arrays over B teams and T ticks.

    position, covariance
        (B, T) in the team frame, m and m^2.
    answer
        (B, T) a `triangulation.Answer`, or `NO_PAIR` where no two resting cameras saw a spot.
    cameras
        (B, T) the two robots that saw it.
    count
        (B,) points of this decision.
    """

    position: wp.array2d[wp.vec3]
    covariance: wp.array2d[wp.mat33]
    answer: wp.array2d[int]
    cameras: wp.array2d[wp.vec2i]
    count: wp.array[int]


@wp.struct
class RangingModel:
    """Limits of an answer, and standard deviations of the cameras' calibration (focal length relative, centre px)."""

    limits: Limits
    focal_sigma: wp.float64
    centre_sigma: wp.float64


@wp.func
def can_range(belief: Belief, cameras: wp.array[CameraModel], b: int, i: int) -> bool:
    """Whether a robot's spots count: at work, at rest, in the filter, with a camera."""
    at_rest = belief.declared[b, i] == WORKING and belief.stationary[b, i] == 1
    return at_rest and belief.slot[b, i] != NO_SLOT and cameras[i].fitted == 1


@wp.func
def joint_covariance(rows: Rows, b: int, i: int, j: int) -> mat1212d:
    """Covariance of (theta_i, p_i, theta_j, p_j) of the robots in slots i and j."""
    joint = mat1212d()
    for k in range(6):
        ii = rows.covariance[b, 15 * i + k, i]
        ij = rows.covariance[b, 15 * i + k, j]
        jj = rows.covariance[b, 15 * j + k, j]
        for c in range(6):
            joint[k, c] = ii[c]
            joint[k, 6 + c] = ij[c]
            joint[6 + c, k] = ij[c]
            joint[6 + k, 6 + c] = jj[c]
    return joint


@wp.func
def spot_view(
    belief: Belief, measured: Measurements, member: MemberModel, camera: CameraModel, model: RangingModel,
    b: int, i: int, t: int,
) -> SpotView:  # fmt: skip
    """What robot i's camera knows of the spot in tick t."""
    view = SpotView()
    view.R_team_body = belief.rotation[b, i]
    view.p_team_body = belief.position[b, i]
    view.R_body_camera = member.R_body_camera
    view.p_body_camera = member.p_body_camera
    view.direction = bearing_d(camera, wp.vec2d(measured.spot[b, i, t]))
    view.focal = wp.vec2d(camera.focal)
    view.noise_px = wp.float64(measured.spot_sigma[b, i, t])
    view.focal_sigma = model.focal_sigma
    view.centre_sigma_px = model.centre_sigma
    return view


@wp.func
def enter(points: Points, fix: Fix, b: int, t: int, i: int, j: int):
    """Keep an answer if it is the tick's first, or better than the one there."""
    had = points.answer[b, t]
    covariance = wp.mat33(fix.covariance)
    better = had != OK or wp.trace(covariance) < wp.trace(points.covariance[b, t])
    if fix.answer == OK and better:
        points.position[b, t] = wp.vec3(fix.point)
        points.covariance[b, t] = covariance
        points.cameras[b, t] = wp.vec2i(i, j)
        points.answer[b, t] = OK
    elif had == NO_PAIR:
        points.answer[b, t] = fix.answer


@wp.func
def is_lit(command: Command, b: int, t: int) -> bool:
    """Whether any laser of a team was told to be lit in a tick."""
    power = float(0.0)
    for r in range(command.laser.shape[1]):
        power = power + command.laser[b, r, t]
    return power > 0.0


@wp.kernel
def find_range(
    belief: Belief, measured: Measurements, command: Command, members: wp.array[MemberModel],
    cameras: wp.array[CameraModel], model: RangingModel, rows: Rows, points: Points, running: wp.array[int],
):  # fmt: skip
    """Triangulate the spots of every running team's last decision, of the ticks in which a laser was lit."""
    b = wp.tid()
    if running[b] == 0:
        return
    points.count[b] = 0
    ticks = points.answer.shape[1]
    for t in range(ticks):
        points.answer[b, t] = NO_PAIR
    n = members.shape[0]
    for i in range(n):
        for j in range(i + 1, n):
            if can_range(belief, cameras, b, i) and can_range(belief, cameras, b, j):
                joint = joint_covariance(rows, b, belief.slot[b, i], belief.slot[b, j])
                for t in range(ticks):
                    both = measured.spot_sigma[b, i, t] > 0.0 and measured.spot_sigma[b, j, t] > 0.0
                    if (
                        both
                        and is_lit(command, b, t)
                        and wp.abs(measured.spot_stamp[b, i, t] - measured.spot_stamp[b, j, t]) <= SAME_TIME_S
                    ):
                        first = spot_view(belief, measured, members[i], cameras[i], model, b, i, t)
                        second = spot_view(belief, measured, members[j], cameras[j], model, b, j, t)
                        enter(points, optimal(first, second, joint, model.limits), b, t, i, j)
    for t in range(ticks):
        points.count[b] = points.count[b] + int(points.answer[b, t] == OK)

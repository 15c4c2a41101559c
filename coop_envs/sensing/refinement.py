"""A hat's pose from the blobs assigned to its LEDs: damped Gauss-Newton on the reprojection error, robust.

Each pixel is weighed with its own noise; beyond the gate its pull no longer grows (Huber). After convergence each LED
takes the blob next to where it should be, if that lies inside the gate, until nothing changes.

Source: thesis section 5.2.3 (Gauss-Newton of Faessler et al.); damping: Levenberg and Marquardt.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

from coop_envs.geometry.so3 import exp_so3, orthonormal
from coop_envs.sensing.camera import CameraModel
from coop_envs.sensing.features import Features
from coop_envs.sensing.hats import Hats
from coop_envs.sensing.poses import (
    cholesky6,
    information_of,
    led_rows,
    mat66d,
    solve_cholesky6,
    vec6d,
)

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

GATE = wp.constant(wp.float64(18.4))
"""Chi-square with two degrees of freedom at a probability of 1e-4."""
ROUNDS = wp.constant(3)
STEPS = wp.constant(8)
SETTLED = wp.constant(wp.float64(1.0e-5))
NEAREST_M = wp.constant(wp.float64(0.03))


class vec8i(wp.types.vector(length=8, dtype=int)):  # noqa: N801 - a Warp type, named as Warp names its own
    """A blob for each LED of a hat; -1 for none."""


@wp.struct
class Pose:
    """A hat's pose in camera axes with the blobs that it explains.

    ``score`` is the log-likelihood over that of blobs which have nothing to do with the hat; -1 where the pose fails.
    """

    rotation: wp.mat33d
    position: wp.vec3d
    blob: vec8i
    inliers: int
    score: wp.float64


@wp.struct
class Workspace:
    """Scratch of the solver: rays, noise (px) and owners of blobs; for each LED of a hat its candidate blobs."""

    ray: wp.array3d[wp.vec3d]
    sigma: wp.array3d[wp.float64]
    owner: wp.array3d[int]
    candidates: wp.array3d[int]
    candidate: wp.array4d[int]
    pose: wp.array3d[Pose]


@wp.struct
class Fit:
    """Information, gradient and robust cost (half chi-square) of a pose; ``cost`` is negative behind the camera."""

    information: mat66d
    gradient: vec6d
    cost: wp.float64


@wp.func
def linearised(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, b: int, i: int, j: int,
    rotation: wp.mat33d, position: wp.vec3d, blob: vec8i,
) -> Fit:  # fmt: skip
    """Normal equations of a pose of hat j in camera i."""
    out = Fit()
    for k in range(hats.leds[j]):
        if blob[k] >= 0:
            arm = rotation * wp.vec3d(hats.position[j, k])
            if arm[2] + position[2] < NEAREST_M:
                out.cost = wp.float64(-1.0)
                return out
            rows = led_rows(camera, arm, position)
            sigma = work.sigma[b, i, blob[k]]
            weight = wp.float64(1.0) / (sigma * sigma)
            e = wp.vec2d(features.pixel[b, i, blob[k]]) - rows.uv
            chi2 = wp.dot(e, e) * weight
            cost = wp.float64(0.5) * chi2
            if chi2 > GATE:
                cost = wp.sqrt(GATE * chi2) - wp.float64(0.5) * GATE
                weight = weight * wp.sqrt(GATE / chi2)
            out.information = out.information + information_of(rows, weight)
            out.gradient = out.gradient + (rows.u * e[0] + rows.v * e[1]) * weight
            out.cost = out.cost + cost
    return out


@wp.func
def assigned(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, b: int, i: int, j: int,
    rotation: wp.mat33d, position: wp.vec3d,
) -> Pose:  # fmt: skip
    """The pose with each LED given the nearest of its candidates inside the gate, each blob to one LED."""
    out = Pose()
    out.rotation = rotation
    out.position = position
    blob = vec8i(-1, -1, -1, -1, -1, -1, -1, -1)
    for k in range(hats.leds[j]):
        arm = rotation * wp.vec3d(hats.position[j, k])
        if arm[2] + position[2] < NEAREST_M:
            out.score = wp.float64(-1.0)
            return out
        if work.candidates[b, i, k] > 0:
            rows = led_rows(camera, arm, position)
            nearest = GATE
            for c in range(work.candidates[b, i, k]):
                which = work.candidate[b, i, k, c]
                e = wp.vec2d(features.pixel[b, i, which]) - rows.uv
                sigma = work.sigma[b, i, which]
                chi2 = wp.dot(e, e) / (sigma * sigma)
                if chi2 < nearest:
                    taken = bool(False)
                    for other in range(k):
                        taken = taken or blob[other] == which
                    if not taken:
                        nearest = chi2
                        blob[k] = which
            if blob[k] >= 0:
                out.inliers = out.inliers + 1
                out.score = out.score + wp.float64(0.5) * (GATE - nearest)
    out.blob = blob
    return out


@wp.func
def leds_used(blob: vec8i, leds: int) -> int:
    """The LEDs that have a blob, bit k for LED k."""
    used = int(0)
    for k in range(leds):
        if blob[k] >= 0:
            used = used | (1 << k)
    return used


@wp.func
def same_blobs(a: vec8i, b: vec8i) -> bool:
    """Whether two assignments are the same."""
    same = bool(True)
    for k in range(8):
        same = same and a[k] == b[k]
    return same


@wp.func
def descended(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, b: int, i: int, j: int, start: Pose,
) -> Pose:  # fmt: skip
    """The minimum of the reprojection error near a pose, its blobs kept; score -1 where none is reached."""
    out = Pose()
    out.rotation = start.rotation
    out.position = start.position
    out.blob = start.blob
    out.score = wp.float64(-1.0)
    damping = wp.float64(1.0e-4)
    now = linearised(camera, features, hats, work, b, i, j, out.rotation, out.position, start.blob)
    if now.cost < wp.float64(0.0):
        return out
    for _step in range(STEPS):
        damped = now.information
        for k in range(6):
            damped[k, k] = damped[k, k] * (wp.float64(1.0) + damping)
        low = cholesky6(damped)
        if not low[0, 0] > wp.float64(0.0):
            return out
        d = solve_cholesky6(low, now.gradient)
        rotation = orthonormal(exp_so3(wp.vec3d(d[0], d[1], d[2])) * out.rotation)
        position = out.position + wp.vec3d(d[3], d[4], d[5])
        then = linearised(camera, features, hats, work, b, i, j, rotation, position, start.blob)
        if then.cost >= wp.float64(0.0) and then.cost <= now.cost + wp.float64(1.0e-12):
            out.rotation = rotation
            out.position = position
            now = then
            damping = damping * wp.float64(0.1)
            if wp.dot(d, now.gradient) + wp.abs(wp.dot(d, now.information * d)) < SETTLED:
                out.score = wp.float64(0.0)
                return out
        else:
            damping = damping * wp.float64(30.0)
    if wp.dot(now.gradient, now.gradient) >= wp.float64(0.0):
        out.score = wp.float64(0.0)
    return out


@wp.func
def refined(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, b: int, i: int, j: int, start: Pose,
) -> Pose:  # fmt: skip
    """The best pose near a first guess; score -1 where it diverges."""
    out = start
    for _round in range(ROUNDS):
        low = descended(camera, features, hats, work, b, i, j, out)
        if low.score < wp.float64(0.0):
            return low
        before = out.blob
        out = assigned(camera, features, hats, work, b, i, j, low.rotation, low.position)
        if out.score < wp.float64(0.0) or out.inliers < 3 or same_blobs(before, out.blob):
            return out
    return out

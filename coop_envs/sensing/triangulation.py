"""Where a spot lies that two cameras see: the midpoint method and an optimal one, each with a covariance.

Both know that poses, pixels and calibrations are uncertain; ``joint`` is the covariance of (theta_a, delta_a, theta_b,
delta_b), the errors of the two believed poses as `bearings` defines them. Two bearings are four numbers for three
unknowns; the one left over is the gap between the rays.

Source: thesis section 6.2.1 (midpoint, least-squares form); Hartley, Sturm, "Triangulation", 1997. `optimal` is
maximum likelihood to first order for errors that the two cameras share, which Hartley and Sturm do not treat.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

from coop_envs.sensing.bearings import (
    APART,
    BEHIND,
    NO_BEARING,
    OK,
    UNCERTAIN,
    Fix,
    Limits,
    Ray,
    SpotView,
    across,
    bearing_change,
    crossing_point,
    has_bearing,
    image_covariances,
    judged,
    no_answer,
    ray_of,
)  # fmt: skip

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

MAX_STEPS = wp.constant(8)
SMALL_STEP = wp.constant(wp.float64(1.0e-6))  # squared length of a step in standard deviations that ends the iteration


class vec12d(wp.types.vector(length=12, dtype=wp.float64)):  # noqa: N801 - a Warp type, named as Warp names its own
    """Twelve numbers in double precision."""


class mat412d(wp.types.matrix(shape=(4, 12), dtype=wp.float64)):  # noqa: N801
    """Four by twelve numbers in double precision."""


class mat1212d(wp.types.matrix(shape=(12, 12), dtype=wp.float64)):  # noqa: N801
    """Twelve by twelve numbers in double precision."""


@wp.func
def through(G: mat412d, joint: mat1212d) -> wp.mat44d:
    """G joint G^T."""
    out = wp.mat44d()
    for i in range(4):
        row = vec12d()
        for k in range(12):
            g = G[i, k]
            if g != wp.float64(0.0):
                for c in range(12):
                    row[c] = row[c] + g * joint[k, c]
        for j in range(i + 1):
            s = wp.float64(0.0)
            for c in range(12):
                s = s + row[c] * G[j, c]
            out[i, j] = s
            out[j, i] = s
    return out


@wp.func
def with_row(G: mat412d, i: int, first: int, by_theta: wp.vec3d, by_position: wp.vec3d) -> mat412d:
    """G with row i's derivatives by the pose whose columns start at ``first``."""
    out = G
    for k in range(3):
        out[i, first + k] = by_theta[k]
        out[i, first + 3 + k] = by_position[k]
    return out


@wp.func
def by_along(ray: Ray, inverse: wp.mat33d, point: wp.vec3d) -> wp.mat33d:
    """Derivative of the midpoint by the direction of one ray, by implicit differentiation of its normal equations."""
    back = ray.centre - point
    ahead = -wp.dot(ray.along, back)
    return inverse * (wp.identity(n=3, dtype=wp.float64) * ahead - wp.outer(ray.along, back))


@wp.func
def with_midpoint_rows(
    G: mat412d, first: int, ray: Ray, inverse: wp.mat33d, point: wp.vec3d, normal: wp.vec3d
) -> mat412d:
    """G with the derivatives of (midpoint, gap along ``normal``) by the pose of one ray's body."""
    by_centre = inverse * across(ray.along)
    turned = by_along(ray, inverse, point)
    out = G
    for k in range(3):
        by_theta = wp.cross(ray.lever, by_centre[k]) + wp.cross(ray.along, turned[k])
        out = with_row(out, k, first, by_theta, by_centre[k])
    arm = ray.lever + ray.along * wp.dot(ray.along, point - ray.centre)
    return with_row(out, 3, first, wp.cross(arm, normal), normal)


@wp.func
def with_image_columns(
    N: wp.mat44d, first: int, view: SpotView, ray: Ray, inverse: wp.mat33d, point: wp.vec3d, normal: wp.vec3d
) -> wp.mat44d:
    """N with the derivatives of (midpoint, gap) by one camera's normalised image coordinates."""
    turned = by_along(ray, inverse, point)
    ahead = wp.dot(ray.along, point - ray.centre)
    out = N
    for axis in range(2):
        change = bearing_change(view, ray, axis)
        moved = turned * change
        for k in range(3):
            out[k, first + axis] = moved[k]
        out[3, first + axis] = ahead * wp.dot(normal, change)
    return out


@wp.func
def midpoint_covariance(
    a: SpotView, b: SpotView, ray_a: Ray, ray_b: Ray, point: wp.vec3d, joint: mat1212d
) -> wp.mat44d:
    """Covariance of (midpoint, gap) to first order."""
    normal = wp.normalize(wp.cross(ray_a.along, ray_b.along))
    inverse = wp.inverse(across(ray_a.along) + across(ray_b.along))
    by_poses = with_midpoint_rows(mat412d(), 0, ray_a, inverse, point, -normal)
    by_poses = with_midpoint_rows(by_poses, 6, ray_b, inverse, point, normal)
    by_images = with_image_columns(wp.mat44d(), 0, a, ray_a, inverse, point, -normal)
    by_images = with_image_columns(by_images, 2, b, ray_b, inverse, point, normal)
    return through(by_poses, joint) + by_images * image_covariances(a, b) * wp.transpose(by_images)


@wp.func
def midpoint(a: SpotView, b: SpotView, joint: mat1212d, limits: Limits) -> Fix:
    """The spot at the midpoint of the rays' common perpendicular."""
    if not has_bearing(a) or not has_bearing(b):
        return no_answer(NO_BEARING)
    ray_a = ray_of(a)
    ray_b = ray_of(b)
    fix = crossing_point(ray_a, ray_b)
    if fix.answer != OK:
        return fix
    P = midpoint_covariance(a, b, ray_a, ray_b, fix.point, joint)
    gap = wp.dot(wp.normalize(wp.cross(ray_a.along, ray_b.along)), ray_b.centre - ray_a.centre)
    if P[3, 3] <= wp.float64(0.0):
        return no_answer(UNCERTAIN)
    if gap * gap > limits.gap_gate * P[3, 3]:
        return no_answer(APART)
    covariance = wp.mat33d(P[0, 0], P[0, 1], P[0, 2], P[1, 0], P[1, 1], P[1, 2], P[2, 0], P[2, 1], P[2, 2])
    return judged(fix.point, covariance, ray_a, ray_b, limits)


@wp.func
def cholesky4(S: wp.mat44d) -> wp.mat44d:
    """Lower Cholesky factor; its [0, 0] is 0 where the matrix is not positive definite."""
    low = wp.mat44d()
    for i in range(4):
        for j in range(i + 1):
            s = S[i, j]
            for k in range(j):
                s = s - low[i, k] * low[j, k]
            if i == j:
                if not s > wp.float64(0.0):
                    low[0, 0] = wp.float64(0.0)
                    return low
                low[i, i] = wp.sqrt(s)
            else:
                low[i, j] = s / low[j, j]
    return low


@wp.func
def with_sight(M: wp.mat44d, i: int, view: SpotView, ray: Ray, point: wp.vec3d) -> wp.mat44d:
    """M with rows i, i + 1: derivatives of the image of ``point`` by the point, and what was seen less what should be.

    The depth must be positive.
    """
    seen = wp.transpose(ray.R_team_camera) * (point - ray.centre)
    out = M
    for axis in range(2):
        ratio = seen[axis] / seen[2]
        row = wp.vec3d(wp.float64(0.0), wp.float64(0.0), -ratio / seen[2])
        row[axis] = wp.float64(1.0) / seen[2]
        row = ray.R_team_camera * row
        for k in range(3):
            out[i + axis, k] = row[k]
        out[i + axis, 3] = view.direction[axis] / view.direction[2] - ratio
    return out


@wp.func
def pose_rows(M: wp.mat44d, from_a: wp.vec3d, from_b: wp.vec3d) -> mat412d:
    """Derivatives of the image points by the poses, from M and the point seen from the two bodies, in team axes."""
    out = mat412d()
    for i in range(4):
        row = wp.vec3d(M[i, 0], M[i, 1], M[i, 2])
        if i < 2:
            out = with_row(out, i, 0, wp.cross(row, from_a), -row)
        else:
            out = with_row(out, i, 6, wp.cross(row, from_b), -row)
    return out


@wp.func
def weighted_squares(L: wp.mat44d, M: wp.mat44d) -> wp.mat44d:
    """M^T (L L^T)^-1 M."""
    W = M
    for c in range(4):
        for i in range(4):
            s = M[i, c]
            for k in range(i):
                s = s - L[i, k] * W[k, c]
            W[i, c] = s / L[i, i]
    return wp.transpose(W) * W


@wp.func
def before(ray: Ray, point: wp.vec3d) -> bool:
    """Whether the point lies before the camera."""
    axis = wp.vec3d(ray.R_team_camera[0, 2], ray.R_team_camera[1, 2], ray.R_team_camera[2, 2])
    return wp.dot(axis, point - ray.centre) > wp.float64(0.0)


@wp.func
def optimal(a: SpotView, b: SpotView, joint: mat1212d, limits: Limits) -> Fix:
    """The most likely spot: Gauss-Newton on the four normalised image coordinates, from the midpoint.

    Weights are the inverse of their whole covariance, poses and calibrations included, at the current point.
    """
    if not has_bearing(a) or not has_bearing(b):
        return no_answer(NO_BEARING)
    ray_a = ray_of(a)
    ray_b = ray_of(b)
    start = crossing_point(ray_a, ray_b)
    if start.answer != OK:
        return start
    point = start.point
    image = image_covariances(a, b)
    covariance = wp.mat33d()
    gap = wp.float64(0.0)
    for _step in range(MAX_STEPS):
        if not before(ray_a, point) or not before(ray_b, point):
            return no_answer(BEHIND)
        sight = with_sight(wp.mat44d(), 0, a, ray_a, point)
        sight = with_sight(sight, 2, b, ray_b, point)
        by_poses = pose_rows(sight, point - a.p_team_body, point - b.p_team_body)
        L = cholesky4(through(by_poses, joint) + image)
        if L[0, 0] <= wp.float64(0.0):
            return no_answer(UNCERTAIN)
        Q = weighted_squares(L, sight)
        H = wp.mat33d(Q[0, 0], Q[0, 1], Q[0, 2], Q[1, 0], Q[1, 1], Q[1, 2], Q[2, 0], Q[2, 1], Q[2, 2])
        slope = wp.vec3d(Q[0, 3], Q[1, 3], Q[2, 3])
        covariance = wp.inverse(H)
        move = covariance * slope
        point = point + move
        gain = wp.dot(slope, move)
        gap = Q[3, 3] - gain
        if gain < SMALL_STEP:
            break
    if gap > limits.gap_gate:
        return no_answer(APART)
    return judged(point, covariance, ray_a, ray_b, limits)

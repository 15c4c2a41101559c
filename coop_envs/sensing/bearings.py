"""What cameras know of a spot that they see: bearings, how uncertain they are, and where two of them meet.

Believed poses err by (theta, delta) in team axes, the truth being R = Exp(theta) R_team_body and
p = p_team_body + delta.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

from enum import IntEnum

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

MIN_PARALLAX2 = wp.constant(wp.float64(1.0e-6))  # squared sine of the rays' angle: below 1 mrad they are parallel


class Answer(IntEnum):
    """Whether two bearings gave a point, or why not."""

    OK = 0
    PARALLEL = 1
    BEHIND = 2
    APART = 3
    TOO_FAR = 4
    NO_BEARING = 5
    UNCERTAIN = 6


OK = wp.constant(int(Answer.OK))
PARALLEL = wp.constant(int(Answer.PARALLEL))
BEHIND = wp.constant(int(Answer.BEHIND))
APART = wp.constant(int(Answer.APART))
TOO_FAR = wp.constant(int(Answer.TOO_FAR))
NO_BEARING = wp.constant(int(Answer.NO_BEARING))
UNCERTAIN = wp.constant(int(Answer.UNCERTAIN))


@wp.struct
class SpotView:
    """What one camera knows of a spot.

    ``R_team_body``, ``p_team_body`` (m): believed pose; ``R_body_camera``, ``p_body_camera``: mounting; ``direction``:
    unit vector in camera axes, zero where the pixel has no bearing; ``focal`` (px). Standard deviations: ``noise_px``
    of a pixel coordinate; systematic, ``focal_sigma`` of both focal lengths (relative, one error for both) and
    ``centre_sigma_px`` of each coordinate of the principal point.
    """

    R_team_body: wp.mat33d
    p_team_body: wp.vec3d
    R_body_camera: wp.mat33d
    p_body_camera: wp.vec3d
    direction: wp.vec3d
    focal: wp.vec2d
    noise_px: wp.float64
    focal_sigma: wp.float64
    centre_sigma_px: wp.float64


@wp.struct
class Limits:
    """What is still an answer.

    ``max_range`` (m) from either camera, ``gap_gate`` (squared gap over its variance, chi-square with one degree of
    freedom), ``max_sigma`` (m, square root of the covariance's trace).
    """

    max_range: wp.float64
    gap_gate: wp.float64
    max_sigma: wp.float64


@wp.struct
class Fix:
    """A point in the team frame (m) and its covariance (m^2), both meaningful only where ``answer`` is OK."""

    point: wp.vec3d
    covariance: wp.mat33d
    answer: int


@wp.struct
class Ray:
    """A bearing in team axes: from ``centre`` along the unit vector ``along``; ``lever`` is the centre in the body."""

    R_team_camera: wp.mat33d
    centre: wp.vec3d
    lever: wp.vec3d
    along: wp.vec3d


@wp.func
def ray_of(view: SpotView) -> Ray:
    """The ray on which the camera believes the spot to lie."""
    ray = Ray()
    ray.R_team_camera = view.R_team_body * view.R_body_camera
    ray.lever = view.R_team_body * view.p_body_camera
    ray.centre = view.p_team_body + ray.lever
    ray.along = ray.R_team_camera * view.direction
    return ray


@wp.func
def image_covariance(view: SpotView) -> wp.mat22d:
    """Covariance of the normalised image point (x, y) from pixel noise and calibration."""
    x = wp.vec2d(view.direction[0] / view.direction[2], view.direction[1] / view.direction[2])
    pixel = view.noise_px * view.noise_px + view.centre_sigma_px * view.centre_sigma_px
    out = wp.outer(x, x) * (view.focal_sigma * view.focal_sigma)
    out[0, 0] = out[0, 0] + pixel / (view.focal[0] * view.focal[0])
    out[1, 1] = out[1, 1] + pixel / (view.focal[1] * view.focal[1])
    return out


@wp.func
def image_covariances(a: SpotView, b: SpotView) -> wp.mat44d:
    """Covariance of both cameras' normalised image points; calibrations are independent."""
    first = image_covariance(a)
    second = image_covariance(b)
    out = wp.mat44d()
    for i in range(2):
        for j in range(2):
            out[i, j] = first[i, j]
            out[2 + i, 2 + j] = second[i, j]
    return out


@wp.func
def has_bearing(view: SpotView) -> bool:
    """Whether the direction is one: before the camera, not zero, not NaN."""
    return view.direction[2] > wp.float64(0.0)


@wp.func
def bearing_change(view: SpotView, ray: Ray, axis: int) -> wp.vec3d:
    """Derivative of ``along`` by the normalised image coordinate x (0) or y (1)."""
    d = view.direction
    e = wp.vec3d()
    e[axis] = wp.float64(1.0)
    return ray.R_team_camera * ((e - d * d[axis]) * d[2])


@wp.func
def across(along: wp.vec3d) -> wp.mat33d:
    """Projector onto the plane normal to a unit vector."""
    return wp.identity(n=3, dtype=wp.float64) - wp.outer(along, along)


@wp.func
def crossing_point(a: Ray, b: Ray) -> Fix:
    """The midpoint of the two rays' common perpendicular, without covariance; PARALLEL or BEHIND where there is none.

    It minimises the sum of the squared distances to the two lines.
    """
    fix = Fix()
    if wp.length_sq(wp.cross(a.along, b.along)) < MIN_PARALLAX2:
        fix.answer = PARALLEL
        return fix
    A = across(a.along)
    B = across(b.along)
    fix.point = wp.inverse(A + B) * (A * a.centre + B * b.centre)
    ahead_a = wp.dot(fix.point - a.centre, a.along)
    ahead_b = wp.dot(fix.point - b.centre, b.along)
    if ahead_a <= wp.float64(0.0) or ahead_b <= wp.float64(0.0):
        fix.answer = BEHIND
    return fix


@wp.func
def positive(P: wp.mat33d) -> bool:
    """Whether a symmetric matrix is positive definite (Sylvester)."""
    minor = P[0, 0] * P[1, 1] - P[0, 1] * P[1, 0]
    return P[0, 0] > wp.float64(0.0) and minor > wp.float64(0.0) and wp.determinant(P) > wp.float64(0.0)


@wp.func
def judged(point: wp.vec3d, covariance: wp.mat33d, a: Ray, b: Ray, limits: Limits) -> Fix:
    """The point as a fix, unless it is too far off or too uncertain."""
    fix = Fix()
    fix.point = point
    fix.covariance = covariance
    reach = wp.max(wp.length(point - a.centre), wp.length(point - b.centre))
    if not positive(covariance) or wp.trace(covariance) > limits.max_sigma * limits.max_sigma:
        fix.answer = UNCERTAIN
    elif reach > limits.max_range:
        fix.answer = TOO_FAR
    return fix


@wp.func
def no_answer(reason: int) -> Fix:
    """A fix that is none."""
    fix = Fix()
    fix.answer = reason
    return fix

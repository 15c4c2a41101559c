"""Rotations in three dimensions as Warp functions: exponential and logarithm, heading.

Source: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eqs (132)-(134).
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def exp_so3(w: wp.vec3d) -> wp.mat33d:
    """Rotation matrix of the rotation vector w (rad)."""
    t2 = wp.dot(w, w)
    s = wp.float64(1.0) - t2 / wp.float64(6.0)
    c = wp.float64(0.5) - t2 / wp.float64(24.0)
    if t2 > wp.float64(1.0e-8):
        t = wp.sqrt(t2)
        s = wp.sin(t) / t
        c = (wp.float64(1.0) - wp.cos(t)) / t2
    k = wp.skew(w)
    return wp.identity(n=3, dtype=wp.float64) + k * s + k * k * c


@wp.func
def log_so3(r: wp.mat33d) -> wp.vec3d:
    """Rotation vector (rad) of a rotation matrix, for angles below pi."""
    v = wp.vec3d(r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]) * wp.float64(0.5)
    s = wp.length(v)
    c = (r[0, 0] + r[1, 1] + r[2, 2] - wp.float64(1.0)) * wp.float64(0.5)
    angle = wp.atan2(s, c)
    scale = wp.float64(1.0)
    if s > wp.float64(1.0e-9):
        scale = angle / s
    return v * scale


@wp.func
def orthonormal(r: wp.mat33d) -> wp.mat33d:
    """The nearest rotation to a matrix that is almost one (one Newton step of the polar decomposition)."""
    return r * (wp.identity(n=3, dtype=wp.float64) * wp.float64(1.5) - wp.transpose(r) * r * wp.float64(0.5))


@wp.func
def heading(r: wp.mat33d) -> wp.float64:
    """Yaw of the body x axis in the ground plane (rad)."""
    return wp.atan2(r[1, 0], r[0, 0])


@wp.func
def wrap(angle: float) -> float:
    """The same angle within [-pi, pi)."""
    return angle - 6.283185307179586 * wp.floor((angle + 3.141592653589793) / 6.283185307179586)


@wp.func
def stand_on(normal: wp.vec3, yaw: float) -> wp.mat33:
    """R_world_body of a body standing on a plane with this normal, its x axis above heading yaw.

    The plane must not be vertical; a normal that points down lays the body on its back.
    """
    c = wp.cos(yaw)
    s = wp.sin(yaw)
    x = wp.normalize(wp.vec3(c, s, -(normal[0] * c + normal[1] * s) / normal[2]))
    return wp.matrix_from_cols(x, wp.cross(normal, x), normal)

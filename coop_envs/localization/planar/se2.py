"""Poses in the plane: (x, y, yaw) in m and rad along the last axis, any number at once.

Twists and errors are (yaw, x, y). An error moves a pose from the left, exp(error) * pose: a turn of the whole plane
about the frame's origin, then a shift along the frame's axes.

Source: Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018, eqs (152)-(163).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STRAIGHT_RAD = 1e-4


def wrapped(angle: Array) -> Array:
    """The same angles within [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def rotation(yaw: Array) -> Array:
    """Matrices (..., 2, 2) that turn by ``yaw`` (...)."""
    made = np.empty((*np.shape(yaw), 2, 2))
    made[..., 0, 0] = made[..., 1, 1] = np.cos(yaw)
    made[..., 1, 0] = np.sin(yaw)
    made[..., 0, 1] = -made[..., 1, 0]
    return made


def perpendicular(p: Array) -> Array:
    """Points (..., 2) turned a quarter to the left: how they move when the plane begins to turn."""
    made = np.empty_like(p)
    made[..., 0], made[..., 1] = -p[..., 1], p[..., 0]
    return made


def acted(pose: Array, p: Array) -> Array:
    """Points (..., 2) given in the frames of poses (..., 3), in the frame that the poses are given in."""
    return pose[..., :2] + (rotation(pose[..., 2]) @ p[..., None])[..., 0]


def seen_from(pose: Array, p: Array) -> Array:
    """The opposite of `acted`: points of the common frame in the frames of poses."""
    return (np.swapaxes(rotation(pose[..., 2]), -1, -2) @ (p - pose[..., :2])[..., None])[..., 0]


def composed(a: Array, b: Array) -> Array:
    """T_x_z of T_x_y and T_y_z."""
    made = np.empty(np.broadcast_shapes(a.shape, b.shape))
    made[..., :2] = acted(a, b[..., :2])
    made[..., 2] = wrapped(a[..., 2] + b[..., 2])
    return made


def inverse(pose: Array) -> Array:
    """T_y_x of T_x_y."""
    made = np.empty_like(pose)
    made[..., :2] = seen_from(pose, np.zeros_like(pose[..., :2]))
    made[..., 2] = -pose[..., 2]
    return made


def _arc(turn: Array) -> tuple[Array, Array]:
    """sin(turn) / turn and (1 - cos(turn)) / turn, by series near zero."""
    small = np.abs(turn) < STRAIGHT_RAD
    safe = np.where(small, 1.0, turn)
    along = np.where(small, 1.0 - turn**2 / 6.0, np.sin(safe) / safe)
    aside = np.where(small, turn / 2.0, 2.0 * np.sin(0.5 * safe) ** 2 / safe)
    return along, aside


def exp(twist: Array) -> Array:
    """The pose reached along an arc: turned by twist's yaw while going x ahead and y to the left, in its own axes."""
    along, aside = _arc(twist[..., 0])
    x, y = twist[..., 1], twist[..., 2]
    made = np.empty_like(twist)
    made[..., 0], made[..., 1] = along * x - aside * y, aside * x + along * y
    made[..., 2] = twist[..., 0]
    return made


def log(pose: Array) -> Array:
    """The twist (yaw, x, y) of a pose, for turns below pi."""
    turn = wrapped(pose[..., 2])
    along, aside = _arc(turn)
    x, y = pose[..., 0], pose[..., 1]
    scale = 1.0 / (along**2 + aside**2)
    return np.stack([turn, scale * (along * x + aside * y), scale * (along * y - aside * x)], -1)


def adjoint(pose: Array) -> Array:
    """Matrices (..., 3, 3) with pose * exp(w) = exp(adjoint @ w) * pose."""
    made = np.zeros((*pose.shape[:-1], 3, 3))
    made[..., 0, 0] = 1.0
    made[..., 1:, 0] = -perpendicular(pose[..., :2])
    made[..., 1:, 1:] = rotation(pose[..., 2])
    return made


def right_jacobian(twist: Array) -> Array:
    """Matrices (..., 3, 3) with exp(twist + w) = exp(twist) * exp(right_jacobian @ w) for small w."""
    turn, x, y = twist[..., 0], twist[..., 1], twist[..., 2]
    along, aside = _arc(turn)
    small = np.abs(turn) < STRAIGHT_RAD
    safe = np.where(small, 1.0, turn)
    bent = np.where(small, turn / 6.0, (1.0 - along) / safe)
    half = np.where(small, 0.5, aside / safe)
    made = np.zeros((*turn.shape, 3, 3))
    made[..., 0, 0] = 1.0
    made[..., 1, 1] = made[..., 2, 2] = along
    made[..., 1, 2], made[..., 2, 1] = aside, -aside
    made[..., 1, 0] = bent * x - half * y
    made[..., 2, 0] = half * x + bent * y
    return made

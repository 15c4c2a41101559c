"""The quadratic power model, p = x^T M x.

Source: thesis eqs (6.1)-(6.18). `segment_energy_j` is eq (6.5): the exact energy over a segment on which the power
state moves linearly.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

wp.set_module_options({"enable_backward": False})


@wp.struct
class PowerMatrices:
    """The three matrices of a robot's power model; see `specification.PowerModel`."""

    robot: wp.mat44
    marker: wp.mat22
    scanner: wp.mat33


@wp.func
def motion_power_w(power: PowerMatrices, speed: float, yaw_rate: float, climb: float) -> float:
    """Robot power above its idle draw, in watts; ``climb`` is the world-z component of the body's x axis."""
    x = wp.vec4(speed, yaw_rate, climb, 1.0)
    return wp.dot(x, power.robot * x) - power.robot[3, 3]


@wp.func
def marker_power_w(power: PowerMatrices, marker_sum: float) -> float:
    """Power of the LEDs whose channels (0..255 each) add up to ``marker_sum``, in watts."""
    x = wp.vec2(marker_sum, 1.0)
    return wp.dot(x, power.marker * x)


@wp.func
def scanner_power_w(power: PowerMatrices, galvo: float, laser: float) -> float:
    """Power of mirror motors and laser for commands in 0..1, in watts."""
    x = wp.vec3(galvo, laser, 1.0)
    return wp.dot(x, power.scanner * x)


def segment_energy_j(matrix: ArrayLike, start: ArrayLike, end: ArrayLike, duration_s: float) -> float:
    """Energy of a segment from power state ``start`` to ``end`` (both (k,)), eq (6.5). The matrix must be symmetric."""
    m, a, b = (np.asarray(value, dtype=float) for value in (matrix, start, end))
    return float(duration_s / 3.0 * (a @ m @ a + a @ m @ b + b @ m @ b))


def sampled_energy_j(matrix: ArrayLike, states: ArrayLike, period_s: float) -> float:
    """Energy of power states (n, k) that were sampled every ``period_s``, each held for one period: eq (6.16)."""
    m, x = np.asarray(matrix, dtype=float), np.asarray(states, dtype=float)
    return float(period_s * np.einsum("ni,ij,nj->", x, m, x))

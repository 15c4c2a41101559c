"""Range and bearing in the plane: what is expected, and how errors of the poses move it.

Errors move poses from the left, so that a sighting feels only the difference between the subject's and the seer's:

    q = R^T (s - p)        dq = R^T (shift + turn [s]^)        (turn, shift) = error of the subject - error of the seer

with [s]^ the perpendicular of the subject's place. A common error of all, which no sighting can show, thus never
appears in the Jacobian, wherever it is linearised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.se2 import Array

Indices = NDArray[np.intp]
KNOWN = -1


@dataclass(frozen=True, eq=False)
class Sightings:
    """M sightings: who saw whom (indices in the filter, `KNOWN` for a known place), what, and how exactly.

    place
        (M, 2) of known subjects, else unused.
    measured, sigma
        (M, 2) range (m) and bearing (rad, left positive), their standard deviations.
    seer_then
        (M, 3) the seer's pose at the time of the sighting from its present one, where that differs.
    subject_then
        (M, 2) the subject's place at that time in its present axes.
    extra
        (M, 2, 2) covariance that is added to that of ``sigma``.
    """

    seer: Indices
    subject: Indices
    place: Array
    measured: Array
    sigma: Array
    seer_then: Array
    subject_then: Array
    extra: Array

    def __len__(self) -> int:
        return len(self.seer)

    def noise(self) -> Array:
        """Covariance (M, 2, 2) of what was measured."""
        return self.extra + self.sigma[:, :, None] ** 2 * np.eye(2)

    def part(self, chosen: NDArray[np.bool_] | Indices) -> Sightings:
        """Those of a mask (M,), or by number."""
        return Sightings(**{name: value[chosen] for name, value in vars(self).items()})


def sightings_now(seer: Indices, subject: Indices, place: Array, measured: Array, sigma: Array) -> Sightings:
    """Sightings of the present instant."""
    m = len(seer)
    return Sightings(seer, subject, place, measured, sigma, np.zeros((m, 3)), np.zeros((m, 2)), np.zeros((m, 2, 2)))


@dataclass(frozen=True, eq=False)
class Linearised:
    """Residuals (M, 2) of range and bearing, and their Jacobians (M, 2, 3) by subject error minus seer error."""

    residual: Array
    jacobian: Array


def linearised(pose: Array, sightings: Sightings) -> Linearised:
    """What sightings tell against the poses (K, 3) of a filter."""
    seer = se2.composed(pose[sightings.seer], sightings.seer_then)
    known = (sightings.subject == KNOWN)[:, None]
    s = np.where(known, sightings.place, se2.acted(pose[sightings.subject], sightings.subject_then))
    q = se2.seen_from(seer, s)
    away = np.maximum(np.linalg.norm(q, axis=1), 1e-6)
    bearing = np.arctan2(q[:, 1], q[:, 0])
    residual = sightings.measured - np.stack([away, bearing], 1)
    residual[:, 1] = se2.wrapped(residual[:, 1])
    ahead = q / away[:, None]
    polar = np.stack([ahead, se2.perpendicular(ahead) / away[:, None]], 1)
    by_shift = polar @ np.swapaxes(se2.rotation(seer[:, 2]), -1, -2)
    by_turn = by_shift @ se2.perpendicular(s)[:, :, None]
    return Linearised(residual, np.concatenate([by_turn, by_shift], 2))


def point_of(measured: Array, sigma: Array) -> tuple[Array, Array]:
    """Places (M, 2) in the seer's axes of what was seen at range and bearing (M, 2), their covariance (M, 2, 2)."""
    away, bearing = measured[:, 0], measured[:, 1]
    ahead = np.stack([np.cos(bearing), np.sin(bearing)], 1)
    spread = np.stack([ahead * sigma[:, :1], se2.perpendicular(ahead) * (away * sigma[:, 1])[:, None]], 2)
    return ahead * away[:, None], spread @ np.swapaxes(spread, -1, -2)

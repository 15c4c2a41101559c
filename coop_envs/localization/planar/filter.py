"""One Kalman filter for a whole team in the plane: robots and landmarks of unknown place, all correlated.

The error of a pose moves it from the left, exp(error) * pose. Then the common turn and shift of the whole team, which
relative measurements cannot show, is the same error (1, 1, ... 1) wherever the team is believed to be: no update can
gain anything about it, as one that linearises in plain coordinates does with every change of mind. Odometry leaves
such errors as they are, so it adds noise to one robot's block and touches nothing else.

A landmark of unknown place is kept as a pose with the heading that its discoverer had, which gives its error the same
common part. Sources: Barrau and Bonnabel, "An EKF-SLAM algorithm with consistency properties", 2015; Huang, Trawny,
Mourikis, Roumeliotis, "Observability-based consistent EKF estimators for multi-robot cooperative localization", 2011.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi2

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.se2 import Array
from coop_envs.localization.planar.settings import PlanarSettings
from coop_envs.localization.planar.sightings import KNOWN, Indices, Linearised, Sightings, linearised, point_of

AT_ONCE = 32
"""So many sightings are fused at a time."""
FORGIVEN = 0.25
"""So much of a refused sighting one that passes makes up for."""


@dataclass(frozen=True, eq=False)
class PlanarSnapshot:
    """Everything that a `PlanarFilter` holds."""

    names: tuple[str, ...]
    pose: Array
    covariance: Array
    refused: Array


@dataclass(frozen=True, eq=False)
class PlanarFix:
    """An absolute position (2,) or, with ``yaw_rad``, pose; ``covariance`` (2, 2) of x, y or (3, 3) of yaw, x, y.

    ``then`` (3,) is the robot's pose at the time of the fix from its present one, ``extra`` (3, 3) the covariance of
    what it did since, as an error from the left.
    """

    position: Array
    yaw_rad: float | None
    covariance: Array
    then: Array = field(default_factory=lambda: np.zeros(3))
    extra: Array = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True, eq=False)
class Updated:
    """Which of M sightings passed the gate, and the names of those whose pose is doubted from now on."""

    accepted: NDArray[np.bool_]
    doubted: tuple[str, ...]


class PlanarFilter:
    """Poses of K robots and landmarks in one frame.

    ``pose`` (K, 3) x, y, yaw; ``covariance`` (3 K, 3 K) of their errors (yaw, x, y), applied from the left.
    """

    def __init__(self, settings: PlanarSettings) -> None:
        self.settings = settings
        self.gates = {rows: float(chi2.ppf(settings.gate_share, rows)) for rows in (2, 3)}
        self.restore(PlanarSnapshot((), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(0)))

    def snapshot(self) -> PlanarSnapshot:
        return PlanarSnapshot(tuple(self.names), self.pose.copy(), self.covariance.copy(), self.refused.copy())

    def restore(self, state: PlanarSnapshot) -> None:
        self.names = list(state.names)
        self.index = {name: k for k, name in enumerate(self.names)}
        self.pose, self.covariance, self.refused = state.pose.copy(), state.covariance.copy(), state.refused.copy()

    def add(self, name: str, pose: Array, covariance: Array) -> None:
        """A newcomer at a pose (3,) with the covariance (3, 3) of its yaw, x and y, independent of all others."""
        back = np.linalg.inv(plain_jacobian(pose))
        self._append(name, pose, np.zeros((3, 3 * len(self.names))), back @ covariance @ back.T)

    def add_landmark(self, name: str, seer: str, measured: Array, sigma: Array) -> None:
        """A landmark of unknown place, where ``seer`` sees it first, at range and bearing (2,)."""
        k = self.index[seer]
        points, spread = point_of(measured[None], sigma[None])
        p = se2.acted(self.pose[k], points[0])
        pose = np.array([*p, self.pose[k, 2]])
        rows = self.covariance[3 * k : 3 * k + 3]
        own = rows[:, 3 * k : 3 * k + 3].copy()
        R = se2.rotation(pose[2])
        own[1:, 1:] += R @ spread[0] @ R.T
        self._append(name, pose, rows, own)

    def _append(self, name: str, pose: Array, across: Array, own: Array) -> None:
        self.covariance = np.block([[self.covariance, across.T], [across, own]])
        self.pose = np.concatenate([self.pose, np.asarray(pose, dtype=float)[None]])
        self.refused = np.append(self.refused, 0.0)
        self.index[name] = len(self.names)
        self.names.append(name)

    def remove(self, name: str) -> None:
        """Forget a robot or landmark; what it told of the others stays."""
        k = self.index[name]
        kept = np.delete(np.arange(3 * len(self.names)), np.s_[3 * k : 3 * k + 3])
        state = self.snapshot()
        names = state.names[:k] + state.names[k + 1 :]
        covariance = state.covariance[np.ix_(kept, kept)]
        self.restore(PlanarSnapshot(names, np.delete(state.pose, k, 0), covariance, np.delete(state.refused, k)))

    def absorb(self, other: PlanarFilter, pose: Array, covariance: Array) -> None:
        """Take in another team whose frame lies at ``pose`` (3,) here, ``covariance`` (3, 3) of its error (from the
        left).
        """
        moved = carried(other.snapshot(), pose, covariance)
        own = self.snapshot()
        across = np.zeros((len(own.covariance), len(moved.covariance)))
        joint = np.block([[own.covariance, across], [across.T, moved.covariance]])
        poses, refused = np.concatenate([own.pose, moved.pose]), np.concatenate([own.refused, moved.refused])
        self.restore(PlanarSnapshot(own.names + moved.names, poses, joint, refused))

    def move(self, robots: Indices, step: Array, noise: Array) -> None:
        """Carry robots (M,), each named once, by steps (M, 3) in their own axes; ``noise`` (M, 3, 3) as of
        `driving.driven`.
        """
        self.pose[robots] = se2.composed(self.pose[robots], step)
        axes = se2.adjoint(self.pose[robots])
        K = len(self.names)
        blocks = self.covariance.reshape(K, 3, K, 3)
        blocks[robots, :, robots, :] += axes @ noise @ np.swapaxes(axes, -1, -2)

    def update(self, sightings: Sightings) -> Updated:
        """Take in sightings of one instant, linearised at its beginning; those beyond the gate are left out.

        Few at a time, which is the same as all at once but cheaper: each part is told what those before it changed.
        """
        if len(sightings) == 0:
            return Updated(np.zeros(0, dtype=bool), ())
        told = linearised(self.pose, sightings)
        accepted = self._within_gate(sightings, told)
        shift = np.zeros((len(self.names), 3))
        chosen = np.flatnonzero(accepted)
        for first in range(0, len(chosen), AT_ONCE):
            part = chosen[first : first + AT_ONCE]
            seen, jacobian = sightings.part(part), told.jacobian[part]
            projected = self._project(seen, jacobian)
            S = self._innovation(projected, seen, jacobian)
            left = told.residual[part] - (jacobian @ _apart(seen, shift)[:, :, None])[:, :, 0]
            shift += self._absorb_rows(projected, S, left.ravel())
        self.pose = se2.composed(se2.exp(shift), self.pose)
        return Updated(accepted, self._doubt(sightings, accepted))

    def _within_gate(self, sightings: Sightings, told: Linearised) -> NDArray[np.bool_]:
        """Which sightings the present belief finds likely, each on its own."""
        blocks = self.covariance.reshape(len(self.names), 3, len(self.names), 3)
        seer, subject = sightings.seer, sightings.subject
        known = (subject == KNOWN)[:, None, None]
        across = np.where(known, 0.0, blocks[subject, :, seer, :])
        P = blocks[seer, :, seer, :] + np.where(known, 0.0, blocks[subject, :, subject, :])
        P = P - across - np.swapaxes(across, 1, 2)
        S = told.jacobian @ P @ np.swapaxes(told.jacobian, 1, 2) + sightings.noise()
        whitened = np.linalg.solve(S, told.residual[:, :, None])[:, :, 0]
        return np.sum(told.residual * whitened, axis=1) <= self.gates[2]

    def _project(self, sightings: Sightings, jacobian: Array) -> Array:
        """H P (2 M, 3 K)."""
        rows = self.covariance.reshape(len(self.names), 3, -1)
        return (jacobian @ _apart(sightings, rows)).reshape(2 * len(sightings), -1)

    def _innovation(self, projected: Array, sightings: Sightings, jacobian: Array) -> Array:
        """H P H^T and the noise, (2 M, 2 M)."""
        columns = projected.reshape(len(projected), -1, 3).transpose(1, 2, 0)
        S = jacobian @ _apart(sightings, columns)
        m = np.arange(len(sightings))
        S.reshape(len(m), 2, len(m), 2)[m, :, m, :] += sightings.noise()
        return S.reshape(2 * len(m), 2 * len(m))

    def _absorb_rows(self, projected: Array, S: Array, residual: Array) -> Array:
        """Let the covariance fall by rows (R, 3 K) with innovation covariance S; the shift (K, 3) that they ask for."""
        factor = cholesky(0.5 * (S + S.T), lower=True, check_finite=False)
        N = solve_triangular(factor, projected, lower=True, check_finite=False)
        y = solve_triangular(factor, residual, lower=True, check_finite=False)
        self.covariance -= N.T @ N
        return (N.T @ y).reshape(-1, 3)

    def _doubt(self, sightings: Sightings, accepted: NDArray[np.bool_]) -> tuple[str, ...]:
        """Count refusals against what passed, and widen the poses of those that had too many."""
        for who in (sightings.seer, sightings.subject):
            counts = who != KNOWN
            np.add.at(self.refused, who[counts], np.where(accepted[counts], -FORGIVEN, 1.0))
        self.refused = np.maximum(self.refused, 0.0)
        doubted = np.flatnonzero(self.refused >= self.settings.refusals)
        self.refused[doubted] = 0.0
        for k in doubted:
            axes = se2.adjoint(self.pose[k])
            extra = np.diag([self.settings.doubt_rad, self.settings.doubt_m, self.settings.doubt_m]) ** 2
            self.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += axes @ extra @ axes.T
        return tuple(self.names[k] for k in doubted)

    def fix(self, name: str, fix: PlanarFix) -> bool:
        """Take in a robot's absolute position or pose, unless beyond the gate."""
        k = self.index[name]
        pose = se2.composed(self.pose[k], fix.then)
        H = plain_jacobian(pose)
        residual = np.array([0.0, *(fix.position - pose[:2])])
        if fix.yaw_rad is None:
            H, residual = H[1:], residual[1:]
        else:
            residual[0] = se2.wrapped(np.array(fix.yaw_rad - pose[2]))
        noise = fix.covariance + H @ fix.extra @ H.T
        projected = H @ self.covariance[3 * k : 3 * k + 3]
        S = projected[:, 3 * k : 3 * k + 3] @ H.T + noise
        if residual @ np.linalg.solve(S, residual) > self.gates[len(residual)]:
            return False
        self.pose = se2.composed(se2.exp(self._absorb_rows(projected, S, residual)), self.pose)
        return True

    def covariance_of(self, name: str) -> Array:
        """Covariance (3, 3) of a pose's yaw, x and y, each error added."""
        k = self.index[name]
        A = plain_jacobian(self.pose[k])
        return A @ self.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] @ A.T


def _apart(sightings: Sightings, of_each: Array) -> Array:
    """What (K, ...) holds of subjects less what it holds of seers (M, ...); known places have none."""
    known = (sightings.subject == KNOWN).reshape(-1, *(1,) * (of_each.ndim - 1))
    return np.where(known, 0.0, of_each[sightings.subject]) - of_each[sightings.seer]


def plain_jacobian(pose: Array) -> Array:
    """How errors from the left (3,) add to yaw, x and y of a pose."""
    A = np.eye(3)
    A[1:, 0] = se2.perpendicular(pose[:2])
    return A


def carried(state: PlanarSnapshot, pose: Array, covariance: Array) -> PlanarSnapshot:
    """A team in another frame, in which its own lies at ``pose`` (3,): that frame's error is added to everybody's."""
    A = np.kron(np.eye(len(state.names)), se2.adjoint(pose))
    common = np.kron(np.ones((len(state.names),) * 2), covariance)
    return PlanarSnapshot(
        state.names, se2.composed(pose, state.pose), A @ state.covariance @ A.T + common, state.refused
    )

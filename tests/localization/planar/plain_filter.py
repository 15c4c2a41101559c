"""The planar team filter as it is mostly written, to compare with: errors added to x, y and yaw, Jacobians anew at
every estimate."""

from __future__ import annotations

import numpy as np

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.driving import driven


class PlainFilter:
    """Poses (K, 3) and their covariance (3 K, 3 K), both in the order x, y, yaw."""

    def __init__(self, settings, pose, covariance):
        self.settings, self.pose, self.P = settings, pose.copy(), covariance.copy()

    def drive(self, forward, turn, time_s):
        step, noise = driven(self.settings, forward, turn, time_s)
        F, Q = np.eye(len(self.P)), np.zeros_like(self.P)
        before, self.pose = self.pose, se2.composed(self.pose, step)
        order = [1, 2, 0]
        for k in range(len(self.pose)):
            at = np.s_[3 * k : 3 * k + 3]
            F[at, 3 * k + 2][:2] += se2.perpendicular(self.pose[k, :2] - before[k, :2])
            axes = np.eye(3)
            axes[:2, :2] = se2.rotation(self.pose[k, 2])
            Q[at, at] = axes @ noise[k][np.ix_(order, order)] @ axes.T
        self.P = F @ self.P @ F.T + Q

    def see(self, seer, subject, measured, sigma):
        """Sightings (M,) of one instant, stacked."""
        m = np.arange(len(seer))
        d = self.pose[subject, :2] - self.pose[seer, :2]
        r2 = np.sum(d**2, axis=1)
        r = np.sqrt(r2)
        by_place = np.stack([d / r[:, None], np.stack([-d[:, 1], d[:, 0]], 1) / r2[:, None]], 1)
        H = np.zeros((len(m), 2, len(self.pose), 3))
        H[m, :, subject, :2] = by_place
        H[m, :, seer, :2] = -by_place
        H[m, 1, seer, 2] = -1.0
        H = H.reshape(2 * len(m), len(self.P))
        residual = measured - np.stack([r, np.arctan2(d[:, 1], d[:, 0]) - self.pose[seer, 2]], 1)
        residual[:, 1] = se2.wrapped(residual[:, 1])
        S = H @ self.P @ H.T + np.diag(sigma.ravel() ** 2)
        K = np.linalg.solve(S, H @ self.P).T
        self.pose = self.pose + (K @ residual.ravel()).reshape(-1, 3)
        self.P = self.P - K @ S @ K.T
        self.P = 0.5 * (self.P + self.P.T)

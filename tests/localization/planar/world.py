"""Generated truth in the plane: robots that drive on circles and see each other, with errors as their settings say."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.driving import driven
from coop_envs.localization.planar.filter import PlanarFilter
from coop_envs.localization.planar.settings import PlanarSettings
from coop_envs.localization.planar.sightings import Sightings, sightings_now

STEP_S = 0.2


@dataclass
class World:
    """K robots and known or unknown landmarks (M, 2); ``pose`` (K, 3) is the truth."""

    settings: PlanarSettings
    pose: np.ndarray
    landmarks: np.ndarray
    rng: np.random.Generator
    range_sigma_m: float = 0.03
    bearing_sigma_rad: float = 0.02
    sight_m: float = 4.0
    too_near_m: float = 0.5
    forward: np.ndarray = field(init=False)
    turn: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.forward, self.turn = np.zeros((2, len(self.pose)))

    def drive(self, forward: np.ndarray, turn: np.ndarray, time_s: float = STEP_S) -> None:
        """Drive at these speeds by odometry; truth departs from it at random."""
        step, noise = driven(self.settings, forward, turn, time_s)
        factor = np.linalg.cholesky(noise + 1e-18 * np.eye(3))
        wander = (factor @ self.rng.normal(size=(len(noise), 3, 1)))[:, :, 0]
        self.pose = se2.composed(se2.composed(self.pose, step), se2.exp(wander))
        self.forward, self.turn = forward, turn

    def measure(self, seer: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Range and bearing (M, 2) of places (M, 2), with noise."""
        q = se2.seen_from(self.pose[seer], places)
        exact = np.stack([np.hypot(*q.T), np.arctan2(q[:, 1], q[:, 0])], 1)
        return exact + self.rng.normal(size=exact.shape) * [self.range_sigma_m, self.bearing_sigma_rad]

    def sigma(self, m: int) -> np.ndarray:
        return np.tile([self.range_sigma_m, self.bearing_sigma_rad], (m, 1))

    def robots_seen(self) -> tuple[np.ndarray, np.ndarray]:
        """Seer and subject of every pair of robots within sight."""
        apart = np.linalg.norm(self.pose[:, None, :2] - self.pose[None, :, :2], axis=2)
        seer, subject = np.nonzero((apart < self.sight_m) & (apart > self.too_near_m))
        return seer, subject

    def look(self) -> Sightings:
        """What robots see of each other."""
        seer, subject = self.robots_seen()
        measured = self.measure(seer, self.pose[subject, :2])
        return sightings_now(seer, subject, np.zeros((len(seer), 2)), measured, self.sigma(len(seer)))

    def look_at_landmarks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Seer, landmark and measurement of every landmark within sight."""
        apart = np.linalg.norm(self.pose[:, None, :2] - self.landmarks[None], axis=2)
        seer, landmark = np.nonzero((apart < self.sight_m) & (apart > self.too_near_m))
        return seer, landmark, self.measure(seer, self.landmarks[landmark])


def started(world: World) -> PlanarFilter:
    """A filter that believes the robots about where they are: the first exactly, the others as set down by people."""
    team = PlanarFilter(world.settings)
    s = world.settings
    sigma = np.array([s.start_yaw_rad, s.start_position_m, s.start_position_m])
    for k, pose in enumerate(world.pose):
        spread = sigma if k else np.full(3, 1e-4)
        error = world.rng.normal(size=3) * spread
        team.add(f"robot_{k}", pose + [error[1], error[2], error[0]], np.diag(spread**2))
    return team


def error(believed: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Errors (K, 3) of poses from the left (yaw, x, y), as the filter's covariance tells them."""
    return se2.log(se2.composed(truth, se2.inverse(believed)))


def nees(team: PlanarFilter, truth: np.ndarray) -> np.ndarray:
    """Squared errors (K,) of each robot's pose over its covariance, divided by 3."""
    e = error(team.pose[: len(truth)], truth)
    blocks = [team.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(truth))]
    return np.array([d @ np.linalg.solve(P, d) / 3.0 for d, P in zip(e, blocks, strict=True)])

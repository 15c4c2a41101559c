"""Estimated trajectories against true ones: interpolation, one frame for both, drift, NEES. Nothing is fitted.

The error of a pose is (theta, p): R_true = Exp(theta) R_estimate, p_true = p_estimate + p, in the axes of the frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_envs.errors import require
from coop_envs.localization.logs.events import Trajectory

Array = NDArray[np.float64]

LONGEST_GAP_S = 0.5
"""Between two poses of the truth that are farther apart nobody knows where a robot was."""


class Poses(Protocol):
    """Poses over time: (T,) increasing, (T, 3), (T, 3, 3)."""

    @property
    def time_s(self) -> Array: ...
    @property
    def position(self) -> Array: ...
    @property
    def rotation(self) -> Array: ...


@dataclass(frozen=True)
class Drift:
    """How far off a trajectory ends.

    position_m
        distance of the last pose's position from the truth.
    planar_m
        the same in x and y alone.
    heading_rad
        how far the last pose's heading is off, up to pi.
    tilt_rad
        angle between the last pose's up and the true one.
    path_m
        length of the true path.
    """

    position_m: float
    planar_m: float
    heading_rad: float
    tilt_rad: float
    path_m: float

    @property
    def percent_of_path(self) -> float:
        """``position_m`` as a share of the path, NaN for a robot that never moved."""
        return 100.0 * self.position_m / self.path_m if self.path_m > 0.0 else float("nan")


def covered(truth: Poses, time_s: Array, longest_gap_s: float = LONGEST_GAP_S) -> NDArray[np.bool_]:
    """(T,) at which of these times the truth is known: between two of its poses that are not too far apart."""
    after = np.searchsorted(truth.time_s, time_s, side="left")
    inside = (time_s >= truth.time_s[0]) & (time_s <= truth.time_s[-1])
    after = np.clip(after, 1, max(len(truth.time_s) - 1, 1))
    if len(truth.time_s) == 1:
        return inside
    exact = np.isin(time_s, truth.time_s)
    return inside & (exact | (truth.time_s[after] - truth.time_s[after - 1] <= longest_gap_s))


def interpolated(trajectory: Poses, time_s: Array) -> Trajectory:
    """Its poses at these times: positions on straight lines, rotations on the shortest turn between two poses.

    Raises:
        ConfigError: a time before its first or after its last pose.
    """
    times = trajectory.time_s
    outside = (time_s < times[0]) | (time_s > times[-1])
    require(not outside.any(), "time_s", time_s[outside][:1].tolist(), f"within {times[0]} to {times[-1]} s")
    if len(times) == 1:
        return Trajectory(
            time_s, *(np.repeat(part, len(time_s), axis=0) for part in (trajectory.position, trajectory.rotation))
        )
    after = np.clip(np.searchsorted(times, time_s, side="left"), 1, len(times) - 1)
    before = after - 1
    share = ((time_s - times[before]) / (times[after] - times[before]))[:, None]
    position = (1.0 - share) * trajectory.position[before] + share * trajectory.position[after]
    start, end = (Rotation.from_matrix(trajectory.rotation[k]) for k in (before, after))
    turn = (start.inv() * end).as_rotvec()
    return Trajectory(time_s, position, (start * Rotation.from_rotvec(share * turn)).as_matrix())


def in_team_frame(truth: Mapping[str, Trajectory], first: str, time_s: float) -> dict[str, Trajectory]:
    """True trajectories as the team sees them: from where its first observer stood at this time, z along gravity.

    Raises:
        ConfigError: the truth does not know where ``first`` stood then.
    """
    require(first in truth, "truth", sorted(truth), f"a trajectory of {first}, whose start is the team's frame")
    own = truth[first]
    require(bool(covered(own, np.array([time_s]))[0]), "truth", time_s, f"to say where {first} was at this time")
    origin = interpolated(own, np.array([time_s]))
    R = Rotation.from_euler("z", -yaw_of(origin.rotation)[0]).as_matrix()
    return {name: _moved(trajectory, R, -R @ origin.position[0]) for name, trajectory in truth.items()}


def _moved(trajectory: Trajectory, R: Array, p: Array) -> Trajectory:
    return Trajectory(trajectory.time_s, trajectory.position @ R.T + p, R @ trajectory.rotation)


def yaw_of(rotation: Array) -> Array:
    """Heading (T,) of rotations (T, 3, 3): of the body's x axis about z."""
    return np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])


def path_length_m(points: Array, least_step_m: float = 0.0) -> float:
    """Length of a path through points (T, 3).

    With ``least_step_m``, from each point to the next that is so far away, so that noise at rest adds nothing.
    """
    if least_step_m <= 0.0:
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    last, length = points[0], 0.0
    for point in points:
        step = float(np.linalg.norm(point - last))
        if step >= least_step_m:
            last, length = point, length + step
    return length + float(np.linalg.norm(points[-1] - last))


def drift(estimate: Poses, truth: Poses, least_step_m: float = 0.0) -> Drift:
    """How far off an estimate is at the last of its times that the truth knows; both in one frame.

    Raises:
        ConfigError: the truth knows none of the estimate's times.
    """
    known = np.flatnonzero(covered(truth, estimate.time_s))
    require(len(known) > 0, "truth", truth.time_s[[0, -1]].tolist(), "times that overlap with the estimate's")
    k = known[-1]
    end = interpolated(truth, estimate.time_s[k : k + 1])
    span = (truth.time_s >= estimate.time_s[known[0]]) & (truth.time_s <= estimate.time_s[k])
    ends = interpolated(truth, estimate.time_s[known[[0, -1]]]).position
    path = np.concatenate([ends[:1], truth.position[span], ends[1:]])
    p = end.position[0] - estimate.position[k]
    turn = end.rotation[0] @ estimate.rotation[k].T
    heading = (yaw_of(end.rotation) - yaw_of(estimate.rotation[k : k + 1]))[0]
    return Drift(
        position_m=float(np.linalg.norm(p)),
        planar_m=float(np.linalg.norm(p[:2])),
        heading_rad=float(abs(np.arctan2(np.sin(heading), np.cos(heading)))),
        tilt_rad=float(np.arctan2(np.hypot(turn[0, 2], turn[1, 2]), turn[2, 2])),
        path_m=path_length_m(path, least_step_m),
    )


def pose_errors(estimate: Poses, truth: Poses) -> tuple[Array, Array]:
    """theta and p, (T, 3) each, of poses at the same times."""
    turn = truth.rotation @ np.swapaxes(estimate.rotation, 1, 2)
    return Rotation.from_matrix(turn).as_rotvec(), truth.position - estimate.position


def nees(estimate: Poses, covariance: Array, truth: Poses, planar: bool = False) -> Array:
    """Squared Mahalanobis distance (T,) of poses from the truth, by their covariances (T, 6, 6).

    If these are right it is 6 on average, or 3 for ``planar`` robots, of which heading, x and y count. NaN where the
    truth does not know the time.
    """
    out = np.full(len(estimate.time_s), np.nan)
    known = covered(truth, estimate.time_s)
    if known.any():
        rows = slice(2, 5) if planar else slice(0, 6)
        own = Trajectory(estimate.time_s[known], estimate.position[known], estimate.rotation[known])
        e = np.concatenate(pose_errors(own, interpolated(truth, own.time_s)), axis=1)[:, rows]
        out[known] = np.einsum("ti,ti->t", e, np.linalg.solve(covariance[known, rows, rows], e[..., None])[..., 0])
    return out

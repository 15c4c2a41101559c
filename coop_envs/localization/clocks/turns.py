"""Clock offsets without times of arrival: a turn that a gyro felt and a camera saw is one turn.

For camera c and robot j with attitudes Q by their gyros, each on its own clock, and sightings R of j by c at the
camera's times t,

    Q_c(t + tau_c) R_body_camera R(t) Q_j(t + tau_j)^T

is constant, but for noise and the slow drift of the gyros, if the lags tau are right. So an observer's gyro is compared
with pickets, a picket's with the camera, whoever of them rests. Only changes of the turn rate tell: over stretches of a
few seconds a constant and a drift are taken out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_envs.localization.logs.events import Event, ImuSample, Log, PoseSighting
from coop_envs.localization.rest_detector import median_turn, specified_noise, window_length
from coop_envs.sensing.camera import body_from_camera

Array = NDArray[np.float64]

STRETCH_S, BREAK_S, GAP_S, FEWEST = 8.0, 1.0, 0.15, 12
RANGE_S, COARSE_S, STEP_S = 1.0, 0.02, 0.002
MOST_SIGHTINGS, COARSE_SIGHTINGS = 3000, 400
OUTLIER = 4.0
ROUNDS = 8
UNSEEN_S = 0.02
"""A lag that is less certain than this was not seen."""
SIGNIFICANT_S, SIGNIFICANT_SIGMAS = 0.003, 4.0


@dataclass(frozen=True, eq=False)
class Turning:
    """A robot's attitude by its gyro: rotations (T, 3, 3) at times (T,), and the turn rate (T, 3) up to each."""

    time_s: Array
    rotation: Array
    rate: Array

    @property
    def gaps_s(self) -> Array:
        """(G, 2) from when until when samples are missing: nothing is known of the turn then."""
        long = np.flatnonzero(np.diff(self.time_s) > GAP_S)
        return np.stack([self.time_s[long], self.time_s[long + 1]], axis=1)

    @classmethod
    def of(cls, time_s: Array, gyro: Array, bias: Array) -> Turning:
        """From samples in order of time, each the mean since the one before."""
        rate = gyro - bias
        steps = Rotation.from_rotvec(rate[1:] * np.diff(time_s)[:, None]).as_matrix()
        rotation = np.empty((len(time_s), 3, 3))
        rotation[0] = np.eye(3)
        for k, step in enumerate(steps):
            rotation[k + 1] = rotation[k] @ step
        return cls(time_s, rotation, rate)

    def at(self, time_s: Array) -> Array:
        """Rotations (K, 3, 3) at times (K,); beyond the ends the turn goes on."""
        k = np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1)
        rest = self.rate[k] * (time_s - self.time_s[k - 1])[:, None]
        return self.rotation[k - 1] @ Rotation.from_rotvec(rest).as_matrix()


@dataclass(frozen=True, eq=False)
class View:
    """What a camera saw of a robot: R_body_camera R (K, 3, 3) at times (K,), its sigma (K,) in rad, stretch (K,)."""

    time_s: Array
    rotation: Array
    sigma_rad: Array
    stretch: NDArray[np.int64]

    def thinned(self, most: int) -> View:
        """Every so many of them, about ``most`` in all."""
        step = max(1, len(self.time_s) // most)
        return View(self.time_s[::step], self.rotation[::step], self.sigma_rad[::step], self.stretch[::step])


@dataclass(frozen=True, slots=True)
class Lag:
    """By how much a robot's IMU stamps exceed a camera's for the same instant, and how certain that is."""

    camera: str
    robot: str
    lag_s: float
    sigma_s: float


def clock_offsets(events: Sequence[Event], log: Log, significant: bool) -> dict[str, float]:
    """What to add to each stream's stamps ("imu NAME", "camera NAME") to take them to the first camera's clock.

    Where ``significant``, only offsets of at least 3 ms and 4 standard deviations.
    """
    assert log.team is not None
    turnings = {name: turning for i, name in enumerate(log.robots) if (turning := _turning(events, log, i, name))}
    lags: list[Lag] = []
    for i, camera in enumerate(log.robots):
        mount = log.team.members[i].camera
        for robot in log.robots:
            if mount is None or robot == camera or not {robot, camera} <= turnings.keys():
                continue
            gaps_s = np.concatenate([turnings[name].gaps_s for name in (camera, robot)])
            view = _view(events, camera, robot, body_from_camera(mount.pitch_down_rad), gaps_s)
            if view is not None:
                lags += find_lags(view, turnings[camera], turnings[robot], camera, robot)
    return _solve(lags, significant)


def find_lags(view: View, own: Turning, other: Turning, camera: str, robot: str) -> list[Lag]:
    """The lags of the camera's robot and of the robot that it sees, as far as their turns tell."""
    lags, thin = np.zeros(2), view.thinned(COARSE_SIGHTINGS)
    grid = np.arange(-RANGE_S, RANGE_S + 1e-9, COARSE_S)
    for which in (1, 0, 1, 0):
        costs = [_cost(_residuals(thin, own, other, _with(lags, which, lag))) for lag in grid]
        spread = np.ptp(costs) > 0.02 * np.min(costs)
        lags = _with(lags, which, float(grid[int(np.argmin(costs))])) if spread else lags
    lags, sigma = _refine(view, own, other, lags)
    found = [Lag(camera, camera, lags[0], sigma[0]), Lag(camera, robot, lags[1], sigma[1])]
    return [lag for lag in found if lag.sigma_s < UNSEEN_S]


def _refine(view: View, own: Turning, other: Turning, lags: Array) -> tuple[Array, Array]:
    """Gauss-Newton from a coarse guess, outliers left out: lags and their standard deviations (2,)."""
    sigma = np.full(2, np.inf)
    for _ in range(ROUNDS):
        r = _residuals(view, own, other, lags)
        length = np.linalg.norm(r, axis=1)
        inlier = length < OUTLIER * max(float(np.median(length)) / 1.54, 1e-9) * np.sqrt(3.0)
        steps = [_with(lags, which, lags[which] + STEP_S) for which in (0, 1)]
        back = [_with(lags, which, lags[which] - STEP_S) for which in (0, 1)]
        J = np.stack(
            [
                (_residuals(view, own, other, ahead) - _residuals(view, own, other, behind))[inlier].ravel()
                for ahead, behind in zip(steps, back, strict=True)
            ],
            axis=1,
        ) / (2.0 * STEP_S)
        information = J.T @ J + np.eye(2) * 1e-6
        scale = float(np.mean(r[inlier] ** 2))
        sigma = np.sqrt(np.diag(np.linalg.inv(information)) * scale)
        step = np.linalg.solve(information, J.T @ r[inlier].ravel())
        lags = lags - np.where(sigma < 2.0 * UNSEEN_S, np.clip(step, -COARSE_S, COARSE_S), 0.0)
    return lags, sigma


def _residuals(view: View, own: Turning, other: Turning, lags: Array) -> Array:
    """How far (K, 3), in standard deviations, what should be constant is from a constant with drift, by stretches."""
    seen = own.at(view.time_s + lags[0]) @ view.rotation @ np.swapaxes(other.at(view.time_s + lags[1]), 1, 2)
    out = np.empty((len(seen), 3))
    for stretch in np.unique(view.stretch):
        chosen = view.stretch == stretch
        out[chosen] = _detrended(seen[chosen], view.time_s[chosen]) / view.sigma_rad[chosen, None]
    return out


def _detrended(rotations: Array, time_s: Array) -> Array:
    """Rotation vectors (K, 3) from a robust mean rotation, less a line fitted twice, the second time to inliers."""
    u, _, vt = np.linalg.svd(rotations.sum(axis=0))
    mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    r = Rotation.from_matrix(rotations @ mean.T).as_rotvec()
    away = np.linalg.norm(r - np.median(r, axis=0), axis=1)
    inlier = away <= OUTLIER * np.median(away) + 1e-12
    basis = np.stack([np.ones_like(time_s), time_s - time_s.mean()], axis=1)
    fit = np.linalg.lstsq(basis[inlier], r[inlier], rcond=None)[0]
    return r - basis @ fit


def _cost(residuals: Array) -> float:
    return float(np.minimum(np.linalg.norm(residuals, axis=1), 2.0 * OUTLIER).mean())


def _with(lags: Array, which: int, value: float) -> Array:
    changed = lags.copy()
    changed[which] = value
    return changed


def _turning(events: Sequence[Event], log: Log, i: int, name: str) -> Turning | None:
    samples = {event.time_s: event for event in events if isinstance(event, ImuSample) and event.robot == name}
    if len(samples) < FEWEST or log.team is None:
        return None
    times = np.array(sorted(samples))
    gyro = np.array([samples[at].gyro for at in times])
    rate_hz = 1.0 / float(np.median(np.diff(times)))
    noise = specified_noise(log.team.members[i].robot.imu, rate_hz)
    count = window_length(rate_hz)
    bias = median_turn(gyro, noise, count) if len(gyro) > count else np.zeros(3)
    return Turning.of(times, gyro, bias)


def _view(events: Sequence[Event], camera: str, robot: str, R_body_camera: Array, gaps_s: Array) -> View | None:
    """The sightings of a robot by a camera, in stretches without gaps in what the two gyros say."""
    own = {
        event.time_s: event
        for event in events
        if isinstance(event, PoseSighting) and event.camera == camera and event.robot == robot
    }
    times = np.array(sorted(own))
    for start_s, end_s in gaps_s:
        times = times[(times < start_s - GAP_S) | (times > end_s + GAP_S)]
    if len(times) < FEWEST:
        return None
    passed = np.searchsorted(np.sort(gaps_s[:, 0]), times)
    breaks = np.cumsum(np.concatenate([[False], (np.diff(times) > BREAK_S) | (np.diff(passed) > 0)]))
    lasting = np.array([(at - times[breaks == part][0]) // STRETCH_S for at, part in zip(times, breaks, strict=True)])
    _, stretch, counts = np.unique(np.stack([breaks, lasting]), axis=1, return_inverse=True, return_counts=True)
    stretch = stretch.ravel()
    chosen = np.flatnonzero(counts[stretch] >= FEWEST)
    chosen = chosen[:: max(1, len(chosen) // MOST_SIGHTINGS)]
    if len(chosen) < FEWEST:
        return None
    sightings = [own[at] for at in times[chosen]]
    sigma = np.sqrt([np.trace(one.covariance[:3, :3]) / 3.0 for one in sightings])
    rotation = np.array([R_body_camera @ one.rotation for one in sightings])
    return View(times[chosen], rotation, sigma, stretch[chosen])


def _solve(lags: Sequence[Lag], significant: bool) -> dict[str, float]:
    """Offsets of streams that explain all lags best: lag = offset of the camera - offset of the IMU."""
    if not lags:
        return {}
    cameras = list(dict.fromkeys(lag.camera for lag in lags))
    streams = [f"camera {name}" for name in cameras[1:]] + list(dict.fromkeys(f"imu {lag.robot}" for lag in lags))
    A, y = np.zeros((len(lags), len(streams))), np.zeros(len(lags))
    for k, lag in enumerate(lags):
        weight = 1.0 / lag.sigma_s
        if lag.camera != cameras[0]:
            A[k, streams.index(f"camera {lag.camera}")] = weight
        A[k, streams.index(f"imu {lag.robot}")] = -weight
        y[k] = lag.lag_s * weight
    offset = np.linalg.lstsq(A, y, rcond=None)[0]
    sigma = np.sqrt(np.diag(np.linalg.pinv(A.T @ A)))
    least = np.maximum(SIGNIFICANT_S, SIGNIFICANT_SIGMAS * sigma) if significant else np.zeros(len(streams))
    return {name: float(o) for name, o, limit in zip(streams, offset, least, strict=True) if abs(o) >= limit and o}

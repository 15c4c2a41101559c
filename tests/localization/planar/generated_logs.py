"""Generated logs of planar teams, with their truth: robots wander near the origin and look ahead for each other."""

from __future__ import annotations

import dataclasses

import numpy as np

from coop_envs.localization.logs.events import Event, Log, Odometry, RangeBearing, Trajectory
from coop_envs.localization.planar import se2
from coop_envs.localization.planar.driving import driven
from coop_envs.localization.planar.settings import PlanarSettings

RANGE_SIGMA_M, BEARING_SIGMA_RAD, TICK_S = 0.03, 0.02, 0.05
LANDMARKS = {
    f"landmark_{k}": (float(x), float(y)) for k, (x, y) in enumerate([[0, 3], [3, 0], [-3, 1], [1, -3], [4, 4]])
}


def make_log(
    seed: int = 0,
    robots: int = 3,
    seconds: float = 20.0,
    landmarks: dict[str, tuple[float, float]] = LANDMARKS,
    settings: PlanarSettings | None = None,
    outliers: float = 0.0,
) -> Log:
    """A log of robots that start within 2 m of the origin; ``starts`` and ``landmarks`` are told exactly."""
    rng, settings = np.random.default_rng(seed), settings or PlanarSettings()
    names = tuple(f"robot_{k}" for k in range(robots))
    pose = np.column_stack([rng.uniform(-2, 2, (robots, 2)), rng.uniform(-3, 3, robots)])
    starts = {name: (float(x), float(y), float(yaw)) for name, (x, y, yaw) in zip(names, pose, strict=True)}
    events: list[Event] = []
    track = [pose.copy()]
    times = np.arange(0.0, seconds + 1e-9, TICK_S)
    speed, turn = np.full(robots, 0.3), np.zeros(robots)
    for k, time_s in enumerate(times):
        if k % 20 == 0:
            speed, turn = rng.uniform(0.1, 0.4, robots), homing(pose, rng)
        for i, name in enumerate(names):
            events.append(Odometry(float(time_s), name, float(speed[i]), float(turn[i])))
        if k % 4 == 0:
            events += sights(float(time_s), names, pose, landmarks, rng, outliers)
        step, noise = driven(settings, speed, turn, TICK_S)
        wander = (np.linalg.cholesky(noise + 1e-18 * np.eye(3)) @ rng.normal(size=(robots, 3, 1)))[:, :, 0]
        pose = se2.composed(se2.composed(pose, step), se2.exp(wander))
        track.append(pose.copy())
    poses = np.array(track[:-1])
    truth = {name: trajectory(times, poses[:, i]) for i, name in enumerate(names)}
    return Log(names, events, None, starts, landmarks, truth)


def homing(pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Yaw rates that lead robots back when they are far out."""
    home = np.arctan2(-pose[:, 1], -pose[:, 0])
    away = np.linalg.norm(pose[:, :2], axis=1) > 3.0
    return np.where(away, np.clip(se2.wrapped(home - pose[:, 2]), -0.8, 0.8), rng.normal(0.0, 0.4, len(pose)))


def sights(time_s, names, pose, landmarks, rng, outliers) -> list[Event]:
    """What each robot sees within 4 m in the half plane ahead."""
    found: list[Event] = []
    places = {**dict(zip(names, pose[:, :2], strict=True)), **{k: np.array(v) for k, v in landmarks.items()}}
    for i, name in enumerate(names):
        for subject, place in places.items():
            q = se2.seen_from(pose[i], np.asarray(place))
            away = np.hypot(*q)
            if subject == name or not 0.5 < away < 4.0 or q[0] < 0.0:
                continue
            measured = np.array([away, np.arctan2(q[1], q[0])]) + rng.normal(size=2) * [
                RANGE_SIGMA_M,
                BEARING_SIGMA_RAD,
            ]
            if rng.random() < outliers:
                measured += rng.choice([-1, 1], 2) * [0.8, 0.5]
            r, b = max(float(measured[0]), 0.1), float(measured[1])
            found.append(RangeBearing(time_s, name, subject, r, b, RANGE_SIGMA_M, BEARING_SIGMA_RAD))
    return found


def trajectory(times: np.ndarray, poses: np.ndarray) -> Trajectory:
    rotation = np.tile(np.eye(3), (len(poses), 1, 1))
    rotation[:, :2, :2] = se2.rotation(poses[:, 2])
    return Trajectory(times, np.column_stack([poses[:, :2], np.zeros(len(poses))]), rotation)


def without(log: Log, **changes) -> Log:
    return dataclasses.replace(log, **changes)


def path_errors(result, log: Log) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """By robot: times, place errors (T,), yaw errors (T,), NEES over 3 (T,)."""
    found = {}
    for name, path in result.paths.items():
        truth = log.truth[name]
        k = np.searchsorted(truth.time_s, path.time_s - 1e-9).clip(0, len(truth.time_s) - 1)
        exact = np.abs(truth.time_s[k] - path.time_s) < 1e-6
        d = (truth.position[k] - path.position)[exact, :2]
        yaw = [np.arctan2(R[..., 1, 0], R[..., 0, 0]) for R in (truth.rotation[k], path.rotation)]
        turn = se2.wrapped(yaw[0] - yaw[1])[exact]
        e = np.column_stack([turn, d])
        C = path.covariance[exact][:, 2:5, 2:5]
        nees = np.einsum("ti,ti->t", e, np.linalg.solve(C, e[:, :, None])[:, :, 0]) / 3
        found[name] = path.time_s[exact], np.linalg.norm(d, axis=1), np.abs(turn), nees
    return found

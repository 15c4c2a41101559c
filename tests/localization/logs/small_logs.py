"""Small logs, and how to compare two."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_team
from coop_envs.errors import ConfigError
from coop_envs.localization.logs.events import (
    Event,
    Fix,
    ImuSample,
    Log,
    Odometry,
    PoseSighting,
    RangeBearing,
    Trajectory,
)
from coop_envs.localization.logs.read_log import read_log

ROBOTS = ("observer_0", "picket_0", "picket_1")


def random_covariance(rng: np.random.Generator, size: int = 6) -> np.ndarray:
    A = rng.normal(size=(size, size)) * 0.01
    P = A @ A.T + 1e-6 * np.eye(size)
    return 0.5 * (P + P.T)


def small_log(seed: int = 0, names: tuple[str, ...] = ROBOTS, arrivals: bool = True) -> Log:
    """Some seconds of every kind of event of an inchworm team, in the order in which they arrive."""
    rng = np.random.default_rng(seed)
    events: list[Event] = []
    for k in range(40):
        at = 0.1 * k
        heard = {"arrival_s": at + 0.02} if arrivals else {}
        events += [ImuSample(at, name, rng.normal(size=3), rng.normal(size=3), **heard) for name in names]
        events += [Odometry(at, name, *rng.normal(size=2), **heard) for name in names]
        for name in names[1:]:
            R, p = Rotation.random(None, rng).as_matrix(), rng.normal(size=3)
            events.append(PoseSighting(at, names[0], name, R, p, random_covariance(rng), **heard))
        events.append(RangeBearing(at, names[0], "cone", 1.0 + 0.1 * k, 0.1, 0.02, 0.01, **heard))
        turn = Rotation.from_euler("z", 0.1).as_matrix()
        events.append(Fix(at, names[1], rng.normal(size=3), None, random_covariance(rng, 3), **heard))
        events.append(Fix(at, names[2], rng.normal(size=3), turn, random_covariance(rng), **heard))
    times = np.linspace(0.0, 4.0, 30)
    truth = {
        n: Trajectory(times, rng.normal(size=(30, 3)), Rotation.random(30, np.random.default_rng(3)).as_matrix())
        for n in names
    }
    starts = {names[0]: (0.0, 0.0, 0.0), names[1]: (0.5, 0.2, 0.1)}
    return Log(names, events, load_team("inchworm"), starts, {"cone": (2.0, 1.0)}, truth)


def same_event(a: Event, b: Event) -> bool:
    """Equal but for the rounding of rotations on their way through quaternions."""
    if type(a) is not type(b):
        return False
    for name in a.__slots__:
        left, right = getattr(a, name), getattr(b, name)
        if isinstance(left, np.ndarray):
            if left.shape != right.shape or not np.allclose(left, right, rtol=0.0, atol=1e-14):
                return False
        elif left != right:
            return False
    return True


def same_log(a: Log, b: Log) -> bool:
    events = len(a.events) == len(b.events) and all(map(same_event, a.events, b.events))
    told = (a.robots, a.team, dict(a.starts), dict(a.landmarks)) == (
        b.robots,
        b.team,
        dict(b.starts),
        dict(b.landmarks),
    )
    truth = a.truth.keys() == b.truth.keys() and all(
        np.array_equal(a.truth[name].time_s, b.truth[name].time_s)
        and np.array_equal(a.truth[name].position, b.truth[name].position)
        and np.allclose(a.truth[name].rotation, b.truth[name].rotation, rtol=0.0, atol=1e-14)
        for name in a.truth
    )
    return events and told and truth


IMU_HEADER = "time_s,robot,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
IMU_ROWS = ["0.0,a,0,0,0.1,0,0,9.81", "0.1,a,0,0,0.1,0,0,9.81", "0.2,a,0,0,0.1,0,0,9.81"]


def write_csv(folder: Path, **files: Any) -> Path:
    """Files of lines, besides an imu.csv of robot a, in a folder."""
    texts = {"imu": [IMU_HEADER, *IMU_ROWS], **files}
    for name, lines in texts.items():
        if lines is not None:
            (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    return folder


def log_or_refusal(path: Path, team: Any = None) -> Log | str:
    """What reading gives: a log, or the one line with which it was refused. Other exceptions pass."""
    try:
        return read_log(path, team)
    except ConfigError as error:
        told = str(error)
    assert "\n" not in told
    return told

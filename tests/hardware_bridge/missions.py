"""A made-up mission of three robots, and a process that writes one until somebody kills it."""

from __future__ import annotations

import itertools
import sys
import time

import numpy as np

from hardware_bridge.command import RobotCommand
from hardware_bridge.mission_log import MissionLog
from hardware_bridge.mission_log_format import BELIEF, MissionMetadata, TickTiming
from hardware_bridge.reading import CameraFrame, Sample
from hardware_bridge.safety.situation import Intervention
from hardware_bridge.tick_inputs import HumanInput, KeyEvent, TickInputs

NAMES = ("observer_0", "picket_0", "picket_1")
METADATA = MissionMetadata("team: [ä]\nseed: 'x'\n", "inchworm_scan", 7, "0.1.0", "2026-01-02T03:04:05+00:00")
TICK_S = 1 / 30


def sample(rng: np.random.Generator, host_s: float) -> Sample:
    angles, wheels, imu = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(2, 3))
    return Sample(host_s, host_s / 3, tuple(angles), tuple(wheels), tuple(imu[0]), tuple(imu[1]), rng.random())


def tick(k: int) -> TickInputs:
    """Three reports a robot, a camera frame of twelve blobs, a person driving the last robot."""
    rng, now_s = np.random.default_rng(k), k * TICK_S
    samples = {name: tuple(sample(rng, now_s - 0.01 * j) for j in (3, 2, 1)) for name in NAMES}
    blobs = tuple(tuple(row) for row in rng.normal(size=(12, 4)).tolist())
    frame = CameraFrame(now_s - 0.02, blobs, spot=(1.0 / 3.0, 2.0 / 3.0, 0.5))  # type: ignore[arg-type]
    human = HumanInput(now_s, (None, None, command(k)), age_s=0.1)
    return TickInputs(now_s, samples, {NAMES[0]: (frame,)}, (KeyEvent(now_s, "w"),), human)


def command(k: int) -> RobotCommand:
    left, right, brightness, laser = np.random.default_rng(k).random(4).tolist()
    return RobotCommand((left, -right), brightness, laser, (k, -k))


def commands(k: int) -> dict[str, RobotCommand]:
    return {name: command(k + i) for i, name in enumerate(NAMES)}


def belief(k: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(k)
    rotation = rng.normal(size=(1, 3, 3, 3)).astype(np.float32)
    return {"position": rng.normal(size=(1, 3, 3)), "rotation": rotation, "declared": np.full((1, 3), k % 3, np.int32)}


def intervention(k: int) -> Intervention:
    return Intervention(
        k * TICK_S, NAMES[1], "geofence", "0.12 m outside", command(k), RobotCommand(), again=k % 2 == 0
    )


def write_tick(log: MissionLog, k: int) -> None:
    """What a runner writes in a tick; every sixth ends a decision."""
    log.write_inputs(tick(k))
    log.write_commands(k * TICK_S, commands(k), commands(k + 1))
    log.write_interventions([intervention(k)])
    log.write_timing(TickTiming(k * TICK_S, 0.001, 0.004, 0.02 if k % 2 else None))
    if k % 6 == 0:
        log.write_arrays(BELIEF, k * TICK_S, belief(k))


def main(path: str) -> None:
    """Write at 30 Hz for ever, saying which tick was written last and when."""
    with MissionLog(path, METADATA) as log:
        for k in itertools.count():
            write_tick(log, k)
            print(k, time.monotonic(), flush=True)
            time.sleep(TICK_S)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Record a short inchworm mission of the simulator as a log that `coop localize` reads."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from coop_envs import exploration_v0
from coop_envs.actions import ACTION_NAMES, ACTION_SIZE
from coop_envs.localization.logs.events import Event, ImuSample, Log, Odometry, PoseSighting, Trajectory
from coop_envs.localization.logs.read_log import write_log
from coop_envs.parallel_env import ExplorationParallelEnv

HOLD, FORWARD, YAW_RATE, BRIGHTNESS = (
    ACTION_NAMES.index(name) for name in ("hold", "forward_speed", "yaw_rate", "marker_brightness")
)
REST_S, DRIVE_S = 1.0, 2.5


def mission(increments: int) -> Iterator[tuple[str | None, float]]:
    """Who drives and for how long: the pickets one by one, then the observer catches up; pauses in between."""
    yield None, 2.0
    for _ in range(increments):
        for robot in ("picket_0", "picket_1", "observer_0"):
            yield robot, DRIVE_S
            yield None, REST_S


class Recorder:
    """Steps the simulator tick by tick and keeps what the robots report, and the truth."""

    def __init__(self, env: ExplorationParallelEnv) -> None:
        self.env, self.tick_s = env, env.scenario.rates.tick_s
        self.names = tuple(env.possible_agents)
        self.events: list[Event] = []
        self.times: list[float] = []
        self.poses: list[tuple[np.ndarray, np.ndarray]] = []
        starts = env.batch.loop.plans.start.numpy()[0]
        self.starts = {
            name: (round(float(x), 6), round(float(y), 6), round(float(yaw), 6))
            for name, (x, y, yaw) in zip(self.names, starts, strict=True)
        }
        self.lanes_m = env.batch.state.position.numpy()[0, :, 1].copy()

    def drive(self, robot: str | None, seconds: float) -> None:
        """Let one robot drive along its lane, or nobody."""
        for _ in range(round(seconds / self.tick_s)):
            actions = {name: self.action(r, name == robot) for r, name in enumerate(self.names)}
            self.env.step({name: actions[name] for name in self.env.agents})
            self.record()

    def action(self, r: int, drives: bool) -> np.ndarray:
        """Stand, or drive ahead as people do who see the robot: back to its lane along world x."""
        action = np.zeros(ACTION_SIZE, dtype=np.float32)
        action[HOLD], action[BRIGHTNESS] = (0.0 if drives else 1.0), 1.0
        if drives:
            state = self.env.batch.state
            y, R = state.position.numpy()[0, r, 1], state.rotation.numpy()[0, r]
            aim = min(max(2.0 * (self.lanes_m[r] - y), -0.8), 0.8)
            turn = 2.0 * (aim - math.atan2(R[1, 0], R[0, 0]))
            action[FORWARD], action[YAW_RATE] = 0.95, min(max(turn, -1.0), 1.0)
        return action

    def record(self) -> None:
        """Keep the tick that has just ended."""
        end_s = (len(self.times) + 1) * self.tick_s
        told = self.env.batch.measurements
        gyro, accel, wheels = (np.array(part.numpy()[0], dtype=float) for part in (told.gyro, told.accel, told.wheels))
        for r, (name, member) in enumerate(zip(self.names, self.env.scenario.team.members, strict=True)):
            left_m_s, right_m_s = wheels[r] * member.robot.wheel_radius_m
            speeds = 0.5 * (left_m_s + right_m_s), (right_m_s - left_m_s) / member.robot.track_m
            self.events.append(Odometry(end_s - self.tick_s, name, *map(float, speeds)))
            self.events.append(ImuSample(end_s, name, gyro[r, 0], accel[r, 0]))
        seen, R, p, P = (
            part.numpy()[0] for part in (told.seen, told.R_camera_body, told.p_camera_body, told.covariance)
        )
        for i, j in np.argwhere(seen):
            rotation, position, covariance = (np.array(part[i, j], dtype=float) for part in (R, p, P))
            self.events.append(PoseSighting(end_s, self.names[i], self.names[j], rotation, position, covariance))
        state = self.env.batch.state
        self.times.append(end_s)
        self.poses.append((state.position.numpy()[0].astype(float), state.rotation.numpy()[0].astype(float)))

    def log(self) -> Log:
        """All of it; the truth is in the world."""
        position, rotation = (np.array(part) for part in zip(*self.poses, strict=True))
        truth = {
            name: Trajectory(np.array(self.times), position[:, r], rotation[:, r]) for r, name in enumerate(self.names)
        }
        return Log(self.names, self.events, self.env.scenario.team, self.starts, truth=truth)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/log"), help="the log: a folder, or one file (.mcap)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the mission")
    parser.add_argument("--increments", type=int, default=2, help="how often every robot moves once")
    parser.add_argument("--focal-share", type=float, default=0.0, help="standard deviation of focal lengths (share)")
    parser.add_argument("--hat-m", type=float, default=0.0, help="standard deviation of LEDs' places (m, each axis)")
    options = parser.parse_args()

    frame_by_frame: dict[str, Any] = {"rates.ticks_per_decision": 1}
    off = {"sensing.calibration.focal_share": options.focal_share, "sensing.calibration.hat_m": options.hat_m}
    env = exploration_v0.parallel_env(scenario="u_turn", **frame_by_frame, **off)
    env.reset(seed=options.seed)
    recorder = Recorder(env)
    for robot, seconds in mission(options.increments):
        recorder.drive(robot, seconds)
    write_log(options.out, recorder.log())
    print(f"{options.out}: {len(recorder.events)} events in {recorder.times[-1]:.1f} s")


if __name__ == "__main__":
    main()

"""Record a generated team in the plane as a log that `coop localize` reads.

Robots wander through a room; their wheels slip, their cameras look ahead and tell range and bearing of other robots and
of landmarks. Nobody is told where robots start: landmarks place them. With ``--fixes`` there are no landmarks, robots
are set down at known places in a frame of their own, and two of them get their position from outside halfway.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np

from coop_envs.localization.logs.events import Event, Fix, Log, Odometry, RangeBearing, Trajectory
from coop_envs.localization.logs.read_log import write_log

TICK_S, LOOKS_EVERY = 0.05, 4
ROOM_M, SIGHT_M, VIEW_RAD = 4.0, 4.0, math.radians(45.0)
RANGE_SIGMA_M, BEARING_SIGMA_RAD, FIX_SIGMA_M = 0.03, 0.02, 0.02
SLIP_RTM, SWERVE_RAD_RTM = 0.02, 0.04


class Room:
    """N robots at x, y, yaw (N, 3), and named landmarks; everything is recorded as it happens."""

    def __init__(self, robots: int, landmarks: int, rng: np.random.Generator) -> None:
        self.rng, self.names = rng, tuple(f"robot_{k}" for k in range(robots))
        self.pose = np.column_stack([rng.uniform(-2.0, 2.0, (robots, 2)), rng.uniform(-math.pi, math.pi, robots)])
        self.starts = {
            name: (float(x), float(y), float(yaw)) for name, (x, y, yaw) in zip(self.names, self.pose, strict=True)
        }
        places = rng.uniform(-ROOM_M, ROOM_M, (landmarks, 2)).round(3)
        self.landmarks = {f"landmark_{k}": (float(x), float(y)) for k, (x, y) in enumerate(places)}
        self.events: list[Event] = []
        self.path = [self.pose.copy()]

    @property
    def time_s(self) -> float:
        return round((len(self.path) - 1) * TICK_S, 6)

    def tick(self) -> None:
        """Tell odometry and look around, then drive on for a tick."""
        if (len(self.path) - 1) % LOOKS_EVERY == 0:
            self.look()
        forward, turn = np.full(len(self.names), 0.3), self.steering()
        for name, v, w in zip(self.names, forward, turn, strict=True):
            self.events.append(Odometry(self.time_s, name, float(v), float(w)))
        way = forward * TICK_S
        drawn = self.rng.normal(size=(2, len(way)))
        ahead = way + SLIP_RTM * np.sqrt(way) * drawn[0]
        turned = turn * TICK_S + SWERVE_RAD_RTM * np.sqrt(way) * drawn[1]
        middle = self.pose[:, 2] + 0.5 * turned
        self.pose = self.pose + np.column_stack([ahead * np.cos(middle), ahead * np.sin(middle), turned])
        self.path.append(self.pose.copy())

    def steering(self) -> np.ndarray:
        """Weave about, and turn back where the room ends."""
        x, y, yaw = self.pose.T
        homeward = (np.arctan2(-y, -x) - yaw + math.pi) % (2.0 * math.pi) - math.pi
        weave = 0.5 * np.sin(0.7 * self.time_s + 2.0 * np.arange(len(yaw)))
        return np.where(np.hypot(x, y) > 0.7 * ROOM_M, np.clip(homeward, -0.8, 0.8), weave)

    def look(self) -> None:
        """Range and bearing of what each robot has before it."""
        places = {**dict(zip(self.names, self.pose[:, :2].tolist(), strict=True)), **self.landmarks}
        for name, (x, y, yaw) in zip(self.names, self.pose, strict=True):
            for subject, (u, v) in places.items():
                away = math.hypot(u - x, v - y)
                bearing = (math.atan2(v - y, u - x) - yaw + math.pi) % (2.0 * math.pi) - math.pi
                if subject != name and 0.3 < away < SIGHT_M and abs(bearing) < VIEW_RAD:
                    away, bearing = self.rng.normal([away, bearing], [RANGE_SIGMA_M, BEARING_SIGMA_RAD])
                    told = float(away), float(bearing), RANGE_SIGMA_M, BEARING_SIGMA_RAD
                    self.events.append(RangeBearing(self.time_s, name, subject, *told))

    def fix(self, robot: int) -> None:
        """The position of a robot from outside."""
        place = self.pose[robot, :2] + self.rng.normal(size=2) * FIX_SIGMA_M
        self.events.append(
            Fix(self.time_s, self.names[robot], np.array([*place, 0.0]), None, FIX_SIGMA_M**2 * np.eye(3))
        )

    def truth(self) -> dict[str, Trajectory]:
        """Where everybody was at every tick."""
        path = np.array(self.path)
        times = np.arange(len(path)) * TICK_S
        return {name: spatial(times, path[:, k]) for k, name in enumerate(self.names)}


def spatial(times: np.ndarray, path: np.ndarray) -> Trajectory:
    """A path (T, 3) of x, y, yaw in space."""
    rotation = np.tile(np.eye(3), (len(path), 1, 1))
    c, s = np.cos(path[:, 2]), np.sin(path[:, 2])
    rotation[:, 0, 0], rotation[:, 0, 1], rotation[:, 1, 0], rotation[:, 1, 1] = c, -s, s, c
    return Trajectory(times, np.column_stack([path[:, :2], np.zeros(len(path))]), rotation)


def team_frame(starts: dict[str, tuple[float, float, float]]) -> dict[str, tuple[float, float, float]]:
    """The starts as people measure them from the first robot, who know nothing of the world."""
    x, y, yaw = starts["robot_0"]
    c, s = math.cos(yaw), math.sin(yaw)
    return {name: (c * (u - x) + s * (v - y), c * (v - y) - s * (u - x), w - yaw) for name, (u, v, w) in starts.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/planar_log"), help="the log: a folder, or a file (.mcap)")
    parser.add_argument("--robots", type=int, default=5, help="how many robots")
    parser.add_argument("--landmarks", type=int, default=8, help="how many landmarks at known places")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long (s)")
    parser.add_argument("--fixes", action="store_true", help="fixes of two robots halfway instead of landmarks")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random")
    options = parser.parse_args()

    room = Room(options.robots, 0 if options.fixes else options.landmarks, np.random.default_rng(options.seed))
    ticks = round(options.seconds / TICK_S)
    for k in range(ticks):
        room.tick()
        if options.fixes and k == ticks // 2:
            room.fix(0)
            room.fix(1)
    starts = team_frame(room.starts) if options.fixes else {}
    write_log(options.out, Log(room.names, room.events, None, starts, room.landmarks, room.truth()))
    print(f"{options.out}: {len(room.events)} events of {options.robots} robots in {options.seconds:.0f} s")


if __name__ == "__main__":
    main()

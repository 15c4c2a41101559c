"""One decision's raw inputs as `Measurements`: the last step before the belief, the same whatever the transport."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.team import Team
from coop_envs.sensing.measurements import Measurements
from hardware_bridge.battery import charge
from hardware_bridge.reading import CameraFrame
from hardware_bridge.seeing import PoseFinder, Seeing
from hardware_bridge.tick_inputs import TickInputs
from hardware_bridge.track import Track

LATE_SHARE = 0.1
"""A frame that is stamped later than its tick's end by less than this share of a tick still belongs to it."""


class SensingWindow:
    """Gathers the inputs of the ticks of a decision, then fills ``measurements`` (one team)."""

    def __init__(self, team: Team, seeing: Seeing, measurements: Measurements, device: str) -> None:
        self._team = team
        self._names = [member.name for member in team.members]
        self.tracks = [Track(member.robot) for member in team.members]
        self._frames: list[list[CameraFrame]] = [[] for _ in self._names]
        self._newest_frame_s = -math.inf
        self._finder = PoseFinder(team, seeing, measurements, device)
        self._out = {name: getattr(measurements, name).numpy()[0] for name in ("gyro", "accel", "wheels", "heard")}
        self._out |= {name: getattr(measurements, name).numpy()[0] for name in ("docked", "battery")}
        self._out |= {name: getattr(measurements, name).numpy()[0] for name in ("spot", "spot_sigma", "spot_stamp")}

    def take(self, inputs: TickInputs) -> None:
        """Take in what arrived in a tick."""
        for i, name in enumerate(self._names):
            for sample in inputs.samples.get(name, ()):
                self.tracks[i].add(sample)
            for frame in inputs.frames.get(name, ()):
                self._frames[i].append(frame)
                self._newest_frame_s = max(self._newest_frame_s, frame.host_s)

    def sample_age_s(self, robot: int, now_s: float) -> float:
        """Time since the robot's last report was taken; on a line that delays everything it stays long."""
        return max(now_s - self.tracks[robot].taken_s, 0.0)

    def frame_age_s(self, now_s: float) -> float:
        """Time since the last frame of any camera."""
        return max(now_s - self._newest_frame_s, 0.0)

    def battery(self, robot: int) -> float | None:
        """Charge left, None where the robot does not tell."""
        voltage_v = self.tracks[robot].voltage_v
        return None if voltage_v is None else charge(self._team.members[robot].robot.battery, voltage_v)

    def close(self, start_s: float, edges_s: NDArray[np.float64], lit: Sequence[float], docked: Sequence[bool]) -> None:
        """Fill the measurements of the ticks that end at ``edges_s`` (T,), the first of which began at ``start_s``.

        ``lit`` is each hat's brightness at the end.
        """
        out, end_s = self._out, float(edges_s[-1])
        for i, track in enumerate(self.tracks):
            out["gyro"][i], out["accel"][i], out["wheels"][i] = track.means(start_s, edges_s)
            out["heard"][i] = int(track.heard_s > start_s)
            out["docked"][i] = int(docked[i])
            battery = self.battery(i)
            out["battery"][i] = 1.0 if battery is None else battery
            self._pick_spots(i, start_s, edges_s)
        newest = [max(frames, key=lambda frame: frame.host_s) if frames else None for frames in self._frames]
        self._finder.find(newest, lit)
        for i, frames in enumerate(self._frames):
            late_s = end_s + LATE_SHARE * (end_s - start_s) / len(edges_s)
            self._frames[i] = [frame for frame in frames if frame.host_s > late_s]

    def _pick_spots(self, robot: int, start_s: float, edges_s: NDArray[np.float64]) -> None:
        out, late_s = self._out, LATE_SHARE * (edges_s[-1] - start_s) / len(edges_s)
        ends = np.array([start_s, *edges_s]) + late_s
        out["spot_sigma"][robot] = 0.0
        for frame in self._frames[robot]:
            t = int(np.searchsorted(ends, frame.host_s)) - 1
            if frame.spot is not None and 0 <= t < len(edges_s):
                u, v, sigma = frame.spot
                out["spot"][robot, t], out["spot_sigma"][robot, t] = (u, v), sigma
                out["spot_stamp"][robot, t] = frame.host_s - edges_s[t]

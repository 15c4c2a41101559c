"""Teams in the environment that flash, scan and drive as told, by their belief; and what came of every decision."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.inchworm_poses import ScanPose
from coop_envs.agents.control import ACTION_NAMES
from coop_envs.batch import TeamBatch
from coop_envs.device import prepare
from coop_envs.errors import CoopError
from coop_envs.geometry.keyed_random import team_key
from coop_envs.packed_pool import PackedPool
from coop_envs.scenario import Scenario
from coop_envs.world_pool import open_pool
from experiments.shots import DEVICE, BoolArray, FloatArray, Shots, read_shots

FLASH_S = 3.0
NEAR_M, NEAR_RAD = 0.02, 0.02
LONGEST_DRIVE_S, LONGEST_SCAN_S = 120.0, 300.0
HOLD, FORWARD, YAW, _, REQUEST, AZIMUTH, ELEVATION, BRIGHTNESS = range(len(ACTION_NAMES))


@dataclass(frozen=True)
class Sweep:
    """A raster to ask for: share of the laser's full width, centre (left and up of the robot's heading, rad)."""

    share: float = 1.0
    azimuth_rad: float = 0.0
    elevation_rad: float = -0.25

    def mirrored(self) -> Sweep:
        return Sweep(self.share, -self.azimuth_rad, self.elevation_rad)


@dataclass(frozen=True, eq=False)
class Decision:
    """What a decision left: phase, seconds since the start, joules (B, N, 4) drawn since then, bits held (B,), shots.

    Joules are of idling, motion, markers, scanner; bits are the environment's score of the team's map against truth.
    """

    phase: str
    time_s: float
    energy_j: FloatArray
    bits: FloatArray
    shots: Shots


class Survey:
    """B teams of a scenario in its first world, each with its own noise; ``log`` holds all decisions.

    Args:
        scenario: the problem.
        seed: of the first team; the others' follow it.
        teams: B.
        brightness: of the hats while nobody scans, as a share.
    """

    def __init__(self, scenario: Scenario, seed: int = 0, teams: int = 1, brightness: float = 0.5) -> None:
        pool = open_pool(scenario, "train", [0])
        self.scenario, self.teams, self.log = scenario, teams, list[Decision]()
        self.world = pool.worlds[0]
        self.batch = TeamBatch(scenario, PackedPool(scenario, pool, prepare(DEVICE)), teams)
        keys = np.array([team_key(seed + b, 0) for b in range(teams)], dtype=np.uint64)
        self.batch.place(np.ones(teams, dtype=np.int32), keys, np.zeros(teams, dtype=np.int32))
        self._rest = np.zeros((teams, len(scenario.team.members), len(ACTION_NAMES)), dtype=np.float32)
        self._rest[..., HOLD], self._rest[..., BRIGHTNESS] = 1.0, 2.0 * brightness - 1.0
        self.batch.actions.assign(self._rest)
        self.batch.step()

    def flash(self, phase: str, seconds: float = FLASH_S) -> None:
        """Stand with lit hats, so that cameras fix the poses."""
        for _ in range(math.ceil(seconds / self.scenario.rates.decision_s)):
            self._act(phase, self._rest)

    def scan(self, phase: str, robot: int, sweep: Sweep) -> None:
        """One robot of every team draws its raster to the end.

        Raises:
            CoopError: it does not end.
        """
        laser = self.scenario.team.members[robot].laser
        assert laser is not None
        actions = self._rest.copy()
        reach = laser.max_deflection_rad
        actions[:, robot, REQUEST] = sweep.share
        actions[:, robot, AZIMUTH] = sweep.azimuth_rad / reach
        actions[:, robot, ELEVATION] = sweep.elevation_rad / reach
        for _ in range(math.ceil(LONGEST_SCAN_S / self.scenario.rates.decision_s)):
            self._act(phase, actions)
            if (self.batch.command.scan_progress.numpy()[:, robot] >= 1.0).all():
                return
        raise CoopError(f"survey: got no end of {phase} in {LONGEST_SCAN_S:g} s, expected one")

    def drive(self, phase: str, robot: int, pose: ScanPose, speed_m_s: float, yaw_rate_rad_s: float) -> None:
        """One robot of every team drives straight to a pose of the team frame, then turns to its heading.

        Source: the authors' gains, without their term that bends the way towards the heading at its end.

        Raises:
            CoopError: it does not arrive.
        """
        member, arrived = self.scenario.team.members[robot], np.zeros(self.teams, dtype=bool)
        for _ in range(math.ceil(LONGEST_DRIVE_S / self.scenario.rates.decision_s)):
            speed, turn, there = _steer(*self._believed(robot), pose, speed_m_s, yaw_rate_rad_s, arrived)
            if there.all():
                return
            actions = self._rest.copy()
            actions[:, robot, HOLD] = np.where(there, 1.0, -1.0)
            actions[:, robot, FORWARD] = speed / member.cruise_speed_m_s
            actions[:, robot, YAW] = turn / member.cruise_yaw_rate_rad_s
            self._act(phase, actions)
        raise CoopError(f"survey: got no arrival in {phase} within {LONGEST_DRIVE_S:g} s, expected one")

    def _believed(self, robot: int) -> tuple[FloatArray, FloatArray]:
        """Place (B, 2) and heading (B,) of a robot."""
        R = self.batch.belief.rotation.numpy()[:, robot]
        return self.batch.belief.position.numpy()[:, robot, :2].copy(), np.arctan2(R[:, 1, 0], R[:, 0, 0])

    @property
    def _clock_s(self) -> float:
        return len(self.log) * self.scenario.rates.decision_s

    def _act(self, phase: str, actions: NDArray[np.float32]) -> None:
        self.batch.actions.assign(actions)
        self.batch.step()
        time_s = self._clock_s + self.scenario.rates.decision_s
        energy = self.batch.state.energy.numpy().astype(float)
        bits = self.batch.score.information.numpy() * 1e-6
        self.log.append(Decision(phase, time_s, energy, bits, read_shots(self.batch, self._clock_s)))


def _steer(
    place: FloatArray, heading: FloatArray, pose: ScanPose, speed_m_s: float, yaw_rate_rad_s: float, arrived: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Speed and yaw rate (B,) towards a pose, and who has reached it.

    ``arrived`` (B,), kept by the caller, tells who has reached the place and only turns from then on.
    """
    way = np.array([pose.x_m, pose.y_m]) - place
    distance, bearing = np.hypot(*way.T), _wrapped(np.arctan2(way[:, 1], way[:, 0]) - heading)
    arrived |= (distance < NEAR_M) | ((distance < 5 * NEAR_M) & (np.abs(bearing) > 0.5 * math.pi))
    off = np.where(arrived, _wrapped(pose.heading_rad - heading), bearing)
    turn = np.clip(2.0 * off, -yaw_rate_rad_s, yaw_rate_rad_s)
    forward = np.where(arrived | (np.abs(bearing) > 0.5), 0.0, np.minimum(speed_m_s, distance) * np.cos(bearing))
    return forward, turn, arrived & (np.abs(off) < NEAR_RAD)


def _wrapped(angle: FloatArray) -> FloatArray:
    return (angle + math.pi) % (2 * math.pi) - math.pi

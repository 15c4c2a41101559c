"""`EmulatedWorld`: the simulation tick by tick, as firmware sees it: set-points in, sensors out.

One step is one tick of camera and IMU. The environment draws the error of the wheels' odometry once a decision, here it
is drawn once a tick and so much larger that its mean over a decision is as large.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from coop_envs.agents.team import Team
from coop_envs.batch import TeamBatch, belief_settings
from coop_envs.device import prepare
from coop_envs.geometry.keyed_random import team_key
from coop_envs.packed_pool import PackedPool
from coop_envs.scenario import Scenario
from coop_envs.world_pool import open_pool
from coop_envs.worlds.build import Split
from hardware_bridge.battery import voltage_v
from hardware_bridge.protocols.datagrams import Datagram, numbers

DEVICE = "cpu"
MOST_RAD_S, MOST_COUNTS = 1000.0, 32767.0
"""Beyond what any wheel turns, and what fits the 16 bits that a mirror's counts have on the wire."""


@dataclass
class SetPoints:
    """What a robot's firmware was last told; all but the mirror's counts stay until told otherwise."""

    wheels: tuple[float, ...] = (0.0, 0.0)
    brightness: float = 0.0
    laser: float = 0.0
    galvo: tuple[float, ...] = (0.0, 0.0)

    def take(self, message: Datagram) -> None:
        """Take what can be used of a "set" message; a move that comes before the last was begun is dropped."""
        wheels = numbers(message.get("wheels"), 2)
        if wheels is not None:
            self.wheels = tuple(min(max(speed, -MOST_RAD_S), MOST_RAD_S) for speed in wheels)
        for name in ("brightness", "laser"):
            value = numbers([message.get(name)], 1)
            if value is not None:
                setattr(self, name, min(max(value[0], 0.0), 1.0))
        counts = numbers(message.get("galvo"), 2)
        if counts is not None and self.galvo == (0.0, 0.0):
            self.galvo = tuple(min(max(count, -MOST_COUNTS), MOST_COUNTS) for count in counts)


class EmulatedWorld:
    """One team of a scenario in one of its worlds.

    Args:
        scenario: its team's robots are emulated.
        split, world: which of its worlds.
        seed: of slip, noise and everything else, as in `ExplorationParallelEnv.reset`.
    """

    def __init__(self, scenario: Scenario, split: Split, world: int, seed: int) -> None:
        prepare(DEVICE)
        self.scenario = scenario
        every_tick = replace(scenario.rates, ticks_per_decision=1)
        team = _per_tick_odometry(scenario.team, scenario.rates.ticks_per_decision)
        pool = open_pool(scenario, split, [world])
        self._batch = TeamBatch(
            replace(scenario, rates=every_tick, team=team), PackedPool(scenario, pool, DEVICE), teams=1
        )
        self._settings = belief_settings(scenario, pool.map_shape)
        self._plan = pool.plan(np.zeros(1, dtype=np.int32))
        key = np.array([team_key(seed, 0)], dtype=np.uint64)
        self._batch.place(np.ones(1, dtype=np.int32), key, np.zeros(1, dtype=np.int32))
        self.set_points = [SetPoints() for _ in scenario.team.members]
        self.blind: set[int] = set()
        """Robots whose cameras give no frames."""
        self.tick = 0
        self._angles = np.zeros((len(scenario.team.members), 2))
        self._spent_j = self._power_w = np.zeros(len(scenario.team.members))
        command = self._batch.command
        self._wheels, self._brightness = command.wheels.numpy()[0], command.brightness.numpy()[0]
        self._laser, self._galvo = command.laser.numpy()[0, :, 0], command.galvo.numpy()[0, :, 0]
        self._undock, self._collect = command.undock.numpy()[0], command.collect.numpy()[0]
        self._powered = np.ones(len(scenario.team.members), dtype=bool)

    @property
    def tick_s(self) -> float:
        """Length of a tick."""
        return self.scenario.rates.tick_s

    @property
    def powered(self) -> list[bool]:
        """Which robots can still be reached."""
        return self._powered.tolist()

    def operate(self, message: Datagram) -> None:
        """What people do: put reserves down at the dock, take lost robots away; for good."""
        for name, flags in (("undock", self._undock), ("collect", self._collect)):
            named = message.get(name)
            for robot in named if isinstance(named, list) else ():
                if isinstance(robot, int) and 0 <= robot < len(flags):
                    flags[robot] = 1

    def step(self) -> None:
        """Let one tick pass under the present set-points."""
        for i, wanted in enumerate(self.set_points):
            self._wheels[i], self._brightness[i], self._laser[i] = wanted.wheels, wanted.brightness, wanted.laser
            self._galvo[i], wanted.galvo = wanted.galvo, (0.0, 0.0)
        self._batch.physics.step()
        self.tick += 1
        self._angles += self._batch.measurements.wheels.numpy()[0] * self.tick_s
        self._powered = self._batch.measurements.heard.numpy()[0] == 1
        spent_j = self._batch.state.energy.numpy()[0].sum(axis=1)
        self._power_w, self._spent_j = (spent_j - self._spent_j) / self.tick_s, spent_j

    def state_of(self, robot: int) -> Datagram:
        """What one robot's sensors say now."""
        out, member = self._batch.measurements, self.scenario.team.members[robot]
        sees = member.camera is not None and bool(self._powered[robot]) and robot not in self.blind
        return {
            "kind": "state",
            "robot": robot,
            "tick": self.tick,
            "time_s": self.tick * self.tick_s,
            "powered": bool(self._powered[robot]),
            "docked": bool(out.docked.numpy()[0, robot]),
            "gyro": out.gyro.numpy()[0, robot, 0].tolist(),
            "accel": out.accel.numpy()[0, robot, 0].tolist(),
            "angles": self._angles[robot].tolist(),
            "wheels": out.wheels.numpy()[0, robot].tolist(),
            "voltage": voltage_v(member.robot.battery, float(out.battery.numpy()[0, robot])),
            "current": float(self._power_w[robot]) / member.robot.battery.voltage_v,
            "brightness": self.set_points[robot].brightness,
            "blobs": self._blobs(robot) if sees else None,
            "spot": self._spot(robot) if sees else None,
            "stamp": float(out.spot_stamp.numpy()[0, robot, 0]),
        }

    def _blobs(self, robot: int) -> list[list[float]]:
        seen = self._batch.physics.features
        count = int(seen.count.numpy()[0, robot])
        columns = [seen.pixel.numpy()[0, robot, :count], seen.hue.numpy()[0, robot, :count, None]]
        return np.column_stack([*columns, seen.signal.numpy()[0, robot, :count, None]]).astype(float).tolist()

    def _spot(self, robot: int) -> list[float] | None:
        out = self._batch.measurements
        sigma = float(out.spot_sigma.numpy()[0, robot, 0])
        return [*out.spot.numpy()[0, robot, 0].tolist(), sigma] if sigma > 0.0 else None

    def site(self) -> dict[str, Any]:
        """Where people set the robots down, and the settings of the scenario's belief, as plain values."""
        plan = {name: np.asarray(value)[0].tolist() for name, value in vars(self._plan).items()}
        settings = {name: asdict(getattr(self._settings, name)) for name in ("rates", "estimation", "map")}
        sensing = self.scenario.sensing
        seeing = {
            "pixel_noise_px": sensing.pixel_noise_px,
            "hue_tolerance_deg": sensing.hue_tolerance_deg,
            "min_leds": sensing.min_leds,
        }
        return {
            "plan": plan,
            **settings,
            "seeing": seeing,
            "time_limit_s": self._settings.time_limit_s,
            "map_shape": list(self._settings.map_shape),
            "collects_lost": self.scenario.task.collect_lost,
        }

    def truth(self) -> Datagram:
        """Where the robots really are, in the team frame of the start, for judges."""
        state = self._batch.state
        x, y, z, yaw = (float(v) for v in state.frame.numpy()[0])
        away = state.position.numpy()[0].astype(float) - (x, y, z)
        c, s = math.cos(yaw), math.sin(yaw)
        turned = away @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return {
            "kind": "truth",
            "tick": self.tick,
            "position": turned.tolist(),
            "yaw": (state.yaw.numpy()[0].astype(float) - yaw).tolist(),
            "path": state.path.numpy()[0].tolist(),
            "status": state.status.numpy()[0].tolist(),
            "wheels": state.wheels.numpy()[0].tolist(),
            "set_wheels": [list(points.wheels) for points in self.set_points],
        }


def _per_tick_odometry(team: Team, ticks: int) -> Team:
    members = tuple(
        replace(m, robot=replace(m.robot, odometry_noise=m.robot.odometry_noise * math.sqrt(ticks)))
        for m in team.members
    )
    return replace(team, members=members)

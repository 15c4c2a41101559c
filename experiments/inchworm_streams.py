"""Measurements of inchworm teams on their way, tick by tick beside the truth; nothing is stored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.batch import open_physics
from coop_envs.device import prepare
from coop_envs.geometry.keyed_random import team_key
from coop_envs.packed_pool import PackedPool
from coop_envs.scenario import Scenario
from coop_envs.world_pool import open_pool
from experiments.inchworm_driver import OBSERVER, Driver, Plan, legs_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Blind:
    """Between these x (m, world) a driving observer's pose solver fails to converge, as on the thesis's rocks."""

    from_x_m: float
    to_x_m: float


class Streams:
    """B teams of a scenario at its camera's rate, driven along a plan; `step` advances all that have not arrived.

    ``measurements`` and ``command`` are those of one tick; ``running`` (B,) is 0 where a team has arrived.
    """

    def __init__(
        self,
        scenario: Scenario,
        plan: Plan,
        teams: int,
        seed: int = 0,
        worlds: int = 1,
        blind: Blind | None = None,
    ) -> None:
        assert scenario.rates.ticks_per_decision == 1, "one frame a step"
        self.scenario, self.blind = scenario, blind
        pool = open_pool(scenario, "train", range(worlds))
        packed = PackedPool(scenario, pool, prepare("cpu"))
        self.physics = open_physics(scenario, packed, teams)
        self.measurements, self.command = self.physics.measurements, self.physics.command
        self.running = self.physics.running
        self.tick_s = scenario.rates.tick_s
        self.driver = Driver(legs_of(plan), plan.pace, teams, self.tick_s)
        keys = np.array([team_key(seed + b, 0) for b in range(teams)], dtype=np.uint64)
        world = np.arange(teams, dtype=np.int32) % worlds
        self.physics.reset(np.ones(teams, dtype=np.int32), keys, world)
        self.starts = np.asarray(pool.starts[world], dtype=np.float64)
        robots = [member.robot for member in scenario.team.members]
        self._track_m = np.array([robot.track_m for robot in robots])
        self._wheel_m = np.array([robot.wheel_radius_m for robot in robots])
        self.command.brightness.fill_(1.0)
        self.ticks = 0

    @property
    def share(self) -> float:
        """How much of the way the teams have gone, 0 to 1."""
        return float(np.mean(self.driver.leg)) / len(self.driver.goals)

    @property
    def time_s(self) -> float:
        return self.ticks * self.tick_s

    def step(self) -> bool:
        """One tick of every team on its way; False once all have arrived."""
        if self.driver.done.all():
            return False
        speed, turn = self.driver.command(self._world("position"), self._world("yaw"))
        self.running.assign((~self.driver.done).astype(np.int32))
        half = 0.5 * turn * self._track_m
        wheels = np.stack([speed - half, speed + half], axis=-1) / self._wheel_m[:, None]
        self.command.wheels.assign(wheels.astype(np.float32))
        self.command.hold.assign((np.abs(wheels).max(axis=-1) == 0).astype(np.int32))
        self.physics.step()
        self.measurements.seen.numpy()[self.driver.done] = 0
        self.ticks += 1
        if self.blind is not None:
            self._lose_sight(self.blind)
        return True

    def _lose_sight(self, blind: Blind) -> None:
        """No poses of anyone while the observer drives there."""
        x = self._world("position")[:, OBSERVER, 0]
        drives = np.abs(self.command.wheels.numpy()[:, OBSERVER]).max(axis=-1) > 0
        self.measurements.seen.numpy()[drives & (x > blind.from_x_m) & (x < blind.to_x_m)] = 0

    def _world(self, name: str) -> NDArray[Any]:
        return np.asarray(getattr(self.physics.state, name).numpy(), dtype=np.float64)

    def truth(self) -> tuple[Array, Array]:
        """True positions (B, N, 3) and rotations (B, N, 3, 3) in the team frames."""
        frame = self._world("frame")
        c, s = np.cos(frame[:, 3]), np.sin(frame[:, 3])
        zero, one = np.zeros_like(c), np.ones_like(c)
        turn = np.stack([c, s, zero, -s, c, zero, zero, zero, one], axis=-1).reshape(-1, 3, 3)
        position = np.einsum("bij,bnj->bni", turn, self._world("position") - frame[:, None, :3])
        return position, np.einsum("bij,bnjk->bnik", turn, self._world("rotation"))

    def path_m(self) -> Array:
        """(B, N) how far each robot has gone."""
        return self._world("path")

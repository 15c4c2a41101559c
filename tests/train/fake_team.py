"""An environment that costs nothing, for tests of what runs environments: coverage grows by a known law."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from coop_envs.agents.catalog import load_team
from coop_envs.errors import require
from coop_envs.policy import TeamDescription
from coop_envs.recording import Frame, Scan, WorldPicture

DECISION_S, LIMIT_S = 0.2, 20.0


class FakeTeam:
    """Covers ``rate`` of the world each second until the time is over; ``rate`` grows with the seed."""

    def __init__(self, scenario: str = "arena", team: str = "inchworm", world: str | None = None, **_: Any) -> None:
        require(scenario == "arena", "scenario", scenario, "arena")
        members = load_team(team).members
        names = tuple(member.name for member in members)
        self.scenario = SimpleNamespace(name=scenario)
        self.team_description = TeamDescription(names, members, 0.05, DECISION_S, True, LIMIT_S)
        self.agents: list[str] = []

    def reset(self, seed: int, options: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        self.seed, self.decisions, self.agents = seed, 0, list(self.team_description.names)
        assert options["split"] in ("train", "heldout")
        assert options["world_index"] >= 0
        return self._observations(), {}

    def step(self, actions: dict[str, Any]) -> tuple[dict[str, Any], ...]:
        assert set(actions) == set(self.agents)
        self.decisions += 1
        if self.time_s >= LIMIT_S:
            self.agents = []
        return self._observations(), {}, {}, {}, {}

    @property
    def time_s(self) -> float:
        return self.decisions * DECISION_S

    @property
    def coverage(self) -> float:
        return min(1.0, self.time_s * (self.seed + 1) / 50.0)

    def frame(self, volume: bool = False) -> Frame:
        n = len(self.team_description.names)
        return Frame(
            time_s=self.time_s,
            names=self.team_description.names,
            role=tuple(name.partition("_")[0] for name in self.team_description.names),
            status=np.where(np.arange(n) == n - 1, 2, 1).astype(np.int8),
            declared=np.ones(n, dtype=np.int8),
            true_xy_yaw=np.zeros((n, 3)),
            belief_xy_yaw=np.zeros((n, 3)),
            belief_cov_xy=np.tile(1e-4 * np.eye(2), (n, 1, 1)),
            stationary=np.ones(n, dtype=np.bool_),
            collected=np.zeros(n, dtype=np.bool_),
            fov_rad=np.ones(n),
            range_m=np.ones(n),
            body_radius_m=np.full(n, 0.05),
            sees=np.zeros((n, n), dtype=np.bool_),
            scanning=np.zeros(n, dtype=np.bool_),
            points_m=self.scan().points_m,
            point_sigma_m=self.scan().point_sigma_m,
            point_robots=self.scan().point_robots,
            point_eyes_m=self.scan().point_eyes_m,
            map_ground=np.full((10, 10), 128, dtype=np.uint8),
            map_obstacle=np.full((10, 10), 128, dtype=np.uint8),
            map_volume=np.full((2 * volume, 10, 10), 128, dtype=np.uint8),
            T_world_map=np.zeros(3),
            cell_m=0.05,
            volume_floor_m=0.0,
            energy_j=15.0 * self.time_s,
            action_energy_j=self.time_s,
            information_bits=100.0 * self.coverage,
            coverage=self.coverage,
        )

    def scan(self) -> Scan:
        """One point a decision, in a row along x."""
        at = [[0.01 * self.decisions, 0.1, 0.2]]
        return Scan(np.array(at), np.array([0.01]), np.array([[0, 0, 1]], dtype=np.int16), np.zeros((1, 2, 3)))

    def world_picture(self) -> WorldPicture:
        heights = np.zeros((11, 11), dtype=np.float32)
        return WorldPicture(heights, (0.0, 0.0), 0.05, (), None, ((0.1, 0.1, 0.0),), (0.0, 0.0, 0.5, 0.5))

    def metrics(self, scan: Scan | None) -> dict[str, Any]:
        return {
            **({} if scan is None else {"points_measured": len(scan), "reach_m": float(scan.points_m[:, 0].max())}),
            "coverage": self.coverage,
            "information_bits": 100.0 * self.coverage,
            "energy_j": 15.0 * self.time_s,
            "action_energy_j": self.time_s,
            "bits_per_joule": 100.0 * self.coverage / max(self.time_s, 1e-9),
            "hazards_found": 1,
            "pickets_lost": 1,
            "mapped_m2": 0.25 * self.coverage,
            "observer_survived": True,
            "position_drift_m": np.float32(0.01),
            "heading_drift_deg": 0.5,
            "drift_percent_of_path": float("nan"),
            "nees": 3.0,
            "simulated_s": self.time_s,
            "success": self.seed % 2 == 0,
        }

    def render(self) -> Any:
        return np.full((32, 32, 3), 10 * (self.decisions % 20), dtype=np.uint8)

    def close(self) -> None:
        self.agents = []

    def _observations(self) -> dict[str, Any]:
        return {name: {"self": np.zeros(26, dtype=np.float32)} for name in self.team_description.names}


def make_env(**settings: Any) -> FakeTeam:
    """What evaluate calls in place of `exploration_v0.parallel_env`."""
    settings.pop("render_mode", None)
    return FakeTeam(**settings)

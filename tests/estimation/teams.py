"""Batches of teams driven by hand, and how far their beliefs are from the truth."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from coop_envs.batch import TeamBatch
from coop_envs.device import prepare
from coop_envs.estimation.belief import Declared
from coop_envs.geometry.keyed_random import team_key
from coop_envs.packed_pool import PackedPool
from coop_envs.scenario import load_scenario
from coop_envs.world_pool import open_pool
from coop_envs.worlds.world import Hazard

Motion = tuple[Any, Any]  # forward and yaw action of a robot, numbers or (B,)


class Teams:
    """B teams in the first world of a scenario, with other hazards if given; time in decisions."""

    def __init__(
        self,
        scenario: str = "u_turn",
        teams: int = 1,
        seed: int = 0,
        hazards: tuple[Hazard, ...] | None = None,
        **overrides: Any,
    ) -> None:
        self.scenario = load_scenario(scenario, **overrides)
        pool = open_pool(self.scenario, "train", [0])
        if hazards is not None:
            pool = dataclasses.replace(pool, worlds=(dataclasses.replace(pool.worlds[0], hazards=hazards),))
        self.B, self.n = teams, len(self.scenario.team.members)
        self.batch = TeamBatch(self.scenario, PackedPool(self.scenario, pool, prepare("cpu")), teams)
        keys = np.array([team_key(seed + b, 0) for b in range(teams)], dtype=np.uint64)
        self.batch.place(np.ones(teams, dtype=np.int32), keys, np.zeros(teams, dtype=np.int32))
        self.act({})

    def act(self, motions: Mapping[int, Motion], brightness: float = 0.0) -> None:
        """One decision: these robots drive, the others hold."""
        actions = np.zeros((self.B, self.n, 8), dtype=np.float32)
        actions[:, :, 0], actions[:, :, 7] = 1.0, brightness
        for r, (forward, yaw) in motions.items():
            actions[:, r, 0], actions[:, r, 1], actions[:, r, 2] = 0.0, forward, yaw
        self.batch.actions.assign(actions)
        self.batch.step()

    def drive(self, motions: Mapping[int, Motion], decisions: int) -> None:
        for _ in range(decisions):
            self.act(motions)

    def rest(self, decisions: int) -> None:
        self.drive({}, decisions)

    def state(self, name: str) -> np.ndarray:
        return getattr(self.batch.state, name).numpy().copy()

    def belief(self, name: str) -> np.ndarray:
        return getattr(self.batch.belief, name).numpy().copy()

    def true_position(self) -> np.ndarray:
        """(B, N, 3) in the team frames."""
        frame = self.state("frame").astype(float)
        turn = Rotation.from_rotvec(-frame[:, 3:] * [0.0, 0.0, 1.0]).as_matrix()
        return np.einsum("bij,bnj->bni", turn, self.state("position").astype(float) - frame[:, None, :3])

    def true_rotation(self) -> np.ndarray:
        turn = Rotation.from_rotvec(-self.state("frame")[:, 3:].astype(float) * [0.0, 0.0, 1.0]).as_matrix()
        return np.einsum("bij,bnjk->bnik", turn, self.state("rotation").astype(float))

    def errors(self) -> np.ndarray:
        """(B, N, 6) theta and p, the truth against the belief."""
        R = self.true_rotation() @ np.swapaxes(self.belief("rotation"), -1, -2)
        theta = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec().reshape(self.B, self.n, 3)
        return np.concatenate([theta, self.true_position() - self.belief("position")], axis=-1)

    def position_error_m(self) -> np.ndarray:
        return np.linalg.norm(self.errors()[..., 3:], axis=-1)

    def nees(self, part: slice = np.s_[:6]) -> np.ndarray:
        """(B, N) squared Mahalanobis distance of theta, p or both, over its degrees of freedom; NaN in the dock."""
        e, P = self.errors()[..., part], self.belief("pose_covariance")[..., part, part]
        P[self.belief("declared") == Declared.DOCKED] = np.nan
        return np.einsum("bni,bni->bn", e, np.linalg.solve(P, e[..., None])[..., 0]) / e.shape[-1]

    def push_truth(self, r: int, shift_m: tuple[float, float]) -> None:
        """Lift robot r and set it down elsewhere; nobody is told."""
        position = self.state("position")
        position[:, r, :2] += shift_m
        self.batch.state.position.assign(position)

    def steer(self, r: int, lane_y_m: float, forward: float = 0.95) -> Motion:
        """Motion that takes robot r along y = lane (team frame), by the truth."""
        y, R = self.true_position()[:, r, 1], self.true_rotation()[:, r]
        aim = np.clip(2.0 * (lane_y_m - y), -0.8, 0.8)
        return forward, np.clip(2.0 * (aim - np.arctan2(R[:, 1, 0], R[:, 0, 0])), -1.0, 1.0)

    def drive_lane(self, r: int, lane_y_m: float, decisions: int, forward: float = 0.95) -> None:
        """Drive robot r along y = lane."""
        for _ in range(decisions):
            self.act({r: self.steer(r, lane_y_m, forward)})


def filter_covariance(teams: Teams, b: int) -> np.ndarray:
    """The used part of team b's covariance, free slots left out."""
    P = teams.belief("covariance")[b]
    used = np.flatnonzero(np.diag(P) > 0.0)
    return P[np.ix_(used, used)]


def is_sane(P: np.ndarray) -> bool:
    """Finite, symmetric and positive definite at its own scale."""
    sigma = np.sqrt(np.diag(P))
    scaled = P / np.outer(sigma, sigma)
    return bool(np.isfinite(P).all() and np.array_equal(P, P.T) and np.linalg.eigvalsh(scaled).min() > 1e-10)


def set_state(teams: Teams, name: str, value: np.ndarray) -> None:
    target: wp.array = getattr(teams.batch.state, name)
    target.assign(value)

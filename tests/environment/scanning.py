"""Teams that stand and scan, and where their lasers land in truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from coop_envs.geometry.terrain import Terrain, cast_ray
from tests.estimation.teams import Teams

OK = 0
REQUEST, ELEVATION = 4, 6


@wp.kernel
def cast(terrain: Terrain, starts: wp.array[wp.vec3], rays: wp.array[wp.vec3], hits: wp.array[float]):
    k = wp.tid()
    hits[k] = cast_ray(terrain, 0, starts[k], rays[k], 10.0)


@dataclass
class Shots:
    """Points (k, 3) in the team frame with their covariance (k, 3, 3), and where the ray landed in truth."""

    points: np.ndarray
    covariance: np.ndarray
    truth: np.ndarray

    @property
    def normalised(self) -> np.ndarray:
        """Squared Mahalanobis distance over 3, (k,)."""
        error = self.points - self.truth
        return np.einsum("ki,ki->k", error, np.linalg.solve(self.covariance, error[..., None])[..., 0]) / 3.0


class Surveyors(Teams):
    """Batches of teams in a scenario, whose robots scan where they stand."""

    def scan(self, decisions: int, request: float = 0.5, elevation: float = -0.2) -> list[Shots]:
        """Scan for so many decisions after fixing poses; the shots of every team."""
        self.rest(15)
        found: list[list[tuple[Any, ...]]] = [[] for _ in range(self.B)]
        for _ in range(decisions):
            actions = np.zeros((self.B, self.n, 8), dtype=np.float32)
            actions[:, :, 0], actions[:, :, REQUEST], actions[:, :, ELEVATION] = 1.0, request, elevation
            self.batch.actions.assign(actions)
            self.batch.step()
            for b in range(self.B):
                found[b] += self._shots(b)
        return [Shots(*(np.array([shot[k] for shot in shots]) for k in range(3))) for shots in found]

    def _shots(self, b: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        points, state = self.batch.loop.points, self.batch.state
        ticks = np.flatnonzero(points.answer.numpy()[b] == OK)
        if not len(ticks):
            return []
        members = self.scenario.team.members
        lit = self.batch.command.laser.numpy()[b].argmax(axis=0)[ticks]
        mirror = state.mirror.numpy()[b, lit, ticks].astype(float)
        R, p = state.rotation.numpy()[b, lit].astype(float), state.position.numpy()[b, lit].astype(float)
        lasers = [members[r].laser for r in lit]
        level = np.cos(mirror[:, 1])
        rays = np.stack([np.cos(mirror[:, 0]) * level, np.sin(mirror[:, 0]) * level, np.sin(mirror[:, 1])], axis=-1)
        rays = np.einsum("kij,kj->ki", R, rays)
        starts = p + np.einsum("kij,kj->ki", R, np.array([laser.position_m for laser in lasers if laser]))
        away = wp.zeros(len(ticks), dtype=float, device="cpu")
        ends = [wp.array(a.astype(np.float32), dtype=wp.vec3, device="cpu") for a in (starts, rays)]
        wp.launch(cast, len(ticks), inputs=[self.batch.physics.ground.terrain, *ends, away], device="cpu")
        x, y, z, yaw = state.frame.numpy()[b].astype(float)
        c, s = np.cos(yaw), np.sin(yaw)
        landed = (starts + rays * away.numpy()[:, None] - (x, y, z)) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        covariance = points.covariance.numpy()[b, ticks].astype(float)
        return list(zip(points.position.numpy()[b, ticks].astype(float), covariance, landed, strict=True))

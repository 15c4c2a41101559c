"""A team's belief in its own frame, with known truth in a world that it has never heard of."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_team
from coop_envs.agents.command import Command
from coop_envs.estimation.settings import Estimation
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.geometry.arrays import allocate
from coop_envs.localization.placing import BodyFix
from coop_envs.sensing.measurements import allocate_measurements

ROBOTS, SIZE = 4, 15
TEAM = load_team(
    {
        "members": [
            {"role": "observer", "robot": "zumy", "cameras": ["lifecam"], "hat": "hat0"},
            {"role": "picket", "robot": "zumy", "hat": "zumy", "count": ROBOTS - 1},
        ]
    }
)
PLACES = np.array([[0.0, 0.0, 0.0], [1.5, 0.4, 0.05], [0.6, -1.2, 0.1], [2.0, -0.8, 0.6]])
SCALE = np.tile(np.repeat([0.02, 0.02, 0.03, 1e-3, 1e-2], 3), ROBOTS)


def new_filter() -> TeamFilter:
    measured = allocate_measurements(1, ROBOTS, 2, "cpu")
    team = TeamFilter(TEAM, Estimation(), measured, allocate(Command, (1, ROBOTS, 2), "cpu"))
    team.reset(np.zeros((1, ROBOTS, 3)))
    return team


def believe(team: TeamFilter, rng: np.random.Generator, independent: bool = False, times: float = 1.0) -> np.ndarray:
    """Put a random belief into the filter, its sigmas ``times`` the usual; returns its covariance (15 N, 15 N)."""
    state = team.snapshot()
    state["position"][0] = PLACES + rng.normal(size=PLACES.shape) * 0.05
    state["rotation"][0] = Rotation.from_euler("zyx", rng.normal(size=(ROBOTS, 3)) * [1.0, 0.2, 0.2]).as_matrix()
    state["velocity"][0] = rng.normal(size=(ROBOTS, 3)) * 0.2
    A = rng.normal(size=(SIZE * ROBOTS, SIZE * ROBOTS)) / np.sqrt(SIZE * ROBOTS)
    correlation = A @ A.T + 0.1 * np.eye(len(A))
    if independent:
        correlation *= np.kron(np.eye(ROBOTS), np.ones((SIZE, SIZE)))
    P = times**2 * SCALE[:, None] * correlation * SCALE
    P = 0.5 * (P + P.T)
    state["covariance"][0, : len(P), : len(P)] = P
    for r in range(ROBOTS):
        state["pose_covariance"][0, r] = P[SIZE * r : SIZE * r + 6, SIZE * r : SIZE * r + 6]
    team.restore(state)
    return P


def draw_truth(team: TeamFilter, P: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """True rotations (N, 3, 3) and places (N, 3) in the team frame, as the belief's covariance has them."""
    state = team.snapshot()
    e = (np.linalg.cholesky(P) @ rng.normal(size=len(P))).reshape(ROBOTS, 5, 3)
    return Rotation.from_rotvec(e[:, 0]).as_matrix() @ state["rotation"][0], state["position"][0] + e[:, 1]


def random_frame(rng: np.random.Generator, tilt_rad: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """R_world_team and p_world_team, any or upright but for a tilt."""
    R = Rotation.random(rng=rng).as_matrix()
    if tilt_rad is not None:
        tilt = Rotation.from_rotvec([*rng.normal(size=2) * tilt_rad, 0.0])
        R = (tilt * Rotation.from_euler("z", rng.uniform(-3, 3))).as_matrix()
    return R, rng.uniform(-5, 5, 3)


def noisy_fix(
    robot: int, R: np.ndarray, p: np.ndarray, whole: bool, rng: np.random.Generator, times: float = 1.0
) -> BodyFix:
    """A fix of a robot that is truly at R, p, with errors of its covariance."""
    A = rng.normal(size=(6, 6))
    scale = times * np.repeat([0.01, 0.02], 3)
    covariance = scale[:, None] * (A @ A.T / 6 + 0.2 * np.eye(6)) * scale
    e = np.linalg.cholesky(covariance) @ rng.normal(size=6)
    if whole:
        return BodyFix(robot, p + e[3:], Rotation.from_rotvec(e[:3]).as_matrix() @ R, covariance)
    return BodyFix(robot, p + e[3:], None, covariance[3:, 3:])


def pose_errors(team: TeamFilter, R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Errors (6 N,) of the believed poses, (theta, p) each."""
    state = team.snapshot()
    theta = Rotation.from_matrix(R @ np.swapaxes(state["rotation"][0], -1, -2)).as_rotvec()
    return np.concatenate([theta, p - state["position"][0]], axis=1).ravel()


def pose_block(team: TeamFilter) -> np.ndarray:
    """Covariance (6 N, 6 N) of all poses."""
    state = team.snapshot()
    rows = (SIZE * state["slot"][0][:, None] + np.arange(6)).ravel()
    return state["covariance"][0][np.ix_(rows, rows)]

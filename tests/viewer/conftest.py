"""A made-up episode in an arena: an observer, two pickets and two reserves; one picket ends in the trap."""

import math

import numpy as np
import pytest

from coop_envs.recording.frame import Frame, HazardPicture, WorldPicture, frame_from_arrays

NAMES = ("observer_0", "picket_0", "picket_1", "picket_2", "picket_3")
CELL_M = 0.05
POINTS = 5


def arena() -> WorldPicture:
    cell = 0.01
    x = np.arange(-0.50, 0.801, cell)
    y = np.arange(-0.05, 0.651, cell)
    heights = np.zeros((x.size, y.size), np.float32)
    heights += (0.002 * np.sin(9 * x)[:, None] * np.cos(7 * y)[None]).astype(np.float32)
    heights[:, y < -0.001] = heights[x < -0.451, :] = 0.04
    heights[np.ix_(x < 0, y > 0.601)] = 0.04
    heights[np.ix_(x >= 0, y > 0.601)] = heights[x > 0.751, :] = 0.30
    trap = HazardPicture("trap", (0.375, 0.30), (0.075, 0.075))
    starts = ((-0.25, 0.30, 0.0), (-0.05, 0.40, 0.0), (-0.05, 0.20, 0.0))
    return WorldPicture(heights, (-0.5, -0.05), cell, (trap,), (0.62, 0.30, 0.08), starts, (-0.5, -0.05, 0.8, 0.65))


def path(i: int, t: float) -> tuple[float, float, float]:
    """Pose of robot i at share t of the episode."""
    if i == 0:
        a = 0.5 * t
        return -0.25 + 0.35 * t + 0.02 * math.sin(8 * t), 0.30 + 0.10 * math.sin(2 * t), 0.3 * math.sin(6 * a)
    if i == 1:
        return -0.05 + 0.65 * t, 0.42 + 0.09 * math.sin(5 * t), 0.5 * math.cos(5 * t)
    if i == 2:
        t = min(t, 0.6)
        return -0.05 + 0.60 * t, 0.20 + 0.10 * t * t, 0.35 * t
    return -0.06, 0.30, 0.0


def points(rng: np.random.Generator, k: int) -> np.ndarray:
    """Points on the floor, and every third time on the wall at the right."""
    floor = rng.uniform((0.1, 0.05, 0.0), (0.7, 0.55, 0.002), (POINTS, 3))
    wall = rng.uniform((0.745, 0.05, 0.02), (0.75, 0.55, 0.25), (POINTS, 3))
    return wall if k % 3 == 0 else floor


def episode(count: int = 120) -> list[Frame]:
    rng = np.random.default_rng(7)
    ground = np.full((26, 14), 128, np.uint8)
    obstacle = np.full((26, 14), 128, np.uint8)
    frames = []
    drift = np.zeros((len(NAMES), 2))
    for k in range(count):
        t = k / (count - 1)
        true = np.array([path(i, t) for i in range(len(NAMES))])
        drift += 0.0009 * rng.standard_normal(drift.shape) * np.array([[0.4], [1], [1], [0], [0]])
        belief = true + np.concatenate([drift, 0.03 * rng.standard_normal((5, 1))], axis=1)
        trapped = t > 0.6
        for i in range(3):
            u, v = ((belief[i, :2] - (-0.5, -0.05)) / CELL_M).astype(int)
            ground[u - 1 : u + 1, v - 1 : v + 1] = np.maximum(ground[u - 1 : u + 1, v - 1 : v + 1], 235)
        obstacle[8:20, 2:12] = 60
        if t > 0.7:
            ground[16:18, 6:8] = (30, 70)
            obstacle[24:26, 3:11] = 230
        grow = 1 + 3 * t
        cov = np.array(
            [np.diag([a, b]) for a, b in ((4e-5, 3e-5), (3e-4, 8e-5), (1e-4, 4e-4), (1e-6, 1e-6), (1e-6, 1e-6))]
        )
        turn = np.array([[math.cos(0.6), -math.sin(0.6)], [math.sin(0.6), math.cos(0.6)]])
        sees = np.zeros((5, 5), bool)
        sees[0, 1] = True
        sees[0, 2] = not trapped or k % 3 > 0
        frames.append(
            frame_from_arrays(
                {
                    "time_s": 0.2 * k,
                    "names": NAMES,
                    "role": ("observer", "picket", "picket", "picket", "picket"),
                    "status": [1, 1, 2 if trapped else 1, 0, 0],
                    "declared": [1, 1, 2 if t > 0.7 else 1, 0, 0],
                    "true_xy_yaw": true,
                    "belief_xy_yaw": belief,
                    "belief_cov_xy": grow * turn @ cov @ turn.T,
                    "stationary": [k % 20 < 10, k % 20 >= 10, t > 0.7, False, False],
                    "collected": [False] * 5,
                    "fov_rad": [1.05, 0, 0, 0, 0],
                    "range_m": [3.0, 0, 0, 0, 0],
                    "body_radius_m": [0.07, 0.05, 0.05, 0.05, 0.05],
                    "sees": sees,
                    "scanning": [k % 20 < 10, k % 20 < 10, False, False, False],
                    "points_m": points(rng, k),
                    "point_sigma_m": np.full(POINTS, 0.01),
                    "point_robots": np.tile((k % 2, 0, 1), (POINTS, 1)),
                    "point_eyes_m": np.zeros((POINTS, 2, 3)),
                    "map_ground": ground,
                    "map_obstacle": obstacle,
                    "map_volume": np.full((4, 26, 14), 128, np.uint8),
                    "volume_floor_m": -0.075,
                    "T_world_map": (-0.5, -0.05, 0.0),
                    "cell_m": CELL_M,
                    "energy_j": 15.0 * 0.2 * k,
                    "action_energy_j": 1.7 * 0.2 * k,
                    "information_bits": float((ground != 128).sum()),
                    "coverage": float((ground > 200).sum() / 200),
                }
            )
        )
    return frames


@pytest.fixture(scope="session")
def world() -> WorldPicture:
    return arena()


@pytest.fixture(scope="session")
def frames() -> list[Frame]:
    return episode()

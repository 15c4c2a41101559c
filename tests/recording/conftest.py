import math

import numpy as np
import pytest

from coop_envs.recording import Frame
from coop_envs.recording.frame import frame_from_arrays


def random_frame(time_s: float, seed: int, robots: int = 3) -> Frame:
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(2, robots, 3))
    spread = rng.normal(size=(robots, 2, 2))
    arrays = {
        "time_s": time_s,
        "names": ("observer_0", *(f"picket_{i}" for i in range(robots - 1))),
        "role": ("observer", *("picket",) * (robots - 1)),
        "status": rng.integers(0, 6, robots),
        "declared": rng.integers(0, 3, robots),
        "true_xy_yaw": poses[0],
        "belief_xy_yaw": poses[1],
        "belief_cov_xy": spread @ spread.swapaxes(1, 2),
        "stationary": rng.random(robots) < 0.5,
        "collected": rng.random(robots) < 0.2,
        "fov_rad": np.where(np.arange(robots) == 0, 1.0, 0.0),
        "range_m": np.where(np.arange(robots) == 0, math.inf, 0.0),
        "body_radius_m": np.full(robots, 0.05),
        "sees": rng.random((robots, robots)) < 0.5,
        "scanning": rng.random(robots) < 0.5,
        "points_m": rng.normal(size=(seed % 4, 3)),
        "point_sigma_m": rng.random(seed % 4),
        "point_robots": rng.integers(-1, robots, (seed % 4, 3)),
        "point_eyes_m": rng.normal(size=(seed % 4, 2, 3)),
        "map_ground": rng.integers(0, 256, (12, 7)),
        "map_obstacle": rng.integers(0, 256, (12, 7)),
        "map_volume": rng.integers(0, 256, (2, 12, 7)),
        "volume_floor_m": -0.075,
        "T_world_map": (-0.1, 0.2, 0.3),
        "cell_m": 0.05,
        "energy_j": rng.random(),
        "action_energy_j": rng.random(),
        "information_bits": rng.random(),
        "coverage": rng.random(),
    }
    return frame_from_arrays(arrays)


@pytest.fixture
def frames() -> list[Frame]:
    return [random_frame(0.2 * k, seed=k) for k in range(24)]

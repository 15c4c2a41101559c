"""That the map window lies as the probes take it to, seen in the environment itself."""

from __future__ import annotations

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.observations import WINDOW, mate_field, self_field


@pytest.mark.parametrize("scenario", ["arena", "u_turn"])
def test_the_robot_stands_in_the_middle_and_its_mates_where_the_heading_says(scenario):
    """Mates are told in the body's axes, drawn in the window's: turned by the heading they must meet."""
    env = exploration_v0.parallel_env(scenario=scenario, num_worlds=1)
    observations, _ = env.reset(seed=2)
    turning = np.array([-1.0, 0.6, 1.0, 0, 0, 0, 0, 0], dtype=np.float32)
    for _ in range(8):
        observations, *_ = env.step(dict.fromkeys(env.agents, turning))
    cell_m, met = env.team_description.cell_m, 0
    for seen in observations.values():
        if self_field(seen, "docked"):
            continue
        robots = seen["map"][2] > 0
        assert robots[8, 8]
        c, s = self_field(seen, "cos_yaw"), self_field(seen, "sin_yaw")
        x, y = mate_field(seen, "x"), mate_field(seen, "y")
        cells = np.column_stack([c * x - s * y, s * x + c * y]) / cell_m + 8.5
        for i, j in cells[(seen["mask"] == 1) & (mate_field(seen, "docked") == 0)]:
            near = np.s_[max(int(i) - 1, 0) : int(i) + 2, max(int(j) - 1, 0) : int(j) + 2]  # half a cell of doubt
            if 1 <= i < WINDOW - 1 and 1 <= j < WINDOW - 1:
                assert robots[near].any()
                met += 1
    assert met > 0

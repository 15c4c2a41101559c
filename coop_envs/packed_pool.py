"""A world pool packed on a device: ground, truth, and what people know of the starts. Batches may share one."""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.joining import Plans
from coop_envs.scenario import Scenario
from coop_envs.simulation.fast import Placement, Stage
from coop_envs.simulation.reset import Starting
from coop_envs.truth_lookup import pack_truth
from coop_envs.world_pool import WorldPool

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class Sites:
    """`WorldPool`'s plans as device arrays over W worlds."""

    start: wp.array2d[wp.vec3]
    dock: wp.array[wp.vec3]
    goal: wp.array[wp.vec4]
    corner: wp.array[wp.vec2]
    cells: wp.array[wp.vec2i]


@wp.kernel
def tell_plans(
    starting: Starting, sites: Sites, plans: Plans, corner: wp.array[wp.vec2], cells: wp.array[wp.vec2i],
    chosen: wp.array[int],
):  # fmt: skip
    """Tell the teams that start anew where people put their robots, and where their maps lie."""
    b = wp.tid()
    chosen[b] = starting.chosen[b]
    if chosen[b] == 0:
        return
    w = starting.world[b]
    for r in range(plans.start.shape[1]):
        plans.start[b, r] = sites.start[w, r]
    plans.dock[b] = sites.dock[w]
    plans.goal[b] = sites.goal[w]
    corner[b] = sites.corner[w]
    cells[b] = sites.cells[w]


class PackedPool:
    """The worlds of ``pool`` for a team: ``stage`` is what robots stand on, ``truth`` what is judged by."""

    def __init__(self, scenario: Scenario, pool: WorldPool, device: str) -> None:
        estimation = scenario.estimation
        placement = Placement(estimation.start_position_m, estimation.start_yaw_rad)
        self.pool, self.device = pool, device
        self.stage = Stage(pool.worlds, len(scenario.team.members), placement, device)
        self.truth = pack_truth(pool.worlds, pool.truth, pool.solids, device)
        self.sites = Sites()
        self.sites.start = wp.array(pool.starts, dtype=wp.vec3, device=device)
        self.sites.dock = wp.array(pool.docks, dtype=wp.vec3, device=device)
        self.sites.goal = wp.array(pool.goals, dtype=wp.vec4, device=device)
        self.sites.corner = wp.array(pool.corner, dtype=wp.vec2, device=device)
        self.sites.cells = wp.array(pool.map_cells, dtype=wp.vec2i, device=device)

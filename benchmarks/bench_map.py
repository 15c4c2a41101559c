"""How fast scan rays enter the map: 2 m rays, 10 cm cylinders, 5 cm cells; processor time of one core.

    python benchmarks/bench_map.py [--out FILE.json]

Floor: a ray of 2 m touches 40 slices of about 4 x 4 cells. Fresh rays change cells (and note the change for the score),
repeated ones find most cells saturated.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import numpy as np
import warp as wp

from coop_envs.device import prepare
from coop_envs.mapping.ground_map import GroundMap, MapModel, allocate_map, begin_map
from coop_envs.mapping.volume import judge_changes, mark_point, sweep_ray

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

RAYS, LENGTH_M, TRIALS = 1000, 2.0, 15
SIDE, LEVELS = 256, 16


@wp.kernel
def enter(ground: GroundMap, model: MapModel, starts: wp.array[wp.vec3], ends: wp.array[wp.vec3]):
    for k in range(starts.shape[0]):
        if k % 12 == 0:  # as many as a decision holds
            judge_changes(ground, model, 0)
            ground.change_count[0] = 0
        sweep_ray(ground, model, 0, starts[k], ends[k])
        mark_point(ground, model, 0, ends[k])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    options = parser.parse_args()
    device = prepare("cpu")
    model = MapModel()
    model.nx, model.ny, model.cell, model.stride, model.mark_radius = SIDE, SIDE, 0.05, 1, 0.1
    model.levels, model.floor, model.clearance, model.step, model.sweep = LEVELS, -0.4, 2, 0, 0.05
    ground: GroundMap = allocate_map(1, 1, model, 0.2, device, swept_cells=20_000)
    rng = np.random.default_rng(1)
    starts = rng.uniform((-3.0, -3.0, -0.2), (3.0, 3.0, 0.2), (RAYS, 3)).astype(np.float32)
    angle, climb = rng.uniform(0, 2 * np.pi, RAYS), rng.uniform(-0.1, 0.1, RAYS)
    way = np.stack([np.cos(angle) * np.cos(climb), np.sin(angle) * np.cos(climb), np.sin(climb)], axis=-1)
    rays = [wp.array(a.astype(np.float32), dtype=wp.vec3, device=device) for a in (starts, starts + LENGTH_M * way)]
    corner = wp.array([(-0.025 * SIDE, -0.025 * SIDE)], dtype=wp.vec2, device=device)
    cells, chosen = wp.array([(SIDE, SIDE)], dtype=wp.vec2i, device=device), wp.ones(1, dtype=int, device=device)
    away = wp.array([[(90.0, 90.0, 0.0)]], dtype=wp.vec3, device=device)
    fresh, again = [], []
    for _ in range(TRIALS):
        wp.launch(begin_map, 1, inputs=[ground, model, corner, cells, away, 0.0, chosen], device=device)
        for times in (fresh, again):
            started = time.thread_time()
            wp.launch(enter, 1, inputs=[ground, model, *rays], device=device)
            times.append(time.thread_time() - started)
    row = {"rays_per_s_fresh": RAYS / statistics.median(fresh), "rays_per_s_again": RAYS / statistics.median(again)}
    touched = int(np.count_nonzero(ground.volume.numpy()))
    print(f"rays of {LENGTH_M} m a second and core: {row['rays_per_s_fresh']:,.0f} into an empty map, ", end="")
    print(f"{row['rays_per_s_again']:,.0f} once more; {touched} cells touched")
    if options.out:
        options.out.write_text(json.dumps(row, indent=2) + "\n")


if __name__ == "__main__":
    main()

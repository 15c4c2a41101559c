"""What a team's scans were worth: points against the true surface, volume against truth, and h_v."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from coop_envs.batch import TeamBatch
from coop_envs.mapping.block_map import BlockMap
from coop_envs.mapping.ground_map import VOLUME, GroundMap, MapModel, evidence_at
from coop_envs.mapping.information import cell_information_ubit, held_ubit, information_bits
from coop_envs.point_accuracy import surface_distance_m
from coop_envs.recording.scan import Scan
from coop_envs.simulation.state import State
from coop_envs.truth_lookup import Truth, solid_at, truth_cell

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


def scan_metrics(batch: TeamBatch, b: int, scan: Scan) -> dict[str, Any]:
    """How many points team b measured and how far they lie from the surface, and what their rays tell of the volume.

    ``h_v`` and ``survey_bits`` come from all rays in a sparse map that lies in the world, at all heights for which
    truth is known; ``volume_bits`` from the team's own map, to which bodies add.
    """
    w = int(batch.state.world.numpy()[b])
    distance = surface_distance_m(batch.pool.worlds[w], scan.points_m)
    median, most = (float(np.quantile(distance, q)) for q in (0.5, 0.95)) if len(distance) else (None, None)
    survey = BlockMap(batch.map_model.cell, batch.map_model.sweep)
    survey.enter(scan.point_eyes_m.reshape(-1, 3), np.repeat(scan.points_m, 2, axis=0))
    known = survey.known()
    truth = batch.pool.solids[w]
    told = known.middles_m[:, 2] + 0.5 * known.cell_m <= truth.top_m
    solid = truth.holds(known.middles_m[told], known.cell_m)
    return {
        "points_measured": len(scan),
        "point_error_m": median,
        "point_error_95_m": most,
        "h_v": survey.h_v,
        "survey_bits": information_bits(known.log_odds[told], solid),
    }


@wp.kernel
def sum_volume(
    state: State, ground: GroundMap, truth: Truth, model: MapModel, table: wp.array[int], b: int,
    total: wp.array[wp.int64],
):  # fmt: skip
    """Micro-bits held by a team's volume; one thread a cell of the plan."""
    cell = wp.tid()
    w = state.world[b]
    frame = state.frame[b]
    place = truth_cell(truth, w, frame, ground, model, b, cell)
    held = int(0)
    for level in range(model.levels):
        evidence = evidence_at(ground, b, VOLUME + level, cell)
        if evidence != 0:
            held = held + held_ubit(table, evidence, solid_at(truth, w, frame, model, place, level))
    if held != 0:
        wp.atomic_add(total, 0, wp.int64(held))


def volume_bits(batch: TeamBatch, b: int) -> float:
    """The part of the information that the volume holds."""
    total = wp.zeros(1, dtype=wp.int64, device=batch.device)
    table = wp.array(cell_information_ubit(), dtype=int, device=batch.device)
    inputs = [batch.state, batch.map, batch.truth, batch.map_model, table, b, total]
    wp.launch(sum_volume, batch.map_model.nx * batch.map_model.ny, inputs=inputs, device=batch.device)
    return float(total.numpy()[0]) * 1e-6

"""An episode in numbers, from truth and belief; the keys of an evaluation's results."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.batch import TeamBatch
from coop_envs.estimation.belief import Declared
from coop_envs.mapping.ground_map import GROUND, VOLUME, GroundMap, MapModel, evidence_at
from coop_envs.mapping.information import cell_information_ubit, held_ubit
from coop_envs.point_accuracy import surface_distance_m
from coop_envs.scoring import MAPPED, Truth, solid_at, truth_cell
from coop_envs.simulation.state import State, Status
from coop_envs.worlds.world import Hazard, World

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

LEAST_PATH_M, AT_EDGE_M = 0.1, 0.005


def episode_metrics(batch: TeamBatch, b: int, points_m: NDArray[np.float64] | None = None) -> dict[str, Any]:
    """Metrics of team b's episode so far: SI units, drift of the first observer, counts from truth.

    ``points_m`` (k, 3) are all points that the team measured, in the world, if somebody kept them. Drift is put to the
    path only where the observer went somewhere. ``nees`` is the mean over robots and decisions of the squared
    Mahalanobis distance of believed poses over its six degrees of freedom: 1 expected.
    """
    team, world = batch.scenario.team, batch.pool.worlds[int(batch.state.world.numpy()[b])]
    status, declared = batch.state.status.numpy()[b], batch.belief.declared.numpy()[b]
    score = batch.score
    energy_j, action_j = float(score.energy.numpy()[b]), float(score.action_energy.numpy()[b])
    bits = float(score.information.numpy()[b]) * 1e-6
    drift_m, heading_rad = observer_drift(batch, b)
    path_m = float(batch.state.path.numpy()[b, 0])
    picket = np.array([member.role == "picket" for member in team.members])
    lost = status > Status.ACTIVE
    reach_m = np.array([member.robot.contact_radius_m for member in team.members]) + AT_EDGE_M
    ends = batch.state.position.numpy()[b, :, :2].astype(float)
    found = lost & (declared == Declared.LOST)
    visited = visited_hazards(world, ends[lost], reach_m[lost])
    return {
        "coverage": float(score.mapped.numpy()[b]) / max(int(score.reachable.numpy()[b]), 1),
        "mapped_m2": float(score.mapped.numpy()[b]) * batch.map_model.cell**2,
        "information_bits": bits,
        "volume_bits": volume_bits(batch, b) if batch.map_model.levels else None,
        "energy_j": energy_j,
        "action_energy_j": action_j,
        "bits_per_joule": bits / energy_j if energy_j > 0 else 0.0,
        "bits_per_action_joule": bits / action_j if action_j > 0 else 0.0,
        "hazards_found": len(visited_hazards(world, ends[found], reach_m[found])),
        "pickets_lost": int(np.sum(lost & picket)),
        "losses_declared": int(np.sum(declared == Declared.LOST)),
        "losses_declared_rightly": int(np.sum((declared == Declared.LOST) & lost)),
        "losses_in_truth": int(np.sum(lost)),
        "observer_survived": not bool(np.any(lost & ~picket)),
        "position_drift_m": drift_m,
        "heading_drift_deg": float(np.degrees(heading_rad)),
        "drift_percent_of_path": 100.0 * drift_m / path_m if path_m >= LEAST_PATH_M else None,
        "nees": float(score.nees_sum.numpy()[b]) / max(int(score.nees_count.numpy()[b]), 1) / 6.0,
        "false_safe_cells": false_safe_cells(batch, b, [world.hazards[k] for k in visited]),
        "path_m": path_m,
        "simulated_s": float(batch.state.tick.numpy()[b]) * batch.scenario.rates.tick_s,
        "success": bool(score.success.numpy()[b]) and not bool(np.any(lost & ~picket)),
        **({} if points_m is None else point_metrics(world, points_m)),
    }


def point_metrics(world: World, points_m: NDArray[np.float64]) -> dict[str, Any]:
    """How many points (k, 3) were measured, and the median and 95th percentile of their distances to the surface."""
    distance = surface_distance_m(world, points_m)
    median, most = (float(np.quantile(distance, q)) for q in (0.5, 0.95)) if len(distance) else (None, None)
    return {"points_measured": len(points_m), "point_error_m": median, "point_error_95_m": most}


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


def observer_drift(batch: TeamBatch, b: int) -> tuple[float, float]:
    """How far the first observer's believed pose is from the truth: metres, and radians of heading."""
    x, y, z, yaw = batch.state.frame.numpy()[b].astype(float)
    dx, dy, dz = batch.state.position.numpy()[b, 0].astype(float) - (x, y, z)
    c, s = np.cos(yaw), np.sin(yaw)
    true = np.array([c * dx + s * dy, c * dy - s * dx, dz])
    R = batch.belief.rotation.numpy()[b, 0]
    turn = float(batch.state.yaw.numpy()[b, 0]) - yaw - np.arctan2(R[1, 0], R[0, 0])
    drift = float(np.linalg.norm(true - batch.belief.position.numpy()[b, 0]))
    return drift, abs(float(np.arctan2(np.sin(turn), np.cos(turn))))


def visited_hazards(world: World, lost_xy_m: NDArray[np.float64], reach_m: NDArray[np.float64]) -> list[int]:
    """Which traps and holes have robots lost at these points (k, 2) in reach (k,)."""
    traps = [k for k, hazard in enumerate(world.hazards) if hazard.kind != "slippery"]
    return [k for k in traps if np.any(world.hazards[k].signed_distance_m(lost_xy_m) <= reach_m)]


def false_safe_cells(batch: TeamBatch, b: int, hazards: list[Hazard]) -> int:
    """Cells that the map calls safe though their centre lies in one of these hazards."""
    model = batch.map_model
    cells = np.flatnonzero(batch.map.log_odds.numpy()[b, int(GROUND)] >= int(MAPPED))
    corner = batch.map.corner.numpy()[b].astype(float)
    local = corner + (np.stack(np.divmod(cells, model.ny), axis=-1) + 0.5) * model.cell
    x, y, _, yaw = batch.state.frame.numpy()[b].astype(float)
    c, s = np.cos(yaw), np.sin(yaw)
    xy = np.stack([x + c * local[:, 0] - s * local[:, 1], y + s * local[:, 0] + c * local[:, 1]], axis=-1)
    inside = np.zeros(len(xy), dtype=bool)
    for hazard in hazards:
        inside |= hazard.signed_distance_m(xy) < 0.0
    return int(inside.sum())

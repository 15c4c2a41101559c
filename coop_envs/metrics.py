"""An episode in numbers, from truth and belief; the keys of an evaluation's results."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.batch import TeamBatch
from coop_envs.estimation.belief import Declared
from coop_envs.mapping.ground_map import GROUND
from coop_envs.recording.scan import Scan
from coop_envs.scan_metrics import scan_metrics, volume_bits
from coop_envs.scoring import MAPPED
from coop_envs.simulation.state import Status
from coop_envs.worlds.world import Hazard, World

LEAST_PATH_M, AT_EDGE_M = 0.1, 0.005


def episode_metrics(batch: TeamBatch, b: int, scan: Scan | None = None) -> dict[str, Any]:
    """Metrics of team b's episode so far: SI units, drift of the first observer, counts from truth.

    ``scan`` holds all points that the team measured, if somebody kept them. Drift is put to the path only where the
    observer went somewhere. ``nees`` is the mean over robots and decisions of the squared Mahalanobis distance of
    believed poses over its six degrees of freedom: 1 expected.
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
        **({} if scan is None else scan_metrics(batch, b, scan)),
    }


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

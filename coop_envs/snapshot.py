"""One instant of a team's episode as a `Frame`, for the viewer and the log."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.specification import Camera
from coop_envs.batch import TeamBatch
from coop_envs.mapping.ground_map import GROUND, LOG_ODDS_SCALE, OBSTACLE
from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.worlds.world import World


def world_picture(world: World) -> WorldPicture:
    """What is drawn of a world."""
    ground = world.ground
    return WorldPicture(
        heights=ground.heights_m,
        origin=ground.origin_m,
        cell=ground.cell_m,
        hazards=world.hazards,
        goal=world.goal,
        starts=world.starts,
        bounds=ground.bounds_m,
    )


def team_frame(batch: TeamBatch, b: int) -> Frame:
    """Truth and belief of team b now, in the world frame."""
    members = batch.scenario.team.members
    n = len(members)
    x, y, _, yaw = (float(v) for v in batch.state.frame.numpy()[b])
    R = batch.belief.rotation.numpy()[b]
    believed = batch.belief.position.numpy()[b, :, :2]
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    covariance = batch.belief.pose_covariance.numpy()[b, :, 3:5, 3:5]
    corner = turn @ batch.map.corner.numpy()[b].astype(float) + (x, y)
    score = batch.score
    return Frame(
        time_s=float(batch.state.tick.numpy()[b]) * batch.scenario.rates.tick_s,
        names=tuple(member.name for member in members),
        role=tuple(member.role for member in members),
        status=batch.state.status.numpy()[b],
        declared=batch.belief.declared.numpy()[b],
        true_xy_yaw=np.column_stack([batch.state.position.numpy()[b, :, :2], batch.state.yaw.numpy()[b]]),
        belief_xy_yaw=np.column_stack([believed @ turn.T + (x, y), np.arctan2(R[:, 1, 0], R[:, 0, 0]) + yaw]),
        belief_cov_xy=turn @ covariance @ turn.T,
        stationary=batch.belief.stationary.numpy()[b] == 1,
        collected=batch.state.collected.numpy()[b] == 1,
        fov_rad=np.array([horizontal_fov_rad(member.camera) for member in members]),
        range_m=np.array([member.camera.max_range_m if member.camera else 0.0 for member in members]),
        body_radius_m=np.array([member.robot.body_radius_m for member in members]),
        sees=batch.measurements.seen.numpy()[b].reshape(n, n) == 1,
        map_ground=_percentages(batch, b, int(GROUND)),
        map_obstacle=_percentages(batch, b, int(OBSTACLE)),
        T_world_map=np.array([corner[0], corner[1], yaw]),
        cell_m=batch.map_model.cell,
        energy_j=float(score.energy.numpy()[b]),
        action_energy_j=float(score.action_energy.numpy()[b]),
        information_bits=float(score.information.numpy()[b]) * 1e-6,
        coverage=float(score.mapped.numpy()[b]) / max(int(score.reachable.numpy()[b]), 1),
    )


def horizontal_fov_rad(camera: Camera | None) -> float:
    """Full horizontal field of view, 0 without a camera."""
    return 2.0 * math.atan(0.5 * camera.width_px / camera.fx_px) if camera else 0.0


def _percentages(batch: TeamBatch, b: int, layer: int) -> NDArray[np.uint8]:
    log_odds = batch.map.log_odds.numpy()[b, layer].astype(float)
    p = 1.0 / (1.0 + np.exp(-log_odds / LOG_ODDS_SCALE))
    return np.rint(255.0 * p).astype(np.uint8).reshape(batch.map_model.nx, batch.map_model.ny)

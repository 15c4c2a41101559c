"""One instant of a team's episode as a `Frame`, for the viewer and the log."""

from __future__ import annotations

import numpy as np

from coop_envs.batch import TeamBatch
from coop_envs.belief_picture import about_z, believed_scan, horizontal_fov_rad, map_chances
from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.recording.scan import Scan
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


def team_frame(batch: TeamBatch, b: int, volume: bool = False) -> Frame:
    """Truth and belief of team b now, in the world frame, with the points of its last decision.

    ``volume``: with the map of the volume, which takes longest.
    """
    members = batch.scenario.team.members
    n = len(members)
    x, y, z, yaw = (float(v) for v in batch.state.frame.numpy()[b])
    R = batch.belief.rotation.numpy()[b]
    believed = batch.belief.position.numpy()[b, :, :2]
    turn = about_z(yaw)[:2, :2]
    covariance = batch.belief.pose_covariance.numpy()[b, :, 3:5, 3:5]
    corner = turn @ batch.map.corner.numpy()[b].astype(float) + (x, y)
    score, model = batch.score, batch.map_model
    cells = model.nx, model.ny
    scan = team_scan(batch, b)
    ground, obstacle = map_chances(batch.map.log_odds.numpy()[b], cells)
    levels = batch.map.volume.numpy()[b].T if volume else np.empty((0, 0), dtype=np.int8)
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
        scanning=batch.command.scan_progress.numpy()[b] > 0.0,
        points_m=scan.points_m,
        point_sigma_m=scan.point_sigma_m,
        point_robots=scan.point_robots,
        point_eyes_m=scan.point_eyes_m,
        map_ground=ground,
        map_obstacle=obstacle,
        map_volume=map_chances(levels, cells),
        T_world_map=np.array([corner[0], corner[1], yaw]),
        cell_m=model.cell,
        volume_floor_m=z + model.floor,
        energy_j=float(score.energy.numpy()[b]),
        action_energy_j=float(score.action_energy.numpy()[b]),
        information_bits=float(score.information.numpy()[b]) * 1e-6,
        coverage=float(score.mapped.numpy()[b]) / max(int(score.reachable.numpy()[b]), 1),
    )


def team_scan(batch: TeamBatch, b: int) -> Scan:
    """The points that team b measured in its last decision."""
    x, y, z, yaw = (float(v) for v in batch.state.frame.numpy()[b])
    return believed_scan(batch.loop, batch.command, batch.scenario.team, b, (x, y, z, yaw))

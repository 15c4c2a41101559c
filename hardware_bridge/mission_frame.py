"""What a mission looks like from the side, for logs and viewers: the belief alone, in the team frame."""

from __future__ import annotations

import math

import numpy as np

from coop_envs.belief_picture import believed_scan, horizontal_fov_rad, map_chances
from coop_envs.recording.frame import Frame, WorldPicture
from hardware_bridge.mission import Mission

NOBODY_KNOWS = math.nan


def mission_frame(mission: Mission, time_s: float) -> Frame:
    """The belief now; truth, energy, information and coverage are NaN, for nobody knows them of real robots."""
    members, belief, model = mission.deployment.team.members, mission.belief, mission.loop.map_model
    n, R = len(members), belief.rotation.numpy()[0]
    ground, obstacle = map_chances(mission.loop.map.log_odds.numpy()[0], (model.nx, model.ny))
    scan = believed_scan(mission.loop, mission.command, mission.deployment.team)
    declared = belief.declared.numpy()[0]
    corner = mission.loop.map.corner.numpy()[0]
    return Frame(
        time_s=time_s,
        names=mission.names,
        role=tuple(member.role for member in members),
        status=declared,
        declared=declared,
        true_xy_yaw=np.full((n, 3), NOBODY_KNOWS),
        belief_xy_yaw=np.column_stack([belief.position.numpy()[0, :, :2], np.arctan2(R[:, 1, 0], R[:, 0, 0])]),
        belief_cov_xy=belief.pose_covariance.numpy()[0, :, 3:5, 3:5],
        stationary=belief.stationary.numpy()[0] == 1,
        collected=np.zeros(n, dtype=bool),
        fov_rad=np.array([horizontal_fov_rad(member.camera) for member in members]),
        range_m=np.array([member.camera.max_range_m if member.camera else 0.0 for member in members]),
        body_radius_m=np.array([member.robot.body_radius_m for member in members]),
        sees=belief.seen.numpy()[0] == 1,
        scanning=mission.command.scan_progress.numpy()[0] > 0.0,
        points_m=scan.points_m,
        point_sigma_m=scan.point_sigma_m,
        point_robots=scan.point_robots,
        point_eyes_m=scan.point_eyes_m,
        map_ground=ground,
        map_obstacle=obstacle,
        map_volume=np.empty((0, model.nx, model.ny), dtype=np.uint8),
        T_world_map=np.array([corner[0], corner[1], 0.0]),
        cell_m=model.cell,
        volume_floor_m=model.floor,
        energy_j=NOBODY_KNOWS,
        action_energy_j=NOBODY_KNOWS,
        information_bits=NOBODY_KNOWS,
        coverage=NOBODY_KNOWS,
    )


def mission_world(mission: Mission) -> WorldPicture:
    """Nothing but the box of the map, where the robots start, and the goal."""
    site = mission.deployment.site
    assert site is not None
    (x, y), (width, length) = site.map_corner_m, site.map_size_m
    bounds = (x, y, x + width, y + length)
    nothing = np.zeros((2, 2), dtype=np.float32)
    return WorldPicture(nothing, (x, y), max(width, length), (), site.goal, site.start, bounds)

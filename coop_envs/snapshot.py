"""One instant of a team's episode as a `Frame`, for the viewer and the log."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.specification import Camera
from coop_envs.batch import TeamBatch
from coop_envs.mapping.ground_map import LOG_ODDS_SCALE
from coop_envs.recording.frame import Frame, WorldPicture
from coop_envs.recording.scan import NO_SCAN, Scan
from coop_envs.sensing.triangulation import OK
from coop_envs.worlds.world import World

CHANCES = np.rint(255.0 / (1.0 + np.exp(-np.arange(256, dtype=np.uint8).view(np.int8) / LOG_ODDS_SCALE)))
CHANCE_BYTES = CHANCES.astype(np.uint8).tobytes()
"""255 P of each byte that a log-odds in sixteenths may be."""


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
    turn = _turn(yaw)[:2, :2]
    covariance = batch.belief.pose_covariance.numpy()[b, :, 3:5, 3:5]
    corner = turn @ batch.map.corner.numpy()[b].astype(float) + (x, y)
    score, model = batch.score, batch.map_model
    scan = team_scan(batch, b)
    ground, obstacle = _chances(batch.map.log_odds.numpy()[b], batch)
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
        map_volume=_chances(levels, batch),
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
    points = batch.loop.points
    if points.count.numpy()[b] == 0:
        return NO_SCAN
    found = points.answer.numpy()[b] == int(OK)
    x, y, z, yaw = (float(v) for v in batch.state.frame.numpy()[b])
    variance = np.trace(points.covariance.numpy()[b, found].astype(float), axis1=1, axis2=2)
    cameras = points.cameras.numpy()[b, found]
    R, p = batch.belief.rotation.numpy()[b, cameras], batch.belief.position.numpy()[b, cameras]
    mounted = np.array([m.camera.position_m if m.camera else (0.0, 0.0, 0.0) for m in batch.scenario.team.members])
    eyes = p + np.einsum("keij,kej->kei", R, mounted[cameras])
    lit = batch.command.laser.numpy()[b][:, found] > 0.0
    laser = np.where(lit.any(axis=0), lit.argmax(axis=0), -1)
    return Scan(
        points_m=points.position.numpy()[b, found].astype(float) @ _turn(yaw).T + (x, y, z),
        point_sigma_m=np.sqrt(variance),
        point_robots=np.column_stack([laser, cameras]).astype(np.int16),
        point_eyes_m=eyes @ _turn(yaw).T + (x, y, z),
    )


def horizontal_fov_rad(camera: Camera | None) -> float:
    """Full horizontal field of view, 0 without a camera."""
    return 2.0 * math.atan(0.5 * camera.width_px / camera.fx_px) if camera else 0.0


def _turn(yaw: float) -> NDArray[np.float64]:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _chances(log_odds: NDArray[np.int8], batch: TeamBatch) -> NDArray[np.uint8]:
    """255 P of layers (k, C) of the map, as (k, nx, ny); of a map without cells (0, nx, ny)."""
    cells = batch.map_model.nx, batch.map_model.ny
    chances = np.frombuffer(log_odds.tobytes().translate(CHANCE_BYTES), dtype=np.uint8)
    return chances.reshape(log_odds.size // (cells[0] * cells[1]), *cells)

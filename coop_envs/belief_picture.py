"""What a belief looks like from the side: its map as chances, the points of its last decision."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.command import Command
from coop_envs.agents.specification import Camera
from coop_envs.agents.team import Team
from coop_envs.belief_loop import BeliefLoop
from coop_envs.mapping.ground_map import LOG_ODDS_SCALE
from coop_envs.recording.scan import NO_SCAN, Scan
from coop_envs.sensing.triangulation import OK

CHANCES = np.rint(255.0 / (1.0 + np.exp(-np.arange(256, dtype=np.uint8).view(np.int8) / LOG_ODDS_SCALE)))
CHANCE_BYTES = CHANCES.astype(np.uint8).tobytes()
"""255 P of each byte that a log-odds in sixteenths may be."""

AT_ORIGIN = (0.0, 0.0, 0.0, 0.0)


def believed_scan(
    loop: BeliefLoop, command: Command, team: Team, b: int = 0, frame: tuple[float, float, float, float] = AT_ORIGIN
) -> Scan:
    """The points that team b measured in its last decision; ``frame`` is the team's in the world: x, y, z, yaw."""
    points, belief = loop.points, loop.belief
    if points.count.numpy()[b] == 0:
        return NO_SCAN
    found = points.answer.numpy()[b] == int(OK)
    x, y, z, yaw = frame
    variance = np.trace(points.covariance.numpy()[b, found].astype(float), axis1=1, axis2=2)
    cameras = points.cameras.numpy()[b, found]
    R, p = belief.rotation.numpy()[b, cameras], belief.position.numpy()[b, cameras]
    mounted = np.array([m.camera.position_m if m.camera else (0.0, 0.0, 0.0) for m in team.members])
    eyes = p + np.einsum("keij,kej->kei", R, mounted[cameras])
    lit = command.laser.numpy()[b][:, found] > 0.0
    laser = np.where(lit.any(axis=0), lit.argmax(axis=0), -1)
    return Scan(
        points_m=points.position.numpy()[b, found].astype(float) @ about_z(yaw).T + (x, y, z),
        point_sigma_m=np.sqrt(variance),
        point_robots=np.column_stack([laser, cameras]).astype(np.int16),
        point_eyes_m=eyes @ about_z(yaw).T + (x, y, z),
    )


def map_chances(log_odds: NDArray[np.int8], cells: tuple[int, int]) -> NDArray[np.uint8]:
    """255 P of layers (k, C) of a map, as (k, nx, ny); of a map without cells (0, nx, ny)."""
    chances = np.frombuffer(log_odds.tobytes().translate(CHANCE_BYTES), dtype=np.uint8)
    return chances.reshape(log_odds.size // (cells[0] * cells[1]), *cells)


def horizontal_fov_rad(camera: Camera | None) -> float:
    """Full horizontal field of view, 0 without a camera."""
    return 2.0 * math.atan(0.5 * camera.width_px / camera.fx_px) if camera else 0.0


def about_z(yaw: float) -> NDArray[np.float64]:
    """Rotation by a heading."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

"""Before anything moves: do the cameras see the hats where people say they set the robots down?

A camera's lens or mounting, a hat's LEDs, or a start that is not as written all show here, as they would in every pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import ConfigError
from coop_envs.sensing.camera import body_from_camera
from coop_envs.sensing.measurements import allocate_measurements
from hardware_bridge.deployment import Deployment
from hardware_bridge.reading import CameraFrame
from hardware_bridge.seeing import PoseFinder

TOLERANCE_M, TOLERANCE_SHARE = 0.1, 0.1
"""How far from its place a hat may be seen, more for one that is far away."""
LEAST_SIGHTINGS = 3
DEVICE = "cpu"


def check_places(deployment: Deployment, frames: Mapping[str, Sequence[CameraFrame]]) -> list[str]:
    """Compare every camera's median sighting of every hat with the site; who was seen by whom, a line each.

    Raises:
        ConfigError: a robot that is seen somewhere else.
    """
    assert deployment.site is not None
    members, start = deployment.team.members, deployment.site.start
    told: list[str] = []
    for (i, j), seen in _sightings(deployment, frames).items():
        if len(seen) < LEAST_SIGHTINGS or members[j].reserve:
            continue
        place = _in_team(deployment, i, np.median(seen, axis=0))
        away_m = math.dist(place, start[j][:2])
        if away_m > TOLERANCE_M + TOLERANCE_SHARE * math.dist(start[i][:2], start[j][:2]):
            x, y = start[j][:2]
            raise ConfigError(
                f"site.start of {members[j].name}",
                f"({place[0]:.2f}, {place[1]:.2f}) m seen by {members[i].name}",
                f"about ({x:.2f}, {y:.2f}) m as the site says: check the start, the hat, the camera's calibration",
            )
        told.append(f"{members[i].name} sees {members[j].name} {100 * away_m:.1f} cm from where it was set down")
    return told


def _sightings(
    deployment: Deployment, frames: Mapping[str, Sequence[CameraFrame]]
) -> dict[tuple[int, int], list[NDArray[np.float64]]]:
    """Positions of hat j's robot in camera i, by (i, j), one for each frame that gave a pose."""
    team = deployment.team
    n = len(team.members)
    measurements = allocate_measurements(1, n, 1, DEVICE)
    finder = PoseFinder(team, deployment.seeing, measurements, DEVICE)
    seen, position = measurements.seen.numpy()[0], measurements.p_camera_body.numpy()[0]
    found: dict[tuple[int, int], list[NDArray[np.float64]]] = {}
    for k in range(max((len(own) for own in frames.values()), default=0)):
        of_all = [frames.get(member.name, ()) for member in team.members]
        finder.find([own[k] if k < len(own) else None for own in of_all], [1.0] * n)
        for i, j in np.argwhere(seen.reshape(n, n) == 1).tolist():
            found.setdefault((i, j), []).append(position.reshape(n, n, 3)[i, j].astype(float))
    return found


def _in_team(deployment: Deployment, robot: int, p_camera: NDArray[np.float64]) -> tuple[float, float]:
    """Where in the team frame a point lies that a robot's camera sees, with the robot level at its start."""
    assert deployment.site is not None
    camera = deployment.team.members[robot].camera
    assert camera is not None
    x, y, yaw = deployment.site.start[robot]
    p_body = body_from_camera(camera.pitch_down_rad) @ p_camera + np.asarray(camera.position_m)
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * p_body[0] - s * p_body[1], y + s * p_body[0] + c * p_body[1]

"""Robots enter the filter where they are seen, and are believed less while nobody hears of them.

All of it writes into the belief of one team, by views of its arrays, between two steps of the filter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.specification import RobotSpecification
from coop_envs.agents.team import Team
from coop_envs.estimation.belief import ERROR_STATES
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.localization.logs.events import PoseSighting
from coop_envs.localization.windows import Bridge
from coop_envs.sensing.camera import body_from_camera

Array = NDArray[np.float64]

ANYWHERE_M, ANYHOW_RAD = 10.0, 3.0
"""Standard deviations of a pose of which nothing is known."""
TIPPED_RAD_S = 0.2
"""How fast a robot that nobody hears may tip, up to ``ANYHOW_RAD``."""
RESTING_M_S = 1.0e-3


@dataclass(frozen=True, eq=False)
class Views:
    """NumPy views of the belief of one team of N robots: what is written here the filter sees."""

    position: Array
    velocity: Array
    rotation: Array
    covariance: Array
    slot: NDArray[np.int32]
    stationary: NDArray[np.int32]
    demoted: NDArray[np.int32]
    rest_s: NDArray[np.float32]
    seen: NDArray[np.int32]
    averaged: NDArray[np.int32]

    @classmethod
    def of(cls, team_filter: TeamFilter) -> Views:
        """The first team's belief; the filter runs on the CPU."""
        return cls(**{name: getattr(team_filter.belief, name).numpy()[0] for name in cls.__dataclass_fields__})

    def rows(self, robot: int) -> slice:
        """A robot's rows in the covariance."""
        first = ERROR_STATES * int(self.slot[robot])
        return slice(first, first + ERROR_STATES)

    def pose_covariance(self, robot: int) -> Array:
        """(6, 6) of a robot's errors (theta, p)."""
        first = ERROR_STATES * int(self.slot[robot])
        return self.covariance[first : first + 6, first : first + 6].copy()


def camera_mounts(team: Team) -> list[tuple[Array, Array] | None]:
    """R_body_camera and p_body_camera of each robot's camera."""
    cameras = [member.camera for member in team.members]
    return [c and (body_from_camera(c.pitch_down_rad), np.array(c.position_m)) for c in cameras]


def place_by_sighting(
    views: Views, sighting: PoseSighting, camera: int, robot: int, mount: tuple[Array, Array], known: int
) -> None:
    """Put the one of a sighting's two robots that is not ``known`` where the sighting says.

    Its pose's covariance is that of no knowledge: the filter is to fuse the sighting next, which gives the pose the
    sighting's and the known robot's covariance, and their correlation.
    """
    R_body_camera, p_body_camera = mount
    R_camera_robot = R_body_camera @ sighting.rotation
    p_camera_robot = R_body_camera @ sighting.position + p_body_camera
    if known == camera:
        placed, rotation = robot, views.rotation[camera] @ R_camera_robot
        position = views.position[camera] + views.rotation[camera] @ p_camera_robot
    else:
        placed, rotation = camera, views.rotation[robot] @ R_camera_robot.T
        position = views.position[robot] - rotation @ p_camera_robot
    views.position[placed], views.rotation[placed], views.velocity[placed] = position, rotation, 0.0


def forget_pose(views: Views, robot: int, speed_m_s: float, biases: tuple[float, float]) -> None:
    """Nothing is known of a robot's pose; it may go as fast as ``speed_m_s``; ``biases`` spread by (rad/s, m/s^2)."""
    rows = views.rows(robot)
    views.covariance[rows, :] = 0.0
    views.covariance[:, rows] = 0.0
    sigmas = np.repeat([ANYHOW_RAD, ANYWHERE_M, max(speed_m_s, RESTING_M_S), *biases], 3)
    np.fill_diagonal(views.covariance[rows, rows], sigmas**2)
    _unsettle(views, robot)


def adrift(views: Views, robot: int, model: RobotSpecification, before_s: float, window_s: float) -> None:
    """A window in which a robot was not heard: it may have gone anywhere, as fast as it can.

    ``before_s`` is since when nothing was heard and nobody saw it. Nothing is known of its velocity.
    """
    first = views.rows(robot).start
    grown_s2 = (before_s + window_s) ** 2 - before_s**2
    pose = np.array([TIPPED_RAD_S, TIPPED_RAD_S, model.max_yaw_rate_rad_s] + 3 * [model.max_speed_m_s]) ** 2 * grown_s2
    limit = np.repeat([ANYHOW_RAD, ANYWHERE_M], 3) ** 2
    diagonal = np.einsum("ii->i", views.covariance[first : first + 6, first : first + 6])
    diagonal += np.clip(limit - diagonal, 0.0, pose)
    velocity = slice(first + 6, first + 9)
    views.covariance[velocity, :] = 0.0
    views.covariance[:, velocity] = 0.0
    np.fill_diagonal(views.covariance[velocity, velocity], model.max_speed_m_s**2)
    views.velocity[robot] = 0.0
    _unsettle(views, robot)


def widen_for_bridge(views: Views, robot: int, bridge: Bridge) -> None:
    """What a bridge over missing samples leaves open adds to the errors of attitude and velocity."""
    diagonal = np.einsum("ii->i", views.covariance[views.rows(robot), views.rows(robot)])
    diagonal[0:3] += bridge.turn_variance
    diagonal[6:9] += bridge.speed_variance


def lost_sight_of(views: Views, robot: int, position_m: float, heading_rad: float) -> bool:
    """Whether a robot's pose is so uncertain that first-order updates no longer hold."""
    sigma = np.sqrt(np.diag(views.pose_covariance(robot)))
    return bool(math.hypot(*sigma[3:]) > position_m or np.max(sigma[:3]) > heading_rad)


def _unsettle(views: Views, robot: int) -> None:
    """What the filter remembers of a robot at rest no longer holds."""
    views.stationary[robot], views.rest_s[robot] = 0, 0.0
    views.averaged[robot, :] = views.averaged[:, robot] = 0

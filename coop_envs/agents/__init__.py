"""What the robots are: specifications, teams and the presets that come with the package."""

from coop_envs.agents.catalog import load_camera, load_hat, load_robot, load_team
from coop_envs.agents.specification import Battery, Camera, Hat, Imu, Laser, Led, PowerModel, RobotSpecification, Role
from coop_envs.agents.team import Member, Team

__all__ = [
    "Battery",
    "Camera",
    "Hat",
    "Imu",
    "Laser",
    "Led",
    "Member",
    "PowerModel",
    "RobotSpecification",
    "Role",
    "Team",
    "load_camera",
    "load_hat",
    "load_robot",
    "load_team",
]

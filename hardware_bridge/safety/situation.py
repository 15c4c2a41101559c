"""What the supervisor is told besides the commands, and what it answers when it changes one."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hardware_bridge.command import RobotCommand


@dataclass(frozen=True)
class RobotSituation:
    """One robot as the host believes it to be in this tick.

    ``position_m`` and ``yaw_rad`` are in the team frame, ``sigma_m`` is the position's standard deviation.
    ``sample_age_s`` counts from the robot's last report, ``pose_age_s`` from the last camera frame that it took or that
    could show it. ``battery`` is a share 0..1, None where the robot does not tell. ``stationary``: wheels and IMU say
    that it stands. ``at_work``: active, neither lost nor waiting in the dock; ``docked`` robots are out of the others'
    way, lost ones are obstacles. ``permitted``: the inchworm rule lets it move.
    """

    position_m: tuple[float, float]
    yaw_rad: float
    sigma_m: float = 0.0
    sample_age_s: float = 0.0
    pose_age_s: float = 0.0
    battery: float | None = None
    stationary: bool = False
    at_work: bool = True
    docked: bool = False
    permitted: bool = True

    @property
    def placed(self) -> bool:
        """Whether its pose is known at all."""
        return all(math.isfinite(value) for value in (*self.position_m, self.yaw_rad))


@dataclass(frozen=True)
class Situation:
    """Everything of one tick that is not a command of the policy.

    ``estop`` is the button as it is now; it latches in the supervisor until ``release_estop`` comes without it.
    ``policy_age_s`` counts from the policy's last decision. ``human`` holds what a person commands to each robot, None
    for those that the person does not drive, and is None as a whole where nobody sits at the controls; ``human_age_s``
    counts from the person's last sign of life. ``laser_allowed``: people have released the lasers.
    """

    robots: tuple[RobotSituation, ...]
    policy_age_s: float = 0.0
    estop: bool = False
    release_estop: bool = False
    human: tuple[RobotCommand | None, ...] | None = None
    human_age_s: float = math.inf
    laser_allowed: bool = True


@dataclass(frozen=True)
class Intervention:
    """A command that the supervisor changed, or a fault for which it holds a robot.

    ``again``: the same rule held the same robot in the tick before; logs for people leave such out.
    """

    time_s: float
    robot: str
    rule: str
    reason: str
    before: RobotCommand
    after: RobotCommand
    again: bool = False

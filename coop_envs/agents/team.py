"""Teams: which robots, and what each of them carries. Presets live in ``teams/*.yaml``."""

from __future__ import annotations

from dataclasses import dataclass

from coop_envs.agents.specification import Camera, Hat, Laser, RobotSpecification, Role
from coop_envs.errors import require
from coop_envs.validation import STRICT


@dataclass(frozen=True)
class Member:
    """One robot of a team: its type, its role, and the camera, hat and laser it carries (or none).

    ``cruise_speed_m_s`` and ``cruise_yaw_rate_rad_s`` are what an action of 1 asks for. A reserve waits in the dock
    until a loss is declared. ``cameras`` holds none or one. ``start`` (x_m, y_m, yaw_rad in the world) overrides where
    the world would place the robot.
    """

    __pydantic_config__ = STRICT
    name: str
    role: Role
    robot: RobotSpecification
    cameras: tuple[Camera, ...] = ()
    hat: Hat | None = None
    laser: Laser | None = None
    reserve: bool = False
    start: tuple[float, float, float] | None = None
    cruise_speed_m_s: float = 0.2
    cruise_yaw_rate_rad_s: float = 1.0

    def __post_init__(self) -> None:
        require(len(self.cameras) <= 1, f"team.{self.name}.cameras", len(self.cameras), "none or one camera")
        speed_fits = 0 < self.cruise_speed_m_s <= self.robot.max_speed_m_s
        limit = f"above 0, at most {self.robot.max_speed_m_s} m/s ({self.robot.name})"
        require(speed_fits, f"team.{self.name}.cruise_speed_m_s", self.cruise_speed_m_s, limit)
        yaw_fits = 0 < self.cruise_yaw_rate_rad_s <= self.robot.max_yaw_rate_rad_s
        limit = f"above 0, at most {self.robot.max_yaw_rate_rad_s} rad/s ({self.robot.name})"
        require(yaw_fits, f"team.{self.name}.cruise_yaw_rate_rad_s", self.cruise_yaw_rate_rad_s, limit)
        observer_stays = not (self.reserve and self.role == "observer")
        require(observer_stays, f"team.{self.name}.reserve", self.reserve, "false for an observer")

    @property
    def camera(self) -> Camera | None:
        return self.cameras[0] if self.cameras else None


@dataclass(frozen=True)
class Team:
    """An ordered team; ``members[i]`` is agent ``observer_k`` or ``picket_k`` by its role, observers first."""

    __pydantic_config__ = STRICT
    name: str
    members: tuple[Member, ...]

    def __post_init__(self) -> None:
        names = [m.name for m in self.members]
        require(bool(names), "team.members", names, "at least one robot")
        require(self.members[0].role == "observer", "team.members[0].role", names[:1], "an observer first")
        cameras = [m.name for m in self.members if m.cameras]
        require(bool(cameras), "team.members.cameras", names, "at least one robot with a camera")
        sees = self.members[0].camera is not None
        require(sees, "team.members[0].cameras", names[0], "a camera on the first observer")
        expected = [f"{m.role}_{[o.role for o in self.members[:i]].count(m.role)}" for i, m in enumerate(self.members)]
        require(names == expected, "team.members.name", names, f"{expected}")
        order = [m.role for m in self.members]
        require(order == sorted(order), "team.members.role", order, "observers before pickets")

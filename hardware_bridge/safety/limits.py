"""`SafetyLimits`: the supervisor's settings."""

from __future__ import annotations

from dataclasses import dataclass

from coop_envs.errors import require
from coop_envs.validation import STRICT
from hardware_bridge.safety.polygon import Polygon, encloses, rectangle


@dataclass(frozen=True)
class SafetyLimits:
    """What the supervisor holds robots to. None switches a rule off; the e-stop and the deadman have no switch.

    Silence: a robot stands when the policy, the person who drives it, the robot itself, or the cameras that know its
    place have been silent for longer than ``deadman_s``, ``human_timeout_s``, ``max_sample_age_s``, ``max_pose_age_s``,
    or when the standard deviation of its position exceeds ``max_sigma_m``. With a tick of 1/30 s these stand it within
    0.5 s. (ros2_control and twist_mux wait 0.5 s, PX4 leaves offboard below 2 Hz.)

    Geofence: (x_min, y_min, x_max, y_max) or the corners of a polygon, metres in the team frame. A robot's body, plus
    ``geofence_margin_m``, stays inside for the next ``look_ahead_s`` of what it is told.

    Barrier: the bodies of two robots keep ``barrier_margin_m`` apart; they close the gap the more slowly the later they
    react: ``reaction_s`` from a motion to the command that answers it, and the lag of the drive. ``projection_m`` is
    the point ahead of the axle that the barrier steers (as far as in the Robotarium). Geofence and barrier add
    ``sigmas`` standard deviations of the positions, at most ``most_sigma_margin_m``: teammates share most of the drift
    of the team's frame.

    Speeds: at most these, and at most what the robot's specification allows. ``max_accel_m_s2`` limits how fast the rim
    of a wheel may gain speed; to lose speed never waits. A robot stands below ``battery_floor`` until it is back above
    the floor by ``battery_hysteresis``. A laser stays lit for at most ``laser_max_on_s`` at a stretch, and on average
    for that much of every ``laser_period_s``.
    """

    __pydantic_config__ = STRICT
    deadman_s: float = 0.4
    human_timeout_s: float = 0.4
    max_sample_age_s: float = 0.25
    max_pose_age_s: float | None = 0.4
    max_sigma_m: float | None = 0.5
    geofence: tuple[float, float, float, float] | tuple[tuple[float, float], ...] | None = None
    geofence_margin_m: float = 0.05
    look_ahead_s: float = 0.6
    inchworm: bool = True
    barrier: bool = True
    barrier_margin_m: float = 0.02
    reaction_s: float = 0.1
    projection_m: float = 0.03
    sigmas: float = 1.0
    most_sigma_margin_m: float = 0.1
    max_speed_m_s: float = 0.5
    max_yaw_rate_rad_s: float = 3.0
    max_accel_m_s2: float | None = 4.0
    battery_floor: float | None = 0.1
    battery_hysteresis: float = 0.05
    max_galvo_counts: int = 200
    laser_max_on_s: float | None = None
    laser_period_s: float = 60.0

    def __post_init__(self) -> None:
        above_zero = "deadman_s human_timeout_s max_sample_age_s max_pose_age_s max_sigma_m look_ahead_s reaction_s"
        above_zero += " projection_m max_speed_m_s max_yaw_rate_rad_s max_accel_m_s2 laser_max_on_s laser_period_s"
        for name in above_zero.split():
            value = getattr(self, name)
            require(value is None or value > 0, f"safety.{name}", value, "more than 0")
        for name in ["geofence_margin_m", "barrier_margin_m", "sigmas", "most_sigma_margin_m", "max_galvo_counts"]:
            require(getattr(self, name) >= 0, f"safety.{name}", getattr(self, name), "0 or more")
        floor, rise = self.battery_floor, self.battery_hysteresis
        require(floor is None or 0 <= floor < 1, "safety.battery_floor", floor, "0 up to 1")
        require(0 <= rise <= 1 - (floor or 0.0), "safety.battery_hysteresis", rise, "0 or more, floor and it at most 1")
        lit, period = self.laser_max_on_s, self.laser_period_s
        require(lit is None or lit < period, "safety.laser_max_on_s", lit, f"less than laser_period_s ({period})")
        corners = self.corners
        expected = "x_min < x_max and y_min < y_max, or 3 or more corners whose sides do not cross"
        require(corners is None or encloses(corners), "safety.geofence", self.geofence, expected)

    @property
    def corners(self) -> Polygon | None:
        """The geofence as a polygon."""
        fence = self.geofence
        if fence is None:
            return None
        sides = [side for side in fence if isinstance(side, int | float)]
        if len(sides) == 4:
            return rectangle(*sides)
        return tuple(corner for corner in fence if isinstance(corner, tuple))

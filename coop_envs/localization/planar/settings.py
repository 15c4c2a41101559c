"""How planar robots err: odometry, where people set them down, what is taken for an outlier."""

from __future__ import annotations

from dataclasses import dataclass

from coop_envs.errors import require
from coop_envs.validation import STRICT


@dataclass(frozen=True)
class PlanarSettings:
    """Settings of the planar team filter.

    Odometry's error is a random walk along the way, so that it does not depend on how often odometry comes:
    ``forward_m_rtm`` and ``sideways_m_rtm`` per root metre driven, ``yaw_rad_rtm`` per root metre and
    ``yaw_rad_rtrad`` per root radian turned, ``turn_m_rtrad`` of the place per root radian turned. ``start_*`` are how
    exactly people set robots down. A sighting beyond the gate, of which ``gate_share`` of the right ones pass, is left
    out; ``refusals`` of a robot's in a row, or more among others that pass, widen its pose by ``doubt_*``.

    Odometry that fails to come for ``gap_s`` (and five times its usual interval) tells nothing any more: the robot may
    then be on its way at up to ``unheard_*``, and after ``leave_s`` it is taken out. Sightings between teams that do
    not know each other's frames are kept for ``meet_s``. Windows are at most ``longest_s`` long, events that are older
    than ``horizon_s`` when they come are dropped, paths are noted every ``record_s``.
    """

    __pydantic_config__ = STRICT
    forward_m_rtm: float = 0.03
    sideways_m_rtm: float = 0.01
    yaw_rad_rtm: float = 0.05
    yaw_rad_rtrad: float = 0.05
    turn_m_rtrad: float = 0.005
    start_position_m: float = 0.005
    start_yaw_rad: float = 0.03
    gate_share: float = 0.999
    refusals: float = 5.0
    doubt_m: float = 0.5
    doubt_rad: float = 0.5
    gap_s: float = 0.5
    unheard_m_s: float = 0.3
    unheard_rad_s: float = 0.5
    leave_s: float = 10.0
    meet_s: float = 5.0
    longest_s: float = 0.1
    horizon_s: float = 2.0
    record_s: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(value >= 0, f"planar.{name}", value, "0 or more")
        require(0.5 <= self.gate_share < 1.0, "planar.gate_share", self.gate_share, "0.5 or more, below 1")
        require(self.longest_s > 0, "planar.longest_s", self.longest_s, "more than 0 s")
        require(self.horizon_s > 0, "planar.horizon_s", self.horizon_s, "more than 0 s")
        require(self.refusals >= 1, "planar.refusals", self.refusals, "1 or more")

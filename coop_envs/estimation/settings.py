"""Settings of a team's belief, the same for simulation and for robots; part of a scenario."""

from __future__ import annotations

from dataclasses import dataclass

from coop_envs.errors import require
from coop_envs.validation import STRICT


@dataclass(frozen=True)
class Rates:
    """Ticks of camera, IMU and filter; physics substeps a tick; ticks a decision."""

    __pydantic_config__ = STRICT
    tick_s: float = 1.0 / 30.0
    substeps: int = 4
    ticks_per_decision: int = 6

    def __post_init__(self) -> None:
        require(0 < self.tick_s <= 0.2, "rates.tick_s", self.tick_s, "above 0, at most 0.2 s")
        require(1 <= self.substeps <= 64, "rates.substeps", self.substeps, "1 to 64")
        require(1 <= self.ticks_per_decision <= 60, "rates.ticks_per_decision", self.ticks_per_decision, "1 to 60")

    @property
    def decision_s(self) -> float:
        return self.tick_s * self.ticks_per_decision


@dataclass(frozen=True)
class Estimation:
    """Settings of the team filter and of what it declares (stationary, stuck, lost).

    ``start_*`` say how exactly people set robots down and how level the ground is there: standard deviations, which the
    filter starts from; within ``start_ground_m`` of there they have seen the ground carry a robot. ``slip_*`` are the
    random walk of a robot at rest.
    """

    __pydantic_config__ = STRICT
    rest_s: float = 0.3
    slip_position_m_rts: float = 2.0e-4
    slip_heading_rad_rts: float = 2.0e-4
    odometry_noise_scale: float = 1.2
    stuck_s: float = 3.0
    silent_s: float = 3.0
    hazard_mark_m: float = 0.10
    start_position_m: float = 0.01
    start_height_m: float = 0.02
    start_yaw_rad: float = 0.06
    start_tilt_rad: float = 0.05
    start_ground_m: float = 0.10

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(value >= 0, f"estimation.{name}", value, "0 or more")


@dataclass(frozen=True)
class MapSettings:
    """The belief's grid and the window of it that a policy sees."""

    __pydantic_config__ = STRICT
    cell_m: float = 0.05
    ego_stride: int = 1

    def __post_init__(self) -> None:
        require(0.01 <= self.cell_m <= 0.5, "map.cell_m", self.cell_m, "0.01 to 0.5 m")
        require(1 <= self.ego_stride <= 16, "map.ego_stride", self.ego_stride, "1 to 16 cells")

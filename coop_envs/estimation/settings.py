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
    random walk of a robot at rest. Without ``wheels`` the filter does not listen to wheel odometry.

    Standard deviations by which calibrations may be off, each constant: ``focal_sigma`` (relative) and
    ``centre_sigma_px`` of a camera's lens, ``lever_sigma_m`` and ``lever_sigma_rad`` of its place in the body,
    ``hat_sigma_m`` of each LED's place along each axis. What is above 0 the filter estimates. ``camera_shake_rad`` is
    how much a camera's axes shake, each, while its robot moves. A scanned point that is less certain than
    ``point_sigma_m`` is not used.
    """

    __pydantic_config__ = STRICT
    rest_s: float = 0.3
    slip_position_m_rts: float = 2.0e-5
    slip_heading_rad_rts: float = 2.0e-5
    odometry_noise_scale: float = 1.2
    stuck_s: float = 3.0
    silent_s: float = 3.0
    hazard_mark_m: float = 0.10
    start_position_m: float = 0.005
    start_height_m: float = 0.02
    start_yaw_rad: float = 0.03
    start_tilt_rad: float = 0.05
    start_ground_m: float = 0.10
    wheels: bool = True
    focal_sigma: float = 0.0
    centre_sigma_px: float = 0.0
    lever_sigma_m: float = 0.0
    lever_sigma_rad: float = 0.0
    hat_sigma_m: float = 0.0
    camera_shake_rad: float = 0.0
    point_sigma_m: float = 0.08

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(value >= 0, f"estimation.{name}", value, "0 or more")

    @property
    def calibrates_cameras(self) -> bool:
        return max(self.focal_sigma, self.centre_sigma_px, self.lever_sigma_m, self.lever_sigma_rad) > 0


@dataclass(frozen=True)
class MapSettings:
    """The belief's grid and the window of it that a policy sees.

    Teams with lasers hold ``levels`` of cells above each other from ``floor_m`` in the team frame on (the first
    observer's body at its start has height 0). Ground that rises by ``step_levels`` from a cell to the next can still
    be driven. A scan ray sweeps free what is within ``sweep_radius_m``.
    """

    __pydantic_config__ = STRICT
    cell_m: float = 0.05
    ego_stride: int = 1
    levels: int = 4
    floor_m: float = -0.075
    step_levels: int = 0
    sweep_radius_m: float = 0.05

    def __post_init__(self) -> None:
        require(0.01 <= self.cell_m <= 0.5, "map.cell_m", self.cell_m, "0.01 to 0.5 m")
        require(1 <= self.ego_stride <= 16, "map.ego_stride", self.ego_stride, "1 to 16 cells")
        require(1 <= self.levels <= 64, "map.levels", self.levels, "1 to 64")
        require(self.floor_m <= 0, "map.floor_m", self.floor_m, "0 m or less, under the robots")
        require(0 <= self.step_levels <= 4, "map.step_levels", self.step_levels, "0 to 4")
        wide = 0.5 * self.cell_m <= self.sweep_radius_m <= 0.5
        require(wide, "map.sweep_radius_m", self.sweep_radius_m, "half a cell or more, at most 0.5 m")
        height_m = self.levels * self.cell_m
        require(height_m <= 1.2, "map.levels", self.levels, f"at most 1.2 m in all, not {height_m:.2f} m")

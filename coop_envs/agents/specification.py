"""What a robot is: body, drive, power, battery, camera, hat, IMU, laser. Data only.

The numbers live in ``robots/*.yaml``, ``hats/*.yaml`` and ``cameras/*.yaml``; these types say what they mean.
Frames: body x forward, y left, z up, origin ``body_height_m`` above the ground; camera z forward, x right, y down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from coop_envs.errors import require
from coop_envs.validation import STRICT

Role = Literal["observer", "picket"]


@dataclass(frozen=True)
class PowerModel:
    """Quadratic power ``p = x^T M x`` of the robot, its markers and its scanner, in watts.

    The symmetric matrices act on ``[v, omega, climb, 1]``, ``[marker_sum, 1]`` and ``[galvo, laser, 1]``, where climb
    is the world-z component of the body's x axis and ``marker_sum`` the sum of all LED channels, each 0..255.

    Source: thesis eqs (6.8), (6.13)-(6.15); the order [laser, steering] of (6.15) is swapped against the measured
    powers, so the galvo comes first here.
    """

    __pydantic_config__ = STRICT
    robot: tuple[tuple[float, float, float, float], ...]
    marker: tuple[tuple[float, float], ...]
    scanner: tuple[tuple[float, float, float], ...]

    def __post_init__(self) -> None:
        for name, size in (("robot", 4), ("marker", 2), ("scanner", 3)):
            matrix = getattr(self, name)
            square = len(matrix) == size and all(len(row) == size for row in matrix)
            require(square, f"power.{name}", matrix, f"a {size} x {size} matrix")
            symmetric = all(matrix[i][j] == matrix[j][i] for i in range(size) for j in range(i))
            require(symmetric, f"power.{name}", matrix, "a symmetric matrix (eq 6.5 needs one)")


@dataclass(frozen=True)
class Battery:
    """A battery's nominal voltage and capacity."""

    __pydantic_config__ = STRICT
    voltage_v: float
    capacity_mah: float

    def __post_init__(self) -> None:
        require(self.voltage_v > 0, "battery.voltage_v", self.voltage_v, "more than 0 V")
        require(self.capacity_mah > 0, "battery.capacity_mah", self.capacity_mah, "more than 0 mAh")

    @property
    def energy_j(self) -> float:
        return self.voltage_v * self.capacity_mah * 3.6


@dataclass(frozen=True)
class Imu:
    """Noise of a six-axis IMU: white noise densities, bias spread at switch-on and walk, extra noise while moving."""

    __pydantic_config__ = STRICT
    gyro_noise_rad_s_rthz: float = 1.0e-4
    accel_noise_m_s2_rthz: float = 4.0e-3
    gyro_bias_rad_s: float = 2.0e-3
    accel_bias_m_s2: float = 0.02
    gyro_walk_rad_s2_rthz: float = 2.0e-5
    accel_walk_m_s3_rthz: float = 2.0e-4
    moving_gyro_noise_rad_s_rthz: float = 2.0e-3
    moving_accel_noise_m_s2_rthz: float = 3.0e-2

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(value >= 0, f"imu.{name}", value, "0 or more")


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with plumb-bob distortion, fixed in the body.

    ``position_m`` is in the body frame, ``pitch_down_rad`` tilts the optical axis from body x towards the ground.
    ``shake_rad`` is how far the mount lets the camera turn about each of its axes while its robot's wheels turn, rms.
    """

    __pydantic_config__ = STRICT
    name: str
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    position_m: tuple[float, float, float] = (0.05, 0.0, 0.05)
    pitch_down_rad: float = 0.0
    max_range_m: float = 3.0
    shake_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in ("width_px", "height_px", "fx_px", "fy_px", "max_range_m"):
            require(getattr(self, name) > 0, f"camera.{name}", getattr(self, name), "more than 0")
        require(0 <= self.shake_rad <= 0.2, "camera.shake_rad", self.shake_rad, "0 to 0.2 rad")
        require(abs(self.pitch_down_rad) < 1.5, "camera.pitch_down_rad", self.pitch_down_rad, "within +/-1.5 rad")


@dataclass(frozen=True)
class Led:
    """One coloured LED of a hat: hue in degrees (0 red, 120 green) and position in the body frame."""

    __pydantic_config__ = STRICT
    hue_deg: float
    position_m: tuple[float, float, float]


@dataclass(frozen=True)
class Hat:
    """LEDs at known positions, by which cameras see the robot's pose."""

    __pydantic_config__ = STRICT
    name: str
    leds: tuple[Led, ...]

    def __post_init__(self) -> None:
        require(4 <= len(self.leds) <= 8, f"hat {self.name}.leds", len(self.leds), "4 to 8 LEDs")
        hues = [led.hue_deg % 360 for led in self.leds]
        require(len(set(hues)) == len(hues), f"hat {self.name}.leds.hue_deg", hues, "each hue once")


@dataclass(frozen=True)
class Laser:
    """A laser pointer behind a mirror with two motors, and the raster that it draws.

    The motors know no position: they run for whole counts of ``count_s``, each of which turns the ray by ``count_rad``,
    give or take ``move_noise`` of each frame's turn, until an end stop at ``max_deflection_rad``. The diode can be
    driven at ``duties``. A raster of full width reaches ``raster_half_rad`` (azimuth, elevation) to either side of its
    centre, in steps of ``step_counts``. ``position_m`` is where the ray leaves the body; undeflected it goes along body
    x.

    Source: Zumy firmware (10 ms counts); thesis section 6.3 (pi/4 each way); the authors move at 1 rad/s.
    """

    __pydantic_config__ = STRICT
    max_deflection_rad: float = 0.785
    duties: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    count_s: float = 0.01
    count_rad: float = 0.01
    move_noise: float = 0.02
    raster_half_rad: tuple[float, float] = (0.6, 0.25)
    step_counts: int = 3
    position_m: tuple[float, float, float] = (0.03, 0.0, 0.08)

    def __post_init__(self) -> None:
        for name in ("count_s", "count_rad"):
            require(getattr(self, name) > 0, f"laser.{name}", getattr(self, name), "more than 0")
        require(0 <= self.move_noise < 0.5, "laser.move_noise", self.move_noise, "0 up to 0.5")
        reach = self.raster_half_rad
        require(all(0 < half <= 1.5 for half in reach), "laser.raster_half_rad", reach, "above 0, at most 1.5 rad")
        require(1 <= self.step_counts <= 50, "laser.step_counts", self.step_counts, "1 to 50 counts")
        reach_fits = 0 < self.max_deflection_rad < 1.5
        require(reach_fits, "laser.max_deflection_rad", self.max_deflection_rad, "above 0, below 1.5 rad")
        duties_fit = all(0 <= duty <= 1 for duty in self.duties) and max(self.duties, default=0.0) > 0
        require(duties_fit, "laser.duties", self.duties, "levels from 0 to 1, one of them above 0")


@dataclass(frozen=True)
class RobotSpecification:
    """A type of robot.

    ``contact_radius_m`` bounds the ground that carries the robot: tracks or legs. A hazard catches the robot when it
    reaches into this disc, and only ground under it is proven by the robot's passing. Without ``radio_imu`` the host
    does not hear of its IMU, and takes it to turn as its wheels do and to feel gravity alone; ``imu`` then says how
    wrong that is.
    """

    __pydantic_config__ = STRICT
    name: str
    mass_kg: float
    body_radius_m: float
    contact_radius_m: float
    height_m: float
    body_height_m: float
    wheel_radius_m: float
    track_m: float
    max_speed_m_s: float
    max_yaw_rate_rad_s: float
    drive_lag_s: float
    slip: float
    slip_time_s: float
    slope_slip: float
    max_slope_rad: float
    max_step_m: float
    max_drop_m: float
    odometry_noise: float
    modality: Literal["tracks", "legs"]
    battery: Battery
    power: PowerModel
    imu: Imu = Imu()
    radio_imu: bool = True

    def __post_init__(self) -> None:
        positive = (
            "mass_kg body_radius_m contact_radius_m height_m wheel_radius_m track_m max_speed_m_s max_yaw_rate_rad_s"
        )
        for name in positive.split():
            require(getattr(self, name) > 0, f"robot {self.name}.{name}", getattr(self, name), "more than 0")
        for name in ["slip", "slip_time_s", "slope_slip", "drive_lag_s", "odometry_noise", "max_step_m", "max_drop_m"]:
            require(getattr(self, name) >= 0, f"robot {self.name}.{name}", getattr(self, name), "0 or more")
        fits = self.contact_radius_m <= self.body_radius_m
        require(fits, f"robot {self.name}.contact_radius_m", self.contact_radius_m, "at most body_radius_m")

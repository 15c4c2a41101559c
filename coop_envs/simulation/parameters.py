"""Robots, worlds and rates packed for the device."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from coop_envs.agents.power import PowerMatrices
from coop_envs.agents.specification import Hat
from coop_envs.agents.team import Member, Team
from coop_envs.geometry.terrain import NO_GROUND_M, Terrain
from coop_envs.sensing.camera import CameraModel, camera_model
from coop_envs.sensing.hats import Hats, pack_hats
from coop_envs.worlds.world import World

SHORTEST_REACH_M = 0.01
LEVEL_REACH_M = 0.08
TRAP, HOLE, SLIPPERY = wp.constant(0), wp.constant(1), wp.constant(2)
HAZARD_KINDS = {"trap": 0, "hole": 1, "slippery": 2}


@wp.struct
class RobotModel:
    """One robot's physics. Lengths m, times s; ``marker_sum`` is what all its LED channels add up to at full.

    ``max_climb`` is the sine of the steepest slope it climbs. Ground that rises by more than ``step_rise`` within
    ``step_reach`` is a wall to it, ground that drops by more than ``drop_depth`` within ``drop_reach`` an edge; it tips
    over where its up axis leans further than ``upright``, a cosine.
    """

    mass: float
    body_radius: float
    contact_radius: float
    height: float
    body_height: float
    wheel_radius: float
    track: float
    lag: float
    slip: float
    slip_time: float
    slope_slip: float
    max_climb: float
    upright: float
    step_rise: float
    step_reach: float
    drop_depth: float
    drop_reach: float
    odometry_noise: float
    battery: float
    idle_power: float
    marker_sum: float
    leds: int
    reserve: int
    radio_imu: int
    gyro_noise: float
    accel_noise: float
    moving_gyro_noise: float
    moving_accel_noise: float
    gyro_bias: float
    accel_bias: float
    gyro_walk: float
    accel_walk: float
    power: PowerMatrices


@wp.struct
class Hazards:
    """Hazards of all worlds: those of world w are ``first[w]`` up to ``first[w + 1]``."""

    first: wp.array[int]
    kind: wp.array[int]
    centre: wp.array[wp.vec2]
    axis: wp.array[wp.vec2]
    half_size: wp.array[wp.vec2]
    radius: wp.array[float]
    motion_scale: wp.array[float]


def marker_sum(hat: Hat | None) -> float:
    """Sum of the red, green and blue channels (0..255) of a hat's LEDs at full brightness."""
    if hat is None:
        return 0.0
    return sum(255.0 * sum(colorsys.hsv_to_rgb(led.hue_deg % 360.0 / 360.0, 1.0, 1.0)) for led in hat.leds)


def steep(limit_m: float, grade: float, radius_m: float) -> tuple[float, float]:
    """Height and way over which ground counts as a step of at least ``limit_m``, and not as a slope of this grade."""
    reach_m = float(np.clip(limit_m / grade, SHORTEST_REACH_M, 0.9 * radius_m))
    return max(limit_m, reach_m * grade), reach_m


def robot_model(member: Member) -> RobotModel:
    """Pack one member of a team."""
    robot, imu = member.robot, member.robot.imu
    model = RobotModel()
    model.mass = robot.mass_kg
    model.body_radius, model.contact_radius = robot.body_radius_m, robot.contact_radius_m
    model.height, model.body_height = robot.height_m, robot.body_height_m
    model.wheel_radius, model.track = robot.wheel_radius_m, robot.track_m
    model.lag, model.slip, model.slip_time = robot.drive_lag_s, robot.slip, robot.slip_time_s
    model.slope_slip, model.max_climb = robot.slope_slip, float(np.sin(robot.max_slope_rad))
    tip_grade = robot.contact_radius_m / (0.5 * robot.height_m)
    model.upright = float(np.cos(np.arctan(tip_grade)))
    model.step_rise, model.step_reach = steep(robot.max_step_m, tip_grade, robot.body_radius_m)
    model.drop_depth, model.drop_reach = steep(robot.max_drop_m, tip_grade, robot.body_radius_m)
    model.odometry_noise = robot.odometry_noise
    model.battery, model.idle_power = robot.battery.energy_j, robot.power.robot[3][3]
    model.marker_sum = marker_sum(member.hat)
    model.leds = len(member.hat.leds) if member.hat else 0
    model.reserve, model.radio_imu = int(member.reserve), int(robot.radio_imu)
    model.gyro_noise, model.accel_noise = imu.gyro_noise_rad_s_rthz, imu.accel_noise_m_s2_rthz
    model.moving_gyro_noise = imu.moving_gyro_noise_rad_s_rthz
    model.moving_accel_noise = imu.moving_accel_noise_m_s2_rthz
    model.gyro_bias, model.accel_bias = imu.gyro_bias_rad_s, imu.accel_bias_m_s2
    model.gyro_walk, model.accel_walk = imu.gyro_walk_rad_s2_rthz, imu.accel_walk_m_s3_rthz
    model.power.robot = wp.mat44(*np.ravel(robot.power.robot))
    model.power.marker = wp.mat22(*np.ravel(robot.power.marker))
    model.power.scanner = wp.mat33(*np.ravel(robot.power.scanner))
    return model


def pack_robots(team: Team, device: str) -> tuple[wp.array, wp.array, Hats]:
    """Robot models (N,), camera models (N,) and hats of a team."""
    robots = wp.array([robot_model(m) for m in team.members], dtype=RobotModel, device=device)
    cameras = wp.array([camera_model(m.camera) for m in team.members], dtype=CameraModel, device=device)
    return robots, cameras, pack_hats([m.hat.leds if m.hat else () for m in team.members], device)


def pack_terrain(worlds: Sequence[World], device: str) -> tuple[Terrain, list[wp.Mesh]]:
    """The ground and meshes of all worlds. The meshes must be kept alive as long as the terrain is used."""
    fields = [world.ground for world in worlds]
    flat = [np.nan_to_num(f.heights_m, nan=NO_GROUND_M).astype(np.float32).ravel() for f in fields]
    meshes = {id(w.mesh): _mesh(w, device) for w in worlds if w.mesh is not None}
    terrain = Terrain()
    terrain.heights = wp.array(np.concatenate(flat), dtype=float, device=device)
    shaped = [heights.reshape(f.heights_m.shape) for heights, f in zip(flat, fields, strict=True)]
    level = [_level_cells(heights, f.cell_m) for heights, f in zip(shaped, fields, strict=True)]
    tops = [maximum_filter(heights, 2, mode="nearest", origin=-1) for heights in shaped]
    terrain.top = wp.array(np.concatenate([top.ravel() for top in tops]), dtype=float, device=device)
    terrain.level = wp.array(np.concatenate(level), dtype=wp.int8, device=device)
    terrain.level_reach = LEVEL_REACH_M
    terrain.offset = wp.array(np.cumsum([0] + [f.size for f in flat[:-1]]), dtype=int, device=device)
    terrain.shape = wp.array([f.heights_m.shape for f in fields], dtype=wp.vec2i, device=device)
    terrain.origin = wp.array([f.origin_m for f in fields], dtype=wp.vec2, device=device)
    terrain.cell = wp.array([f.cell_m for f in fields], dtype=float, device=device)
    ids = [meshes[id(w.mesh)].id if w.mesh is not None else 0 for w in worlds]
    terrain.mesh = wp.array(ids, dtype=wp.uint64, device=device)
    return terrain, list(meshes.values())


def _level_cells(heights: NDArray[np.float32], cell_m: float) -> NDArray[np.int8]:
    """1 at the lower corners of cells (n,) around which all nodes within `LEVEL_REACH_M`, and one more, agree."""
    around = math.ceil(LEVEL_REACH_M / cell_m) + 1
    size = 2 * around + 2  # nodes from `around` before the lower corner to `around` after the upper one: origin -1
    low = minimum_filter(heights, size, mode="constant", cval=NO_GROUND_M, origin=-1)
    high = maximum_filter(heights, size, mode="constant", cval=NO_GROUND_M, origin=-1)
    return (low == high).astype(np.int8).ravel()


def _mesh(world: World, device: str) -> wp.Mesh:
    assert world.mesh is not None
    points = wp.array(world.mesh.vertices_m, dtype=wp.vec3, device=device)
    return wp.Mesh(points=points, indices=wp.array(world.mesh.faces.ravel(), dtype=wp.int32, device=device))


def pack_hazards(worlds: Sequence[World], device: str) -> Hazards:
    """The hazards of all worlds."""
    every = [h for world in worlds for h in world.hazards]
    rows = every or [None]
    packed = Hazards()
    packed.first = wp.array(np.cumsum([0] + [len(w.hazards) for w in worlds]), dtype=int, device=device)
    packed.kind = wp.array([HAZARD_KINDS[h.kind] if h else 0 for h in rows], dtype=int, device=device)
    packed.centre = wp.array([h.centre_m if h else (0.0, 0.0) for h in rows], dtype=wp.vec2, device=device)
    axes = [(np.cos(h.yaw_rad), np.sin(h.yaw_rad)) if h else (1.0, 0.0) for h in rows]
    packed.axis = wp.array(axes, dtype=wp.vec2, device=device)
    packed.half_size = wp.array([h.half_size_m if h else (0.0, 0.0) for h in rows], dtype=wp.vec2, device=device)
    packed.radius = wp.array([h.radius_m if h else 0.0 for h in rows], dtype=float, device=device)
    packed.motion_scale = wp.array([h.motion_scale if h else 1.0 for h in rows], dtype=float, device=device)
    return packed

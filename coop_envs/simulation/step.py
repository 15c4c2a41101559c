"""One decision of the fast physics: ticks and substeps of every robot of a team, hazards, power, IMU samples."""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.agents.power import marker_power_w, motion_power_w, scanner_power_w
from coop_envs.agents.raster import LaserModel
from coop_envs.geometry.keyed_random import draw_key, normal2, normal3
from coop_envs.geometry.so3 import log_so3
from coop_envs.sensing.measurements import Measurements
from coop_envs.simulation.dynamics import Ground, drive, restless, spin_wheels
from coop_envs.simulation.footing import foot_point
from coop_envs.simulation.hazards import hazard_distance
from coop_envs.simulation.mirror import turn_mirror
from coop_envs.simulation.parameters import HOLE, TRAP, Hazards, RobotModel
from coop_envs.simulation.state import ACTIVE, DEPLETED, DOCKED, SWALLOWED, TRAPPED, State

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

GRAVITY = wp.constant(9.81)
MOVING_RAD_S = wp.constant(0.05)
SLIP_CHANNEL = wp.constant(0)
GYRO_CHANNEL = wp.constant(1)
ACCEL_CHANNEL = wp.constant(3)
GYRO_WALK_CHANNEL = wp.constant(5)
ACCEL_WALK_CHANNEL = wp.constant(7)
ENCODER_CHANNEL = wp.constant(9)


@wp.struct
class Clock:
    """Rates of the physics: tick length (s), substeps a tick, ticks a decision."""

    tick_s: float
    substeps: int
    ticks: int


@wp.func
def wander_slip(state: State, model: RobotModel, b: int, r: int, tick: int, dt: float):
    """Move the slip of both sides one tick along its Gauss-Markov process."""
    keep = wp.exp(-dt / model.slip_time)
    noise = normal2(draw_key(state.key[b], tick, r, SLIP_CHANNEL)) * (model.slip * wp.sqrt(1.0 - keep * keep))
    state.slip[b, r] = state.slip[b, r] * keep + noise


@wp.func
def meet_hazards(state: State, model: RobotModel, hazards: Hazards, b: int, r: int):
    """A trap holds, and a hole swallows, a robot whose contact disc it touches."""
    foot = foot_point(state.position[b, r], state.rotation[b, r], model.body_height)
    w = state.world[b]
    for k in range(hazards.first[w], hazards.first[w + 1]):
        d = hazard_distance(hazards, k, foot[0], foot[1])
        if hazards.kind[k] == HOLE and d < model.contact_radius:
            state.status[b, r] = SWALLOWED
        if hazards.kind[k] == TRAP and d < model.contact_radius and state.status[b, r] == ACTIVE:
            state.status[b, r] = TRAPPED


@wp.func
def draw_power(state: State, command: Command, model: RobotModel, b: int, r: int, t: int, steering: float, dt: float):
    """Take one tick's energy from the battery (eq 6.16): idle, motion, markers, scanner.

    Motion is what the wheels do, whether the robot gets anywhere or not; rolling downhill cannot charge the battery.
    ``steering`` is the share of the tick in which the mirror's motors ran.
    """
    rim = state.wheels[b, r] * model.wheel_radius
    speed = 0.5 * (rim[0] + rim[1])
    motion_w = motion_power_w(model.power, speed, (rim[1] - rim[0]) / model.track, state.rotation[b, r][2, 0])
    motion_w = wp.max(motion_w, -model.idle_power)
    marker_w = marker_power_w(model.power, command.brightness[b, r] * model.marker_sum)
    scanner_w = scanner_power_w(model.power, steering, command.laser[b, r, t])
    power = wp.vec4d(wp.float64(model.idle_power), wp.float64(motion_w), wp.float64(marker_w), wp.float64(scanner_w))
    spent = state.energy[b, r] + power * wp.float64(dt)
    state.energy[b, r] = spent
    if spent[0] + spent[1] + spent[2] + spent[3] >= wp.float64(model.battery):
        state.status[b, r] = DEPLETED


@wp.func
def sample_imu(
    state: State, out: Measurements, model: RobotModel, b: int, r: int, t: int, R: wp.mat33, velocity: wp.vec3,
    dt: float,
):  # fmt: skip
    """One IMU sample: rotation since ``R`` and the change to ``velocity`` since the last tick, plus bias and noise."""
    tick = state.tick[b] + t
    key = state.key[b]
    force = wp.transpose(R) * ((velocity - state.velocity[b, r]) / dt + wp.vec3(0.0, 0.0, GRAVITY))
    rate = wp.vec3(log_so3(wp.mat33d(wp.transpose(R) * state.rotation[b, r]))) / dt
    state.velocity[b, r] = velocity
    shake = float(0.0)
    if wp.length(state.wheels[b, r]) > MOVING_RAD_S:
        shake = 1.0
    root = wp.sqrt(1.0 / dt)
    gyro_sigma = (model.gyro_noise + shake * model.moving_gyro_noise) * root
    accel_sigma = (model.accel_noise + shake * model.moving_accel_noise) * root
    out.gyro[b, r, t] = rate + state.gyro_bias[b, r] + normal3(key, tick, r, GYRO_CHANNEL) * gyro_sigma
    out.accel[b, r, t] = force + state.accel_bias[b, r] + normal3(key, tick, r, ACCEL_CHANNEL) * accel_sigma


@wp.func
def walk_biases(state: State, model: RobotModel, b: int, r: int, dt: float):
    """Move the IMU's biases one decision along their random walks."""
    key = state.key[b]
    tick = state.tick[b]
    root = wp.sqrt(dt)
    gyro_walk = normal3(key, tick, r, GYRO_WALK_CHANNEL) * (model.gyro_walk * root)
    accel_walk = normal3(key, tick, r, ACCEL_WALK_CHANNEL) * (model.accel_walk * root)
    state.gyro_bias[b, r] = state.gyro_bias[b, r] + gyro_walk
    state.accel_bias[b, r] = state.accel_bias[b, r] + accel_walk


@wp.func
def roll(
    state: State, command: Command, out: Measurements, robots: wp.array[RobotModel], ground: Ground, clock: Clock,
    b: int, r: int,
) -> wp.vec3:  # fmt: skip
    """Move one robot for a tick; its velocity in the last substep."""
    last = state.position[b, r]
    dt = clock.tick_s / float(clock.substeps)
    for _s in range(clock.substeps):
        last = state.position[b, r]
        if state.status[b, r] == ACTIVE or state.status[b, r] == TRAPPED:
            spin_wheels(state, robots[r], b, r, command.wheels[b, r], dt)
            out.wheels[b, r] = out.wheels[b, r] + state.wheels[b, r] / float(clock.substeps * clock.ticks)
        if restless(state, ground.friction, b, r):
            drive(state, robots, ground, b, r, dt)
    return (state.position[b, r] - last) / dt


@wp.func
def end_tick(
    state: State, command: Command, model: RobotModel, laser: LaserModel, hazards: Hazards, b: int, r: int, t: int,
    tick_s: float,
):  # fmt: skip
    """What a tick's end brings to one robot besides motion: hazards, the mirror's turn, the energy drawn."""
    if state.status[b, r] == ACTIVE:
        meet_hazards(state, model, hazards, b, r)
    steering = turn_mirror(state, command, laser, b, r, t, tick_s)
    if state.status[b, r] != DEPLETED and state.status[b, r] != SWALLOWED:
        draw_power(state, command, model, b, r, t, steering, tick_s)
    if state.status[b, r] != ACTIVE and state.status[b, r] != TRAPPED:
        state.wheels[b, r] = wp.vec2(0.0, 0.0)


@wp.func
def turn_as_wheels(out: Measurements, model: RobotModel, b: int, r: int):
    """What the host holds for the IMU of a robot whose radio carries none."""
    rim = out.wheels[b, r] * model.wheel_radius
    for t in range(out.gyro.shape[2]):
        out.gyro[b, r, t] = wp.vec3(0.0, 0.0, (rim[1] - rim[0]) / model.track)
        out.accel[b, r, t] = wp.vec3(0.0, 0.0, GRAVITY)


@wp.kernel
def advance(
    state: State, command: Command, out: Measurements, robots: wp.array[RobotModel], lasers: wp.array[LaserModel],
    ground: Ground, clock: Clock, running: wp.array[int],
):  # fmt: skip
    """Advance every running team by one decision."""
    b = wp.tid()
    if running[b] == 0:
        return
    n = robots.shape[0]
    for r in range(n):
        out.wheels[b, r] = wp.vec2(0.0, 0.0)
    for t in range(clock.ticks):
        for r in range(n):
            if state.status[b, r] != DOCKED and state.collected[b, r] == 0:
                before = state.position[b, r]
                R = state.rotation[b, r]
                wander_slip(state, robots[r], b, r, state.tick[b] + t, clock.tick_s)
                velocity = roll(state, command, out, robots, ground, clock, b, r)
                end_tick(state, command, robots[r], lasers[r], ground.hazards, b, r, t, clock.tick_s)
                state.path[b, r] = state.path[b, r] + wp.length(state.position[b, r] - before)
                sample_imu(state, out, robots[r], b, r, t, R, velocity, clock.tick_s)
    state.tick[b] = state.tick[b] + clock.ticks
    for r in range(n):
        model = robots[r]
        if state.status[b, r] != DOCKED:
            walk_biases(state, model, b, r, clock.tick_s * float(clock.ticks))
        spent = state.energy[b, r]
        status = state.status[b, r]
        jitter = normal2(draw_key(state.key[b], state.tick[b], r, ENCODER_CHANNEL)) * model.odometry_noise
        out.wheels[b, r] = out.wheels[b, r] + wp.cw_mul(out.wheels[b, r], jitter)
        if model.radio_imu == 0:
            turn_as_wheels(out, model, b, r)
        out.battery[b, r] = wp.max(1.0 - float(spent[0] + spent[1] + spent[2] + spent[3]) / model.battery, 0.0)
        out.docked[b, r] = int(status == DOCKED)
        out.heard[b, r] = int(status != SWALLOWED and status != DEPLETED and state.collected[b, r] == 0)

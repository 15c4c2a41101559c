"""`State`: the truth of a batch of teams, and what can become of a robot."""

from __future__ import annotations

from enum import IntEnum

import warp as wp


class Status(IntEnum):
    """What has become of a robot, in truth."""

    DOCKED = 0
    ACTIVE = 1
    TRAPPED = 2
    SWALLOWED = 3
    FALLEN = 4
    DEPLETED = 5


DOCKED = wp.constant(int(Status.DOCKED))
ACTIVE = wp.constant(int(Status.ACTIVE))
TRAPPED = wp.constant(int(Status.TRAPPED))
SWALLOWED = wp.constant(int(Status.SWALLOWED))
FALLEN = wp.constant(int(Status.FALLEN))
DEPLETED = wp.constant(int(Status.DEPLETED))


@wp.struct
class State:
    """Arrays over B teams and N robots, world frame, SI units.

    position, rotation, velocity
        (B, N) body origin, R_world_body, velocity at the end of the last tick.
    yaw, wheels, slip
        (B, N) heading, actual wheel speeds (rad/s), relative slip of both sides.
    status, collected
        (B, N) a `Status`; 1 where someone has taken a lost robot out of the world.
    energy
        (B, N) joules drawn so far: idle, motion, markers, scanner.
    mirror, mirror_left
        (B, N, T) deflection (left, up; rad) of the laser's mirror at the end of each tick of the last decision; (B, N)
        seconds that its motors still run, negative for right and down.
    gyro_bias, accel_bias
        (B, N) of the IMUs, rad/s and m/s^2.
    path
        (B, N) length of the way gone, m.
    world, key, tick
        (B,) index of the team's world, its random key, ticks since reset.
    frame
        (B,) the team frame in the world: x, y, z, yaw of the first observer's start.
    """

    position: wp.array2d[wp.vec3]
    rotation: wp.array2d[wp.mat33]
    velocity: wp.array2d[wp.vec3]
    yaw: wp.array2d[float]
    wheels: wp.array2d[wp.vec2]
    slip: wp.array2d[wp.vec2]
    status: wp.array2d[int]
    collected: wp.array2d[int]
    energy: wp.array2d[wp.vec4d]
    mirror: wp.array3d[wp.vec2]
    mirror_left: wp.array2d[wp.vec2]
    gyro_bias: wp.array2d[wp.vec3]
    accel_bias: wp.array2d[wp.vec3]
    path: wp.array2d[float]
    world: wp.array[int]
    key: wp.array[wp.uint64]
    tick: wp.array[int]
    frame: wp.array[wp.vec4]

"""`Measurements`: everything that the robots of a batch of teams report for one decision.

The same type comes from simulation and from robots; beliefs are a function of it and of the commands alone.
"""

from __future__ import annotations

import warp as wp

from coop_envs.geometry.arrays import allocate
from coop_envs.sensing.poses import mat66d


@wp.struct
class Measurements:
    """Arrays over B teams, N robots and T ticks of one decision.

    gyro, accel
        (B, N, T) rad/s and m/s^2 in the body frame; specific force, so +g along z at rest.
    heard
        (B, N) 1 where the robot's packets arrived.
    docked
        (B, N) 1 where the robot waits in its dock.
    wheels
        (B, N) mean left and right wheel speed from the encoders, rad/s.
    battery
        (B, N) remaining fraction.
    spot, spot_sigma, spot_stamp
        (B, N, T) pixel of the laser spot in each camera's frame at the end of each tick; the standard deviation of its
        centroid (px) as the detector states it from the blob's shape, 0 where there is no spot; and the frame's time
        after the end of the tick (s).
    seen
        (B, N, N) 1 where the camera of robot i gave a pose of robot j.
    p_camera_body, R_camera_body
        (B, N, N) that pose: p_camera = R_camera_body p_body + p_camera_body, metres.
    covariance
        (B, N, N) of its error: rotation (rad, applied from the left, camera axes), then position (m).
    leds
        (B, N, N) which of the hat's LEDs it rests on, bit k for LED k; 0 where nobody tells.
    """

    gyro: wp.array3d[wp.vec3]
    accel: wp.array3d[wp.vec3]
    heard: wp.array2d[int]
    docked: wp.array2d[int]
    wheels: wp.array2d[wp.vec2]
    battery: wp.array2d[float]
    spot: wp.array3d[wp.vec2]
    spot_sigma: wp.array3d[float]
    spot_stamp: wp.array3d[float]
    seen: wp.array3d[int]
    p_camera_body: wp.array3d[wp.vec3]
    R_camera_body: wp.array3d[wp.mat33]
    covariance: wp.array3d[mat66d]
    leds: wp.array3d[int]


def allocate_measurements(teams: int, robots: int, ticks: int, device: str) -> Measurements:
    """Measurements of nothing yet."""
    names = ("gyro", "accel", "spot", "spot_sigma", "spot_stamp")
    samples = dict.fromkeys(names, (teams, robots, ticks))
    return allocate(Measurements, (teams, robots, robots), device, **samples)

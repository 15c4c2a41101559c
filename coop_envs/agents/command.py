"""`Command`: what robots are told for one decision, the same for simulation and for real links."""

from __future__ import annotations

import warp as wp


@wp.struct
class Command:
    """Arrays over B teams and N robots.

    wheels
        Left and right wheel set-point, rad/s.
    brightness
        LED brightness, 0..1 of full.
    laser
        Laser duty, one of those it can be driven at.
    galvo
        Relative counts of the two mirror motors.
    hold
        1 where the robot is told to stand still.
    undock
        1 where a reserve is told to leave its dock.
    collect
        1 where a person is asked to take a lost robot out of the way, as in the experiments of thesis section 2.2.3.
    """

    wheels: wp.array2d[wp.vec2]
    brightness: wp.array2d[float]
    laser: wp.array2d[float]
    galvo: wp.array2d[wp.vec2i]
    hold: wp.array2d[int]
    undock: wp.array2d[int]
    collect: wp.array2d[int]

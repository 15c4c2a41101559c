"""`Command`: what robots are told for one decision, the same for simulation and for real links."""

from __future__ import annotations

import warp as wp

from coop_envs.geometry.arrays import allocate


@wp.struct
class Command:
    """Arrays over B teams and N robots, and the T ticks of a decision.

    wheels
        Left and right wheel set-point, rad/s.
    brightness
        LED brightness, 0..1 of full.
    laser
        (B, N, T) laser duty, one of those it can be driven at.
    galvo
        (B, N, T) relative counts of the two mirror motors (left, up); sent at the start of the tick.
    scan_progress
        Share of its raster that a robot has done after this decision, 0 where it draws none.
    hold
        1 where the robot is told to stand still.
    undock
        1 where a reserve is told to leave its dock.
    collect
        1 where a person is asked to take a lost robot out of the way, as in the experiments of thesis section 2.2.3.
    """

    wheels: wp.array2d[wp.vec2]
    brightness: wp.array2d[float]
    laser: wp.array3d[float]
    galvo: wp.array3d[wp.vec2i]
    scan_progress: wp.array2d[float]
    hold: wp.array2d[int]
    undock: wp.array2d[int]
    collect: wp.array2d[int]


def allocate_command(teams: int, robots: int, ticks: int, device: str) -> Command:
    """Commands of nothing: everybody stands, dark."""
    return allocate(Command, (teams, robots, ticks), device)

"""Boustrophedon rasters with a mirror that only takes relative moves: the scan controller, the same on robots.

A raster runs row by row, every second row backwards. The controller counts where the mirror should be; nothing
measures it. A move of k counts keeps the motors busy for k ``count_s``, in which they heed no other, so the controller
waits for it. The laser is lit in a tick at whose end the mirror rests on a point and nobody else of the team is lit.

Source: thesis sections 6.4, 6.5; the Zumy's firmware for counts.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.specification import Laser
from coop_envs.agents.team import Team

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class Raster:
    """Rasters of B teams and N robots, in counts (left, up) from where the mirror was switched on.

    centre, half
        (B, N) of the raster.
    at
        (B, N) where the mirror should be.
    point, points
        (B, N) how many points are done, how many there are; 0 where no raster runs.
    busy
        (B, N) ticks until the last move has run down.
    """

    centre: wp.array2d[wp.vec2i]
    half: wp.array2d[wp.vec2i]
    at: wp.array2d[wp.vec2i]
    point: wp.array2d[int]
    points: wp.array2d[int]
    busy: wp.array2d[int]


@wp.struct
class LaserModel:
    """A robot's laser; see `specification.Laser`. ``fitted`` is 0 without one, ``duty`` its strongest level.

    ``half`` and ``limit`` in counts: of a raster of full width, and of the mirror. A count takes ``ticks_a_count``.
    """

    fitted: int
    duty: float
    count_s: float
    count_rad: float
    move_noise: float
    limit_rad: float
    limit: int
    half: wp.vec2i
    step: int
    ticks_a_count: float
    position: wp.vec3


def laser_models(team: Team, tick_s: float, device: str) -> wp.array:
    """Pack every member's laser (N,)."""
    models: list[LaserModel] = []
    for member in team.members:
        model, laser = LaserModel(), member.laser
        if laser is not None:
            model.fitted, model.duty = 1, max(laser.duties)
            model.count_s, model.count_rad, model.move_noise = laser.count_s, laser.count_rad, laser.move_noise
            model.limit_rad = laser.max_deflection_rad
            model.limit = int(laser.max_deflection_rad / laser.count_rad + 1e-6)
            model.half = wp.vec2i(*(round(half / laser.count_rad) for half in laser.raster_half_rad))
            model.step, model.position = laser.step_counts, wp.vec3(*laser.position_m)
            model.ticks_a_count = laser.count_s / tick_s
        models.append(model)
    return wp.array(models, dtype=LaserModel, device=device)


def raster_axes(laser: Laser, share: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Counts from a raster's centre to its columns (left first) and rows (top first), at a share of the full width."""
    axes = []
    for half_rad in laser.raster_half_rad:
        wide = round(share * round(half_rad / laser.count_rad)) + laser.step_counts // 2
        steps = min(wide, int(laser.max_deflection_rad / laser.count_rad + 1e-6)) // laser.step_counts
        axes.append(laser.step_counts * np.arange(steps, -steps - 1, -1))
    return axes[0], axes[1]


@wp.func
def columns(half: wp.vec2i, step: int, axis: int) -> int:
    """How many points a raster has along an axis."""
    return 2 * half[axis] // step + 1


@wp.func
def raster_point(raster: Raster, model: LaserModel, b: int, r: int, k: int) -> wp.vec2i:
    """Counts of the raster's k-th point: rows from the top, the first from the left."""
    half = raster.half[b, r]
    across = columns(half, model.step, 0)
    row = k // across
    column = k % across
    if row % 2 == 1:
        column = across - 1 - column
    return raster.centre[b, r] + half - wp.vec2i(column * model.step, row * model.step)


@wp.func
def begin_raster(raster: Raster, model: LaserModel, b: int, r: int, request: float, azimuth: float, elevation: float):
    """Start a raster whose width is the share ``request`` of the full one, its centre a share of the mirror's reach.

    Its half width is a whole number of steps, and its centre is moved in so that the end stops cut nothing off.
    """
    wanted = wp.vec2(azimuth, elevation)
    centre = wp.vec2i()
    half = wp.vec2i()
    for axis in range(2):
        wide = int(wp.round(request * float(model.half[axis]))) + model.step // 2
        half[axis] = wp.min(wide, model.limit) // model.step * model.step
        room = model.limit - half[axis]
        centre[axis] = wp.clamp(int(wp.round(wanted[axis] * float(model.limit))), -room, room)
    raster.centre[b, r] = centre
    raster.half[b, r] = half
    raster.point[b, r] = 0
    raster.points[b, r] = columns(half, model.step, 0) * columns(half, model.step, 1)


@wp.func
def next_move(raster: Raster, model: LaserModel, b: int, r: int) -> wp.vec2i:
    """One tick of moving: counts to send now, (0, 0) while the motors are busy or the mirror is there."""
    move = wp.vec2i(0, 0)
    if raster.point[b, r] >= raster.points[b, r]:
        return move
    if raster.busy[b, r] == 0:
        move = raster_point(raster, model, b, r, raster.point[b, r]) - raster.at[b, r]
        raster.at[b, r] = raster.at[b, r] + move
        longest = wp.max(wp.abs(move[0]), wp.abs(move[1]))
        raster.busy[b, r] = int(wp.ceil(float(longest) * model.ticks_a_count - 1.0e-3))
    raster.busy[b, r] = wp.max(raster.busy[b, r] - 1, 0)
    return move


@wp.func
def on_point(raster: Raster, b: int, r: int) -> bool:
    """Whether the mirror rests on the next point at the end of this tick."""
    return raster.busy[b, r] == 0 and raster.point[b, r] < raster.points[b, r]


@wp.func
def abandon_raster(raster: Raster, b: int, r: int, ticks: int):
    """Stop; the last move runs down while a decision of so many ticks passes."""
    raster.point[b, r] = 0
    raster.points[b, r] = 0
    raster.busy[b, r] = wp.max(raster.busy[b, r] - ticks, 0)


@wp.kernel
def rest_rasters(raster: Raster, chosen: wp.array[int]):
    """Forget the rasters of the chosen teams: their mirrors are switched on anew."""
    b, r = wp.tid()
    if chosen[b] == 1:
        raster.at[b, r] = wp.vec2i(0, 0)
        raster.busy[b, r] = 0
        raster.point[b, r] = 0
        raster.points[b, r] = 0

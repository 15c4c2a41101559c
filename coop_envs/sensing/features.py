"""`Features`: the blobs of light that cameras report, before anyone knows whose they are."""

from __future__ import annotations

import warp as wp

from coop_envs.geometry.arrays import allocate

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.struct
class Features:
    """Blobs of the last frame of camera i of team b: ``pixel[b, i, :count[b, i]]`` and so on.

    count
        (B, N) number of blobs.
    pixel
        (B, N, K) centroid (u, v).
    hue
        (B, N, K) in degrees: 0 red, 120 green, 240 blue.
    signal
        (B, N, K) brightness, relative to an LED at full power at the reference range.
    """

    count: wp.array2d[int]
    pixel: wp.array3d[wp.vec2]
    hue: wp.array3d[float]
    signal: wp.array3d[float]


def allocate_features(teams: int, robots: int, blobs: int, device: str) -> Features:
    """Frames without light, with room for so many blobs each."""
    return allocate(Features, (teams, robots, blobs), device)


@wp.func
def hue_apart(a: float, b: float) -> float:
    """Angle between two hues, 0 to 180 degrees."""
    d = wp.abs(a - b)
    d = d - 360.0 * wp.floor(d / 360.0)
    return wp.min(d, 360.0 - d)

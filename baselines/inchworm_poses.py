"""Where the thesis's two robots stand for their scans while they inch along: one scans, moves, and swaps roles.

Source: thesis section 6.2.1 and fig. 6.1; the poses are the authors' for a range of 2.5 m, the same for every field of
view, and scale with the range.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from coop_envs.errors import require

STRIDE_PER_RANGE = 0.8  # the authors move 2 m at a range of 2.5 m: to the edge of the scanned region, less a margin


class ScanPose(NamedTuple):
    """A robot's place (m) and heading (rad) during a scan."""

    x_m: float
    y_m: float
    heading_rad: float


class Scan(NamedTuple):
    """A pair's poses in one scan; the robots start along x from (0, 0). ``label`` is the time in fig. 6.1."""

    label: str
    robots: tuple[ScanPose, ScanPose]


def scan_sequence(steps: int, range_m: float = 2.5) -> tuple[Scan, ...]:
    """The first ``steps`` scans of two robots that travel along x.

    In scans t0, t6, ... robot 0 looks ahead and robot 1 across its way; in t3, t9, ... robot 0, which has moved by a
    stride, looks across and robot 1 ahead. Then robot 1 moves by a stride.
    """
    require(steps >= 1, "steps", steps, "1 or more")
    require(range_m > 0, "range_m", range_m, "more than 0 m")
    stride = STRIDE_PER_RANGE * range_m
    quarter = math.pi / 2
    scans = []
    for step in range(steps):
        along, swapped = divmod(step, 2)
        first = ScanPose((along + swapped) * stride, 0.0, quarter * swapped)
        second = ScanPose((along + 0.5) * stride, stride, quarter * (swapped - 1))
        scans.append(Scan(f"t{3 * step}", (first, second)))
    return tuple(scans)

"""What lasers and cameras measured: points, how sure they are, and which robots had a part in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Scan:
    """k measured points.

    points_m
        (k, 3) in the world frame, brought there from the team frame as the belief's poses are.
    point_sigma_m
        (k,) root of the trace of each point's covariance.
    point_robots
        (k, 3) index of the robot whose laser was lit, -1 where nobody knows, and of the two whose cameras saw the spot.
    point_eyes_m
        (k, 2, 3) where those two cameras were, in the world frame.
    """

    points_m: NDArray[np.float64]
    point_sigma_m: NDArray[np.float64]
    point_robots: NDArray[np.int16]
    point_eyes_m: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.points_m)

    @classmethod
    def joined(cls, scans: Sequence[Scan]) -> Scan:
        """All points of several scans, in their order."""
        parts = scans or (NO_SCAN,)
        return cls(*(np.concatenate([getattr(scan, entry.name) for scan in parts]) for entry in fields(cls)))


NO_SCAN = Scan(np.empty((0, 3)), np.empty(0), np.empty((0, 3), dtype=np.int16), np.empty((0, 2, 3)))

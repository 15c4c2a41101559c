"""The filter's covariance as rows of 15 numbers for each robot: what a compiler makes vector instructions of."""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import ERROR_STATES, Belief

MOST_ROWS = 6


class vec15d(wp.types.vector(length=ERROR_STATES, dtype=wp.float64)):  # noqa: N801 - a Warp type, named as Warp's own
    """Fifteen numbers in double precision: a row's entries that belong to one slot."""


@wp.struct
class Rows:
    """Arrays over B teams and S slots.

    covariance
        (B, 15 S, S) `Belief.covariance`, the same memory.
    projected
        (B, 6, S) H P of the update at hand, then L^-1 H P.
    entries
        (B, 6, 15 S) its entries, the same memory.
    """

    covariance: wp.array3d[vec15d]
    projected: wp.array3d[vec15d]
    entries: wp.array3d[wp.float64]


def allocate_rows(belief: Belief) -> Rows:
    """Rows over the covariance of a belief, which must outlive them."""
    teams, size, _ = belief.covariance.shape
    slots, device = size // ERROR_STATES, belief.covariance.device
    rows = Rows()
    shape = (teams, size, slots)
    rows.covariance = wp.array(ptr=belief.covariance.ptr, shape=shape, dtype=vec15d, device=device)
    rows.projected = wp.zeros((teams, MOST_ROWS, slots), dtype=vec15d, device=device)
    entries = (teams, MOST_ROWS, size)
    rows.entries = wp.array(ptr=rows.projected.ptr, shape=entries, dtype=wp.float64, device=device)
    return rows

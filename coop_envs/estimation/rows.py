"""The filter's covariance as rows of 15 numbers for each robot: what a compiler makes vector instructions of."""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import ERROR_STATES, Belief, vec15d

MOST_ROWS = 6
MOST_KEPT = 60
EFFECTS = wp.constant(3)


@wp.struct
class Rows:
    """Arrays over B teams and S slots.

    covariance
        (B, 15 S, S) `Belief.covariance`, the same memory.
    projected
        (B, 6, S) H P of the update at hand, then L^-1 H P.
    entries
        (B, 6, 15 S) its entries, the same memory.
    kept
        (B, K, S) rows N of sightings by which P has still to fall: P - N^T N is meant; ``pending`` (B,) of them.
    kept_entries
        (B, K, 15 S) their entries, the same memory.
    effect
        (B, 6, 3) how a sighting's pose moves with the states of its camera's calibration and of its hat's (two slots).
    effect_entries
        (B, 6, 45) its entries, the same memory.
    """

    covariance: wp.array3d[vec15d]
    projected: wp.array3d[vec15d]
    entries: wp.array3d[wp.float64]
    kept: wp.array3d[vec15d]
    kept_entries: wp.array3d[wp.float64]
    pending: wp.array[int]
    effect: wp.array3d[vec15d]
    effect_entries: wp.array3d[wp.float64]


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
    kept = min(MOST_KEPT, MOST_ROWS * max(belief.slot.shape[1] - 1, 1))
    rows.kept = wp.zeros((teams, kept, slots), dtype=vec15d, device=device)
    rows.kept_entries = wp.array(ptr=rows.kept.ptr, shape=(teams, kept, size), dtype=wp.float64, device=device)
    rows.pending = wp.zeros(teams, dtype=int, device=device)
    rows.effect = wp.zeros((teams, MOST_ROWS, EFFECTS), dtype=vec15d, device=device)
    entries = (teams, MOST_ROWS, ERROR_STATES * EFFECTS)
    rows.effect_entries = wp.array(ptr=rows.effect.ptr, shape=entries, dtype=wp.float64, device=device)
    return rows

"""What is true of a world's ground: where robots can stand, where they cannot go, what pickets could prove.

A node of the height field is passable if a chain of steps, each at most ``max_step_m`` up or down, leads to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.worlds.world import Hazard, HeightField, World

TOLERANCE_M = 1e-6
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TruthGrid:
    """Truth over cells (i, j) whose lower corners stand at ``origin_m + cell_m * (i, j)`` in the world.

    ``safe``: the centre is ground outside every trap and hole. ``obstacle``: the centre cannot be entered from the
    start. ``reachable``: free ground that a picket's contact disc can pass over, coming from the start.
    """

    origin_m: tuple[float, float]
    cell_m: float
    safe: Mask
    obstacle: Mask
    reachable: Mask


def truth_grid(
    world: World, body_radius_m: float, contact_radius_m: float, cell_m: float, max_step_m: float = 0.03
) -> TruthGrid:
    """Truth on a grid whose corners are multiples of ``cell_m``, for a picket of the given size."""
    start = world.starts[0][:2]
    ground = passable_ground(world.ground, start, max_step_m)
    clear = clear_nodes(world, ground, body_radius_m, contact_radius_m)
    proven = _dilated(connected(clear, nearest_node(world.ground, start)), contact_radius_m / world.ground.cell_m)
    corner, shape = grid_over(world.ground, cell_m)
    origin = np.array(corner, dtype=np.float64)
    i, j = (
        np.round((origin[k] + (np.arange(shape[k]) + 0.5) * cell_m - world.ground.origin_m[k]) / world.ground.cell_m)
        .astype(int)
        .clip(0, ground.shape[k] - 1)
        for k in (0, 1)
    )
    on_ground = ground[np.ix_(i, j)]
    centres = origin + (np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1) + 0.5) * cell_m
    harmless = hazard_margin_m(world.hazards, centres, 0.0) > 0
    reachable = proven[np.ix_(i, j)] & on_ground & harmless
    return TruthGrid(corner, cell_m, on_ground & harmless, ~on_ground, reachable)


def grid_over(ground: HeightField, cell_m: float) -> tuple[tuple[float, float], tuple[int, int]]:
    """Lower corner, a multiple of ``cell_m``, and shape of the grid of cells that covers the ground."""
    x_min, y_min, x_max, y_max = ground.bounds_m
    low = np.floor(np.array([x_min, y_min]) / cell_m + TOLERANCE_M)
    high = np.ceil(np.array([x_max, y_max]) / cell_m - TOLERANCE_M)
    nx, ny = (high - low).astype(int).tolist()
    return (float(low[0]) * cell_m, float(low[1]) * cell_m), (nx, ny)


def safe_path_exists(
    world: World, body_radius_m: float, contact_radius_m: float, max_step_m: float, margin_m: float = 0.0
) -> bool:
    """Whether a robot can drive from the first start to the goal, ``margin_m`` clear of walls and hazards."""
    if world.goal is None:
        return False
    ground = passable_ground(world.ground, world.starts[0][:2], max_step_m)
    clear = clear_nodes(world, ground, body_radius_m + margin_m, contact_radius_m + margin_m)
    reached = connected(clear, nearest_node(world.ground, world.starts[0][:2]))
    x, y, radius = world.goal
    dx, dy = (nodes - centre for nodes, centre in zip(node_axes_m(world.ground), (x, y), strict=True))
    return bool(np.any(reached & (dx[:, None] ** 2 + dy[None, :] ** 2 <= radius**2)))


def passable_ground(ground: HeightField, start_m: Sequence[float], max_step_m: float) -> Mask:
    """Nodes (nx, ny) that steps of at most ``max_step_m`` connect with the one nearest to ``start_m``."""
    labels = step_components(ground, max_step_m)
    node = nearest_node(ground, start_m)
    return (labels == labels[node]) & (labels > 0) if node is not None else np.zeros_like(labels, dtype=bool)


def step_components(ground: HeightField, max_step_m: float) -> NDArray[np.int32]:
    """Labels (nx, ny) of the parts of the ground that steps of at most ``max_step_m`` connect, 0 for no ground."""
    heights = ground.heights_m
    nx, ny = heights.shape
    links = np.zeros((2 * nx - 1, 2 * ny - 1), dtype=bool)
    links[::2, ::2] = np.isfinite(heights)
    with np.errstate(invalid="ignore"):
        links[1::2, ::2] = np.abs(np.diff(heights, axis=0)) <= max_step_m
        links[::2, 1::2] = np.abs(np.diff(heights, axis=1)) <= max_step_m
    return components(links)[::2, ::2]


def clearance_m(ground: Mask, cell_m: float) -> NDArray[np.float64]:
    """Distance (nx, ny) from each node to the nearest one that is not ground; beyond the edge there is none."""
    from scipy import ndimage

    return np.asarray(ndimage.distance_transform_edt(np.pad(ground, 1)))[1:-1, 1:-1] * cell_m


def clear_nodes(world: World, ground: Mask, body_radius_m: float, contact_radius_m: float) -> Mask:
    """Nodes where a robot's centre may be: its body clear of obstacles, its contact disc of hazards."""
    roomy = clearance_m(ground, world.ground.cell_m) >= body_radius_m - TOLERANCE_M
    xs, ys = node_axes_m(world.ground)
    clear = roomy.copy()
    for hazard in world.hazards:
        reach = float(np.hypot(*hazard.half_size_m)) + hazard.radius_m + contact_radius_m + world.ground.cell_m
        x, y = hazard.centre_m
        i, j = (slice(*np.searchsorted(axis, (at - reach, at + reach))) for axis, at in ((xs, x), (ys, y)))
        nodes = np.stack(np.meshgrid(xs[i], ys[j], indexing="ij"), axis=-1)
        clear[i, j] &= hazard_margin_m((hazard,), nodes, contact_radius_m) >= 0
    return clear


def hazard_margin_m(
    hazards: Sequence[Hazard], xy_m: NDArray[np.float64], contact_radius_m: float
) -> NDArray[np.float64]:
    """How far points (..., 2) are from being caught: traps and holes catch the contact disc."""
    margin = np.full(np.shape(xy_m)[:-1], np.inf)
    for hazard in hazards:
        if hazard.kind != "slippery":
            margin = np.minimum(margin, hazard.signed_distance_m(xy_m) - contact_radius_m)
    return margin


def connected(mask: Mask, node: tuple[int, int] | None) -> Mask:
    """The part of a mask that is 4-connected with a node."""
    if node is None or not mask[node]:
        return np.zeros_like(mask)
    labels = components(mask)
    return labels == labels[node]


def components(mask: Mask) -> NDArray[np.int32]:
    """Labels of the 4-connected parts, 0 outside."""
    from scipy import ndimage

    labels = np.zeros(mask.shape, dtype=np.int32)
    ndimage.label(mask, output=labels)
    return labels


def nearest_node(ground: HeightField, xy_m: Sequence[float]) -> tuple[int, int] | None:
    """Index of the node nearest to a point, None beyond the edge."""
    i, j = (round((float(xy_m[k]) - ground.origin_m[k]) / ground.cell_m) for k in (0, 1))
    nx, ny = ground.heights_m.shape
    return (i, j) if 0 <= i < nx and 0 <= j < ny else None


def node_axes_m(ground: HeightField) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World x of the node columns and y of the node rows."""
    nx, ny = ground.heights_m.shape
    return ground.origin_m[0] + ground.cell_m * np.arange(nx), ground.origin_m[1] + ground.cell_m * np.arange(ny)


def _dilated(mask: Mask, radius_nodes: float) -> Mask:
    from scipy import ndimage

    if not mask.any():
        return mask
    return np.asarray(ndimage.distance_transform_edt(~mask)) <= radius_nodes + TOLERANCE_M

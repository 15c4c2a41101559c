"""Where in an unknown building a team can start, and where hidden traps go."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import WorldError, require
from coop_envs.worlds.placement import Footprint, Formation, Pose, formation_poses
from coop_envs.worlds.truth import (
    Mask,
    clearance_m,
    components,
    connected,
    nearest_node,
    node_axes_m,
    passable_ground,
    step_components,
)
from coop_envs.worlds.world import Hazard, HeightField, World

FORMATIONS = (Formation(ahead_m=0.35, spacing_m=0.25), Formation(ahead_m=0.2, spacing_m=0.16))

MARGIN_M = 0.05
CANDIDATES_M = (0.25, 0.05)
HEADINGS = 32
SIGHT_M = 40.0
LEVEL_M = 0.1
TRIES = 200
GAP_M = 0.5
KEPT_SHARE = 0.9


@dataclass(frozen=True)
class Traps:
    """Hidden traps to lay out: how many, and (least, most) of their radius and of the walk to them from the start."""

    number: int
    radius_m: tuple[float, float]
    distance_m: tuple[float, float]


def require_traps(number: int, radius_m: tuple[float, float], distance_m: tuple[float, float]) -> None:
    """Refuse impossible settings of a geometry's ``hazards``, ``hazard_radius_m``, ``hazard_distance_m``."""
    require(number >= 0, "environment.geometry.hazards", number, "0 or more")
    for name, (least, most) in (("hazard_radius_m", radius_m), ("hazard_distance_m", distance_m)):
        require(0 < least <= most, f"environment.geometry.{name}", (least, most), "(least, most) above 0 m")


def sited(ground: HeightField, team: Sequence[Footprint], field: str, value: object) -> tuple[Pose, Formation]:
    """A start on the largest floor for the widest formation that fits anywhere.

    Raises: `WorldError` about ``field``, which has this ``value``, where no formation fits.
    """
    floor = largest_floor(ground, min(robot.max_step_m for robot in team))
    for formation in FORMATIONS:
        start = find_start(ground, floor, team, formation)
        if start is not None:
            return start, formation
    size = " x ".join(f"{(n - 1) * ground.cell_m:.2f}" for n in ground.heights_m.shape)
    active = sum(not robot.reserve for robot in team)
    needed = f"free level ground for {active} robots that need {passage_m(team):.2f} m to pass"
    raise WorldError(field, value, f"{needed}; none found in {size} m")


def with_traps(world: World, team: Sequence[Footprint], traps: Traps, rng: np.random.Generator) -> World:
    """The world with hidden traps drawn from ``rng`` on ground that its team can reach."""
    start = world.starts[0][:2]
    floor = passable_ground(world.ground, start, min(robot.max_step_m for robot in team))
    radii = (max(robot.body_radius_m for robot in team), max(robot.contact_radius_m for robot in team))
    numbers = (traps.number, traps.radius_m, traps.distance_m)
    return replace(world, hazards=world.hazards + hidden_traps(world.ground, floor, start, *numbers, radii, rng))


def largest_floor(ground: HeightField, max_step_m: float) -> Mask:
    """The largest part of the ground that steps of at most ``max_step_m`` connect."""
    return _largest(step_components(ground, max_step_m))


def passage_m(team: Sequence[Footprint]) -> float:
    """Width of way that the widest robot of a team should have at the start."""
    return 2 * (max(robot.body_radius_m for robot in team) + MARGIN_M)


def find_start(ground: HeightField, floor: Mask, team: Sequence[Footprint], formation: Formation) -> Pose | None:
    """The first observer's pose that looks furthest over level free ground, with room for the whole team.

    Candidates stand on the largest region that the widest robot can move in; on a fine grid where a coarse one holds
    none that fits. Returns None where no place takes the team.
    """
    clear = _largest(components(clearance_m(floor, ground.cell_m) >= passage_m(team) / 2))
    placeless = [replace(robot, start=None) for robot in team]
    offsets, _ = formation_poses(placeless, (0.0, 0.0, 0.0), formation)
    yaws = 2 * np.pi / HEADINGS * np.arange(HEADINGS, dtype=np.float64)
    xs, ys = node_axes_m(ground)
    for spacing_m in CANDIDATES_M:
        stride = max(round(spacing_m / ground.cell_m), 1)
        candidates = np.argwhere(clear[::stride, ::stride]) * stride
        fits = _fits(ground, clear, candidates, yaws, offsets)
        if fits.any():
            score = _free_sight_m(ground, clear, candidates, yaws, fits)
            best, heading = np.unravel_index(int(score.argmax()), score.shape)
            i, j = candidates[best]
            return float(xs[i]), float(ys[j]), math.remainder(float(yaws[heading]), math.tau)
    return None


def hidden_traps(
    ground: HeightField,
    floor: Mask,
    start_m: tuple[float, float],
    number: int,
    radius_m: tuple[float, float],
    distance_m: tuple[float, float],
    robot_m: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Hazard, ...]:
    """Round traps on ground the team can reach, a walk of ``distance_m`` (least, most) from the start.

    They stand where a robot of radii ``robot_m`` (body, contact) can go. A trap that would cut off more than a tenth
    of the ground is moved elsewhere; fewer traps come back where no more fit.
    """
    body_radius_m, contact_radius_m = robot_m
    reached = connected(clearance_m(floor, ground.cell_m) >= body_radius_m, nearest_node(ground, start_m))
    xs, ys = node_axes_m(ground)
    stride = max(int(2 * body_radius_m / ground.cell_m), 1)
    places = _walk(reached, nearest_node(ground, start_m), stride, *(d / ground.cell_m for d in distance_m))
    area = int(reached.sum())
    traps: list[Hazard] = []
    for _ in range(TRIES if len(places) else 0):
        if len(traps) == number:
            break
        i, j = places[rng.integers(len(places))]
        trap = Hazard("trap", (float(xs[i]), float(ys[j])), radius_m=float(rng.uniform(*radius_m)))
        too_near = math.dist(trap.centre_m, start_m) < distance_m[0] + trap.radius_m
        if too_near or any(math.dist(trap.centre_m, t.centre_m) < trap.radius_m + t.radius_m + GAP_M for t in traps):
            continue
        caught = np.hypot(xs[:, None] - xs[i], ys[None, :] - ys[j]) < trap.radius_m + contact_radius_m
        left = connected(reached & ~caught, nearest_node(ground, start_m))
        if left.sum() >= KEPT_SHARE * area:
            traps.append(trap)
            reached = left
    return tuple(traps)


def _walk(
    floor: Mask, start: tuple[int, int] | None, stride: int, least_nodes: float, most_nodes: float
) -> NDArray[np.intp]:
    """Nodes (n, 2) on every ``stride``-th line whose way from the start, along x and y, has a length in a range."""
    from scipy import ndimage

    if start is None:
        return np.zeros((0, 2), dtype=np.intp)
    offset = np.array(start) % stride
    coarse = floor[offset[0] :: stride, offset[1] :: stride]
    seed = np.zeros_like(coarse)
    seed[tuple(np.array(start) // stride)] = True
    near, far = (
        np.asarray(ndimage.binary_dilation(seed, mask=coarse, iterations=max(round(nodes / stride), 1)), dtype=bool)
        for nodes in (least_nodes, most_nodes)
    )
    return np.argwhere(far & ~near) * stride + offset


def _largest(labels: NDArray[np.int32]) -> Mask:
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return (labels == sizes.argmax()) & (labels > 0)


def _free_sight_m(
    ground: HeightField, clear: Mask, candidates: NDArray[np.intp], yaws: NDArray[np.float64], fits: Mask
) -> NDArray[np.float64]:
    """How far (candidates, yaws) one can go straight ahead on clear ground within ``LEVEL_M`` of the start's height.

    Only where ``fits``, elsewhere -1. Looks at every second node: clear ground has wider gaps.
    """
    directions = np.stack([np.cos(yaws), np.sin(yaws)], axis=-1)
    heights = ground.heights_m
    here = heights[candidates[:, 0], candidates[:, 1]]
    sight = np.where(fits, 0.0, -1.0)
    rows, columns = np.nonzero(fits)
    high = np.array(clear.shape) - 1
    for step in range(2, int(SIGHT_M / ground.cell_m), 2):
        node = np.rint(candidates[rows] + step * directions[columns]).astype(np.intp)
        i, j = np.clip(node, 0, high).T
        goes_on = np.all((node >= 0) & (node <= high), axis=1) & clear[i, j]
        goes_on &= np.abs(heights[i, j] - here[rows]) <= LEVEL_M
        rows, columns = rows[goes_on], columns[goes_on]
        if not len(rows):
            break
        sight[rows, columns] = step * ground.cell_m
    return sight


def _fits(
    ground: HeightField,
    clear: Mask,
    candidates: NDArray[np.intp],
    yaws: NDArray[np.float64],
    poses: Sequence[Pose],
) -> Mask:
    """Whether (candidates, yaws) has clear ground on the lines from the first observer to the team's poses."""
    samples = [np.linspace((0.0, 0.0), p[:2], max(int(math.hypot(*p[:2]) / ground.cell_m), 1) + 1) for p in poses]
    points = np.unique(np.concatenate(samples), axis=0) / ground.cell_m
    high = np.array(clear.shape) - 1
    fits = np.zeros((len(candidates), len(yaws)), dtype=bool)
    for k, yaw in enumerate(yaws):
        c, s = np.cos(yaw), np.sin(yaw)
        node = np.rint(candidates[:, None, :] + points @ np.array([[c, s], [-s, c]])).astype(np.intp)
        inside = np.all((node >= 0) & (node <= high), axis=(1, 2))
        i, j = np.moveaxis(np.clip(node, 0, high), -1, 0)
        fits[:, k] = inside & clear[i, j].all(axis=1)
    return fits

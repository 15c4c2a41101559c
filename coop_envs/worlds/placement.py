"""Where a team's robots stand at the start, and whether they can stand there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coop_envs.errors import WorldError
from coop_envs.worlds.truth import clearance_m, hazard_margin_m, nearest_node, passable_ground
from coop_envs.worlds.world import World

Pose = tuple[float, float, float]

PICKETS_PER_ROW = 3
HAT_HALF_WIDTH_M = 0.12
VIEW_HALF_RAD = 0.42


@dataclass(frozen=True)
class Footprint:
    """What a world needs to know of a robot to place it; ``start`` (x, y, yaw) overrides the world's choice.

    ``camera`` says whether it carries one: such robots need not be in the observer's view.
    """

    name: str
    observer: bool
    reserve: bool
    body_radius_m: float
    contact_radius_m: float
    max_step_m: float
    start: Pose | None = None
    camera: bool = False


@dataclass(frozen=True)
class Formation:
    """Observers abreast, pickets in rows ahead of them, at least ``ahead_m`` and ``spacing_m`` apart."""

    ahead_m: float = 0.20
    spacing_m: float = 0.16


def formation_length_m(team: Sequence[Footprint], formation: Formation) -> float:
    """Distance from the first observer to the front row of pickets."""
    rows = math.ceil(_active_pickets(team) / PICKETS_PER_ROW)
    return _ahead_m(team, formation) + max(rows - 1, 0) * formation.spacing_m


def formation_poses(team: Sequence[Footprint], anchor: Pose, formation: Formation) -> tuple[tuple[Pose, ...], Pose]:
    """A pose for each robot with the first observer at ``anchor``, and the dock: where the first picket starts.

    Reserves stand in the dock.
    """
    x, y, yaw = anchor
    c, s = math.cos(yaw), math.sin(yaw)

    def pose(offset: tuple[float, float]) -> Pose:
        return x + c * offset[0] - s * offset[1], y + s * offset[0] + c * offset[1], yaw

    places = [None if offset is None else pose(offset) for offset in _formation_offsets(team, formation)]
    front = (place for robot, place in zip(team, places, strict=True) if not robot.observer and place)
    dock = next(front, pose((formation.ahead_m, 0.0)))
    return tuple(robot.start or place or dock for robot, place in zip(team, places, strict=True)), dock


def check_placement(world: World, team: Sequence[Footprint]) -> None:
    """Refuse starts in walls, over edges, in hazards, in one another, or cut off from the first observer; and a goal
    that is no ground.

    Raises: `WorldError` naming the robot, its start and what is wrong with it.
    """
    active = [(robot, pose) for robot, pose in zip(team, world.starts, strict=True) if not robot.reserve]
    step = min(robot.max_step_m for robot in team)
    ground = passable_ground(world.ground, world.starts[0][:2], step)
    room = clearance_m(ground, world.ground.cell_m)
    for i, (robot, pose) in enumerate(active):
        field = f"team.{robot.name}.start" if robot.start else f"environment.geometry.start ({robot.name})"
        node = nearest_node(world.ground, pose[:2])
        if node is None or not ground[node]:
            height = _height_m(world, world.starts[0])
            expected = f"ground that steps a robot can climb join with observer_0's at z {height:.2f} m"
            raise WorldError(field, _short(pose), f"{expected}, here z {_height_m(world, pose):.2f} m")
        if room[node] + 1e-6 < robot.body_radius_m:
            expected = f"{robot.body_radius_m} m or more to walls and edges, here {room[node]:.3f} m"
            raise WorldError(field, _short(pose), expected)
        if hazard_margin_m(world.hazards, np.asarray(pose[:2]), robot.contact_radius_m) < 0:
            raise WorldError(field, _short(pose), "a place outside every trap and hole")
        for other, other_pose in active[:i]:
            distance = math.dist(pose[:2], other_pose[:2])
            if distance < robot.body_radius_m + other.body_radius_m:
                expected = f"{robot.body_radius_m + other.body_radius_m:.3f} m or more to {other.name}"
                raise WorldError(field, _short(pose), f"{expected}, here {distance:.3f} m")
    if world.goal is not None:
        node = nearest_node(world.ground, world.goal[:2])
        if node is None or not ground[node]:
            raise WorldError("environment.geometry.goal", _short(world.goal), "a place on the ground of the start")


def _formation_offsets(team: Sequence[Footprint], formation: Formation) -> list[tuple[float, float] | None]:
    """(forward, left) of each robot from the first observer, None for a reserve."""
    observers = [i for i, robot in enumerate(team) if robot.observer]
    pickets = [i for i, robot in enumerate(team) if not (robot.observer or robot.reserve)]
    offsets: list[tuple[float, float] | None] = [None] * len(team)
    for rank, i in enumerate(observers):
        offsets[i] = (0.0, formation.spacing_m * ((rank + 1) // 2) * (1 if rank % 2 else -1))
    ahead = _ahead_m(team, formation)
    for rank, i in enumerate(pickets):
        row, column = divmod(rank, PICKETS_PER_ROW)
        width = min(PICKETS_PER_ROW, len(pickets) - row * PICKETS_PER_ROW)
        offsets[i] = (ahead + row * formation.spacing_m, formation.spacing_m * ((width - 1) / 2 - column))
    return offsets


def _active_pickets(team: Sequence[Footprint]) -> int:
    return sum(not (robot.observer or robot.reserve) for robot in team)


def _ahead_m(team: Sequence[Footprint], formation: Formation) -> float:
    """Distance to the first row: far enough that the observer's camera sees the hats at its ends."""
    pickets = _active_pickets(team)
    if pickets < 2:
        return formation.ahead_m
    half_width = formation.spacing_m * (min(pickets, PICKETS_PER_ROW) - 1) / 2 + HAT_HALF_WIDTH_M
    return max(formation.ahead_m, round(half_width / math.tan(VIEW_HALF_RAD), 2))


def _height_m(world: World, pose: Pose) -> float:
    """Height of the ground, NaN where there is none."""
    node = nearest_node(world.ground, pose[:2])
    return math.nan if node is None else float(world.ground.heights_m[node])


def _short(pose: Pose) -> tuple[float, ...]:
    return tuple(round(float(value), 3) for value in pose)

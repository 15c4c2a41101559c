"""The worlds that a batch of teams draws from, their truth, and the plan of a team's start in each."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.team import Team
from coop_envs.estimation.estimator import Plan
from coop_envs.geometry.keyed_random import mix, team_key
from coop_envs.scenario import Environment, Scenario, environment_world
from coop_envs.worlds.build import Split
from coop_envs.worlds.height_map import HeightMapGeometry
from coop_envs.worlds.mesh_file import MeshFileGeometry, file_version
from coop_envs.worlds.solid import SolidColumns, solid_columns
from coop_envs.worlds.truth import TruthGrid, truth_grid
from coop_envs.worlds.world import World


@dataclass(frozen=True)
class WorldPool:
    """W worlds with their truth grids, and in each team frame: starts (W, N, 3), docks (W, 3), goals (W, 4).

    The map of a team in world w has ``map_cells[w]`` (W, 2) cells along x and y from ``corner[w]`` (W, 2) in the team
    frame; ``map_shape`` holds them all. ``solids`` is empty for teams without a laser, which map no volume.
    """

    worlds: tuple[World, ...]
    truth: tuple[TruthGrid, ...]
    solids: tuple[SolidColumns, ...]
    starts: NDArray[np.float32]
    docks: NDArray[np.float32]
    goals: NDArray[np.float32]
    corner: NDArray[np.float32]
    map_cells: NDArray[np.int32]

    @property
    def map_shape(self) -> tuple[int, int]:
        """The most cells along x and y."""
        nx, ny = self.map_cells.max(axis=0).tolist()
        return nx, ny

    def plan(self, worlds: NDArray[np.int32]) -> Plan:
        """What people know of the starts of teams in these worlds (B,)."""
        w = worlds
        return Plan(self.starts[w], self.docks[w], self.goals[w], self.corner[w], self.map_cells[w])


def open_pool(scenario: Scenario, split: Split, indices: Sequence[int]) -> WorldPool:
    """The worlds of the scenario with these indices."""
    geometry = scenario.environment.geometry
    version = file_version(geometry.path) if isinstance(geometry, MeshFileGeometry | HeightMapGeometry) else None
    asked = scenario.environment, scenario.team, scenario.map.cell_m, split
    pairs = [_world_and_truth(*asked, index, version) for index in indices]
    worlds, truth = tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs)
    n = len(scenario.team.members)
    spots = [(list(world.starts) + [world.dock] * n)[:n] for world in worlds]
    frames = [spot[0] for spot in spots]
    starts = [[_into(frame, pose) for pose in spot] for frame, spot in zip(frames, spots, strict=True)]
    docks = [_into(frame, world.dock) for frame, world in zip(frames, worlds, strict=True)]
    side = scenario.map.cell_m * scenario.map.ego_stride
    boxes = [_map_box(frame, world, side) for frame, world in zip(frames, worlds, strict=True)]
    return WorldPool(
        worlds=worlds,
        truth=truth,
        solids=tuple(_solids_of(_Surfaces(world), scenario.map.cell_m) for world in worlds) if _scans(scenario) else (),
        starts=np.array(starts, dtype=np.float32),
        docks=np.array(docks, dtype=np.float32),
        goals=np.array([_goal(frame, world) for frame, world in zip(frames, worlds, strict=True)], dtype=np.float32),
        corner=np.array([low * side for low, _ in boxes], dtype=np.float32),
        map_cells=np.array([(high - low) * scenario.map.ego_stride for low, high in boxes], dtype=np.int32),
    )


@functools.lru_cache(maxsize=512)
def _world_and_truth(
    environment: Environment,
    team: Team,
    cell_m: float,
    split: Split,
    index: int,
    version: tuple[int, int] | None,  # noqa: ARG001  another version of the world's file is another world
) -> tuple[World, TruthGrid]:
    """Kept, for worlds outlive scenarios: to change how robots sense or what they earn changes no world."""
    world = environment_world(environment, team, split, index)
    robots = [member.robot for member in team.members]
    truth = truth_grid(
        world,
        min(robot.body_radius_m for robot in robots),
        min(robot.contact_radius_m for robot in robots),
        cell_m,
        max(robot.max_step_m for robot in robots),
    )
    return world, truth


class _Surfaces:
    """A world as far as rays meet it: equal to another if both have the very same ground, mesh and first start.

    So the worlds of one mesh file, which differ in their hidden traps alone, share what is costly.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self._key = (id(world.ground), id(world.mesh), world.starts[:1])

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Surfaces) and self._key == other._key


@functools.lru_cache(maxsize=512)
def _solids_of(surfaces: _Surfaces, cell_m: float) -> SolidColumns:
    return solid_columns(surfaces.world, cell_m)


def _scans(scenario: Scenario) -> bool:
    return any(member.laser is not None for member in scenario.team.members)


def _into(frame: Sequence[float], pose: Sequence[float]) -> tuple[float, float, float]:
    """A world pose (x, y, yaw) in the frame of another."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    dx, dy = pose[0] - frame[0], pose[1] - frame[1]
    yaw = math.remainder(pose[2] - frame[2], math.tau)
    return c * dx + s * dy, c * dy - s * dx, yaw


def _goal(frame: Sequence[float], world: World) -> tuple[float, float, float, float]:
    if world.goal is None:
        return 0.0, 0.0, 0.0, 0.0
    x, y, _ = _into(frame, (world.goal[0], world.goal[1], 0.0))
    return x, y, world.goal[2], 1.0


def _map_box(frame: Sequence[float], world: World, side: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The world's bounds in a team frame, in whole squares of this side: lower and upper corner (2,)."""
    x0, y0, x1, y1 = world.ground.bounds_m
    corners = np.array([_into(frame, (x, y, 0.0))[:2] for x in (x0, x1) for y in (y0, y1)])
    low = np.floor(corners.min(axis=0) / side + 1e-6).astype(np.int64)
    return low, np.ceil(corners.max(axis=0) / side - 1e-6).astype(np.int64)


def world_index(seed: int, episode: int, num_worlds: int) -> int:
    """Which of the first ``num_worlds`` worlds an episode of the team with this seed takes place in."""
    return mix(team_key(seed, episode)) % num_worlds


def default_num_worlds(scenario: Scenario) -> int:
    """One world where the geometry is always the same or costly to build, else 32."""
    return 32 if scenario.environment.geometry.kind in ("random_arena", "ramp", "rubble", "building") else 1

"""Any triangle mesh (.ply, .obj, .stl) as a world."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from coop_envs.errors import WorldError, require
from coop_envs.validation import STRICT
from coop_envs.worlds.placement import Footprint, formation_poses
from coop_envs.worlds.raster import lowest_ground, single_valued
from coop_envs.worlds.siting import FORMATIONS, Traps, require_traps, sited, with_traps
from coop_envs.worlds.world import HeightField, Mesh, World

SUFFIXES = (".ply", ".obj", ".stl")
MOST_NODES = 16_000_000


@dataclass(frozen=True)
class MeshFileGeometry:
    """A mesh, z up, brought to metres by ``scale``; the ground is its lowest surface with ``headroom_m`` above it.

    ``start`` (x, y, yaw) is the first observer's pose; without it, the largest free ground's longest level view is
    found. ``goal`` is (x, y, radius) or none. A mesh shows no hazards, so ``hazards`` hidden traps are laid out by seed
    on reachable ground, a walk of ``hazard_distance_m`` (least, most) from the start.
    """

    __pydantic_config__ = STRICT
    path: str
    kind: Literal["mesh_file"] = "mesh_file"
    scale: float = 1.0
    headroom_m: float = 0.15
    hazards: int = 6
    hazard_radius_m: tuple[float, float] = (0.15, 0.3)
    hazard_distance_m: tuple[float, float] = (1.0, 8.0)
    start: tuple[float, float, float] | None = None
    goal: tuple[float, float, float] | None = None
    cell_m: float = 0.025

    def __post_init__(self) -> None:
        scale_fits = np.isfinite(self.scale) and self.scale > 0
        require(scale_fits, "environment.geometry.scale", self.scale, "a finite number above 0")
        require(self.headroom_m > 0, "environment.geometry.headroom_m", self.headroom_m, "more than 0 m")
        require_traps(self.hazards, self.hazard_radius_m, self.hazard_distance_m)
        require(0.005 <= self.cell_m <= 0.025, "environment.geometry.cell_m", self.cell_m, "0.005 to 0.025 m")

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World:
        """The mesh with its starts, the same each time, and traps drawn from ``rng``.

        Raises: `WorldError` for a mesh that is broken, empty, too large, or too narrow for the team.
        """
        world = _without_hazards(
            replace(self, path=str(Path(self.path).resolve())), tuple(team), file_version(self.path)
        )
        return with_traps(world, team, Traps(self.hazards, self.hazard_radius_m, self.hazard_distance_m), rng)


def load_mesh(path: str, scale: float = 1.0) -> Mesh:
    """A mesh file as vertices in metres and triangles.

    Raises: `WorldError` for a file that is missing, unreadable, empty, or holds numbers that are not finite.
    """
    field, file = "environment.geometry.path", Path(path)
    if file.suffix.lower() not in SUFFIXES:
        raise WorldError(field, path, f"a mesh file: {', '.join(SUFFIXES)}")
    if not file.is_file():
        raise WorldError(field, path, "a file that exists")
    vertices, faces = _read(file)
    if not len(vertices) or not len(faces):
        raise WorldError(field, path, f"a mesh with triangles, not {len(vertices)} vertices and {len(faces)} faces")
    broken = int(np.sum(~np.isfinite(vertices).all(axis=1)))
    if broken:
        raise WorldError(field, path, f"finite vertices, but {broken} of {len(vertices)} are NaN or infinite")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise WorldError(field, path, f"faces that use its {len(vertices)} vertices, 0 to {len(vertices) - 1}")
    return Mesh(np.ascontiguousarray(vertices * scale, dtype=np.float32), np.ascontiguousarray(faces, dtype=np.int32))


def _read(file: Path) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    try:
        loaded: Any = trimesh.load(str(file), force="mesh", process=False)
        return np.asarray(loaded.vertices, dtype=np.float64).reshape(-1, 3), np.asarray(loaded.faces).reshape(-1, 3)
    except Exception as error:  # noqa: BLE001 - trimesh raises whatever its parsers stumble over
        reason = " ".join(str(error).split()) or type(error).__name__
        raise WorldError("environment.geometry.path", str(file), f"a readable mesh ({reason})") from None


@functools.lru_cache(maxsize=8)
def _without_hazards(geometry: MeshFileGeometry, team: tuple[Footprint, ...], version: tuple[int, int]) -> World:
    """The world of a mesh and a team before hazards; ``version`` tells a changed file from the one remembered."""
    mesh, ground = _mesh_and_ground(geometry.path, geometry.scale, geometry.headroom_m, geometry.cell_m, version)
    start, formation = geometry.start, FORMATIONS[0]
    if start is None:
        start, formation = sited(ground, team, "environment.geometry.scale", geometry.scale)
    starts, dock = formation_poses(team, start, formation)
    return World(Path(geometry.path).stem, ground, mesh, (), starts, dock, geometry.goal)


@functools.lru_cache(maxsize=4)
def _mesh_and_ground(
    path: str, scale: float, headroom_m: float, cell_m: float, version: tuple[int, int]
) -> tuple[Mesh | None, HeightField]:
    """The mesh, None where it is single-valued, and its ground; ``version`` is there for the cache's key."""
    del version
    mesh = load_mesh(path, scale)
    width = float(np.min(np.ptp(mesh.vertices_m[:, :2], axis=0)))
    size = " x ".join(f"{side:.3g}" for side in np.ptp(mesh.vertices_m, axis=0))
    if width < 0.3:
        expected = f"one that makes {Path(path).name} 0.3 m or more each way for robots, not {size} m"
        raise WorldError("environment.geometry.scale", scale, expected)
    if np.prod(np.ptp(mesh.vertices_m[:, :2], axis=0).astype(np.float64) / cell_m + 1) > MOST_NODES:
        expected = f"one that makes {Path(path).name} at most 100 x 100 m, not {size} m; for mm, scale 0.001"
        raise WorldError("environment.geometry.scale", scale, expected)
    ground = lowest_ground(mesh, cell_m, headroom_m)
    if not np.isfinite(ground.heights_m).any():
        raise WorldError("environment.geometry.path", path, f"ground facing up (+z) with {headroom_m} m headroom")
    for array in (mesh.vertices_m, mesh.faces, ground.heights_m):
        array.flags.writeable = False
    return None if single_valued(mesh, ground) else mesh, ground


def file_version(path: str) -> tuple[int, int]:
    """What tells a changed file from the one remembered: time and size, zeros where there is none."""
    file = Path(path)
    status = file.stat() if file.is_file() else None
    return (status.st_mtime_ns, status.st_size) if status else (0, 0)

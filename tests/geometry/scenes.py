"""Ground to cast rays at, and the same surfaces as trimesh sees them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

from coop_envs.device import prepare
from coop_envs.geometry.terrain import Terrain
from coop_envs.simulation.parameters import pack_terrain
from coop_envs.worlds.world import HeightField, Mesh, World
from tests.geometry.kernels import heights_at, on_device, ranges, sight_lines

Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]
KEPT_ALIVE: list[object] = []


def sampled(surface: Surface, size_m: tuple[float, float], cell_m: float, origin_m=(0.0, 0.0)) -> HeightField:
    """A height field through z = surface(x, y)."""
    x, y = (o + cell_m * np.arange(round(s / cell_m) + 1) for o, s in zip(origin_m, size_m, strict=True))
    heights = surface(*np.meshgrid(x, y, indexing="ij"))
    return HeightField(heights.astype(np.float32), origin_m, cell_m)


def bumpy(seed: int, nodes=(30, 25), cell_m=0.02, amplitude_m=0.1, origin_m=(-0.3, 0.1)) -> HeightField:
    """Independent random heights at every node."""
    heights = np.random.default_rng(seed).uniform(0.0, amplitude_m, nodes)
    return HeightField(heights.astype(np.float32), origin_m, cell_m)


def world_of(ground: HeightField, mesh: trimesh.Trimesh | None = None) -> World:
    """A world with nothing but ground and, for rays, a mesh."""
    packed = None if mesh is None else Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))
    return World("scene", ground, packed, (), (), (0.0, 0.0, 0.0), None)


def terrain_of(*worlds: World) -> Terrain:
    """The worlds packed for the device."""
    terrain, meshes = pack_terrain(worlds, prepare("cpu"))
    KEPT_ALIVE.extend(meshes)
    return terrain


def surface_mesh(ground: HeightField, skirt_m: float = 10.0) -> trimesh.Trimesh:
    """The height field's own triangles, each cell split along (i, j+1)-(i+1, j), and a skirt down from its edge."""
    nx, ny = ground.heights_m.shape
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    xy = np.stack([i, j], axis=-1) * ground.cell_m + ground.origin_m
    vertices = np.concatenate([xy, ground.heights_m[..., None]], axis=-1).reshape(-1, 3)
    node = i * ny + j
    quads = [(node[:-1, :-1], node[1:, :-1], node[:-1, 1:], node[1:, 1:])]
    for edge in (node[0], node[-1], node[:, 0], node[:, -1]):
        top, below = edge, edge + nx * ny
        quads.append((top[:-1], top[1:], below[:-1], below[1:]))
    faces = [np.stack(corners, -1).reshape(-1, 3) for a, c, b, d in quads for corners in ((a, c, b), (d, b, c))]
    vertices = np.concatenate([vertices, vertices - [0.0, 0.0, skirt_m]])
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def cast(terrain: Terrain, start, direction, limit_m=100.0, world=0) -> np.ndarray:
    """Ranges of rays, infinite where they hit nothing."""
    rows = np.full(len(start), world, dtype=np.int32)
    start, direction = np.asarray(start, dtype=np.float32), np.asarray(direction, dtype=np.float32)
    found = on_device(ranges, terrain, rows, start, direction, limit_m).astype(float)
    return np.where(found < 0, np.inf, found)


def heights(terrain: Terrain, xy, world=0) -> np.ndarray:
    """Ground heights at points."""
    rows = np.full(len(xy), world, dtype=np.int32)
    return on_device(heights_at, terrain, rows, np.asarray(xy, dtype=np.float32)).astype(float)


def hidden(terrain: Terrain, a, b, slack_m=0.0, world=0) -> np.ndarray:
    """Whether something lies between the points."""
    rows = np.full(len(a), world, dtype=np.int32)
    ends = (np.asarray(p, dtype=np.float32) for p in (a, b))
    return on_device(sight_lines, terrain, rows, *ends, slack_m).astype(bool)


def true_ranges(mesh: trimesh.Trimesh, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """First intersections as trimesh finds them, infinite where there are none."""
    hits, ray, _ = mesh.ray.intersects_location(start, direction, multiple_hits=True)
    found = np.full(len(start), np.inf)
    np.minimum.at(found, ray, np.sum((hits - start[ray]) * direction[ray], axis=1))
    return found

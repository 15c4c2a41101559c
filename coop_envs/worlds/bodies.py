"""Triangle meshes of simple bodies, and of ground: what generated worlds with overhangs are made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coop_envs.worlds.world import HeightField, Mesh

BOX_FACES = np.array(
    [
        face
        for a, b, c, d in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
        for face in ((a, b, c), (a, c, d))
    ],
    dtype=np.int32,
)


def block(size_m: Sequence[float], centre_m: Sequence[float], R_world_block: NDArray[np.float64]) -> Mesh:
    """A closed box of this size, turned about its centre."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size_m
    vertices = corners @ R_world_block.T + np.asarray(centre_m)
    return Mesh(vertices.astype(np.float32), BOX_FACES)


def turned(yaw_rad: float, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> NDArray[np.float64]:
    """R_world_block that rolls, then pitches the block's x axis up, then yaws."""
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(a), np.sin(a)) for a in (yaw_rad, -pitch_rad, roll_rad))
    yaw = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return yaw @ pitch @ roll


def ground_mesh(ground: HeightField) -> Mesh:
    """The height field's own triangles, anticlockwise from above; cells that lack a corner are left out."""
    nx, ny = ground.heights_m.shape
    x, y = (ground.origin_m[k] + ground.cell_m * np.arange(n) for k, n in enumerate((nx, ny)))
    vertices = np.stack([*np.meshgrid(x, y, indexing="ij"), ground.heights_m], axis=-1).reshape(-1, 3)
    node = np.arange(nx * ny, dtype=np.int32).reshape(nx, ny)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:]))
    faces = np.concatenate([np.stack([a, c, b], axis=-1), np.stack([d, b, c], axis=-1)])
    whole = np.isfinite(vertices[:, 2])[faces].all(axis=1)
    return Mesh(np.nan_to_num(vertices).astype(np.float32), faces[whole])


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes[:-1])])
    faces = [mesh.faces + at for mesh, at in zip(meshes, first, strict=True)]
    return Mesh(np.concatenate([mesh.vertices_m for mesh in meshes]), np.concatenate(faces).astype(np.int32))

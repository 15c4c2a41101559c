"""Small teams and rooms that the tests of worlds share."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from coop_envs.worlds.placement import Footprint

OBSERVER = Footprint(
    "observer_0", observer=True, reserve=False, body_radius_m=0.07, contact_radius_m=0.05, max_step_m=0.015
)


def team_of(pickets: int, reserves: int = 0) -> tuple[Footprint, ...]:
    """One observer, ``pickets`` pickets and ``reserves`` more in the dock."""
    return (
        OBSERVER,
        *(
            Footprint(
                f"picket_{i}",
                observer=False,
                reserve=i >= pickets,
                body_radius_m=0.07,
                contact_radius_m=0.045,
                max_step_m=0.03,
            )
            for i in range(pickets + reserves)
        ),
    )


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and outward-facing triangles of an upright box."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return corners, np.array(faces)


def room(size_m: tuple[float, float], wall_m: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Floor slab (top at z = 0) of the given size with its lower corner at the origin, inside four 0.1 m walls."""
    x, y = size_m
    return joined(
        box((-0.1, -0.1, -0.1), (x + 0.1, y + 0.1, 0.0)),
        box((-0.1, -0.1, 0.0), (0.0, y + 0.1, wall_m)),
        box((x, -0.1, 0.0), (x + 0.1, y + 0.1, wall_m)),
        box((0.0, -0.1, 0.0), (x, 0.0, wall_m)),
        box((0.0, y, 0.0), (x, y + 0.1, wall_m)),
    )


def joined(*meshes: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Several meshes as one."""
    counts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    return (
        np.concatenate([vertices for vertices, _ in meshes]),
        np.concatenate([faces + count for (_, faces), count in zip(meshes, counts, strict=False)]),
    )


def written(path: Path, mesh: tuple[np.ndarray, np.ndarray], scale: float = 1.0) -> str:
    """The mesh in a file, in the format that the path's suffix names."""
    import trimesh

    trimesh.Trimesh(mesh[0] * scale, mesh[1], process=False).export(str(path))
    return str(path)

"""How far measured points lie from the surfaces that rays truly meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.worlds.bodies import ground_mesh
from coop_envs.worlds.world import HeightField, World

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FARTHEST_M = 1.0


@wp.kernel
def query_distance(mesh: wp.uint64, points: wp.array[wp.vec3], farthest: float, distance: wp.array[float]):
    """Distance of each point to a mesh, at most ``farthest``."""
    k = wp.tid()
    near = wp.mesh_query_point_no_sign(mesh, points[k], farthest)
    distance[k] = farthest
    if near.result:
        distance[k] = wp.length(wp.mesh_eval_position(mesh, near.face, near.u, near.v) - points[k])


def surface_distance_m(world: World, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance (k,) of points (k, 3) to the world's mesh or ground; what is farther than 1 m counts as 1 m."""
    if not len(points_m):
        return np.empty(0)
    surface = world.mesh or ground_mesh(_around(world.ground, points_m))
    corner = points_m.mean(axis=0)
    vertices = (surface.vertices_m - corner).astype(np.float32)
    if not len(surface.faces):
        return np.full(len(points_m), FARTHEST_M)
    mesh = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device="cpu"),
        indices=wp.array(surface.faces.ravel(), dtype=wp.int32, device="cpu"),
    )
    points = wp.array((points_m - corner).astype(np.float32), dtype=wp.vec3, device="cpu")
    distance = wp.zeros(len(points_m), dtype=float, device="cpu")
    wp.launch(query_distance, len(points_m), inputs=[mesh.id, points, FARTHEST_M, distance], device="cpu")
    return distance.numpy().astype(np.float64)


def _around(ground: HeightField, points_m: NDArray[np.float64]) -> HeightField:
    """The part of a ground within `FARTHEST_M` of any of these points, in x and in y."""
    low, high = points_m[:, :2].min(axis=0) - FARTHEST_M, points_m[:, :2].max(axis=0) + FARTHEST_M
    last = np.array(ground.heights_m.shape) - 1
    i, j = np.clip(np.floor((low - ground.origin_m) / ground.cell_m).astype(int), 0, last)
    u, v = np.clip(np.ceil((high - ground.origin_m) / ground.cell_m).astype(int), 0, last) + 1
    x, y = np.array(ground.origin_m) + np.array([i, j]) * ground.cell_m
    return replace(ground, heights_m=ground.heights_m[i:u, j:v], origin_m=(float(x), float(y)))

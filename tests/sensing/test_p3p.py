from __future__ import annotations

import cv2
import numpy as np
import poselib
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from coop_envs.device import prepare
from tests.sensing.kernels import mat43d, three_point_poses

COUNT = 2000


def poses(rays, points):
    """Depths (n, 4, 3), rotations (n, 4, 3, 3), positions (n, 4, 3) of a stack of triples (n, 3, 3)."""
    device, n = prepare("cpu"), len(rays)
    depths = wp.zeros(n, dtype=mat43d, device=device)
    rotation = wp.zeros((n, 4), dtype=wp.mat33d, device=device)
    position = wp.zeros((n, 4), dtype=wp.vec3d, device=device)
    given = [wp.array(a, dtype=wp.vec3d, device=device) for a in (rays, points)]
    wp.launch(three_point_poses, n, inputs=[*given, depths, rotation, position], device=device)
    return depths.numpy(), rotation.numpy(), position.numpy()


def scenes(seed=0, noise=0.0):
    """Triples before a camera: unit rays and points (n, 3, 3), true rotation and position."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.12, 0.12, (COUNT, 3, 3))
    R = Rotation.random(COUNT, rng=rng).as_matrix()
    p = np.column_stack([rng.uniform(-0.5, 0.5, (COUNT, 2)), np.ones(COUNT)]) * rng.uniform(0.3, 3.0, (COUNT, 1))
    seen = points @ R.transpose(0, 2, 1) + p[:, None]
    rays = seen / seen[..., 2:] + rng.normal(size=seen.shape) * [noise, noise, 0.0]
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True), points, R, p


def distance(R, p, rotations, positions):
    """Radians and metres from the nearest of several poses."""
    turns = np.linalg.norm(Rotation.from_matrix(rotations @ R.T).as_rotvec(), axis=-1)
    apart = turns + np.linalg.norm(positions - p, axis=-1)
    return apart.min(initial=np.inf)


def test_the_true_pose_is_among_the_solutions():
    rays, points, R, p = scenes()
    depths, rotations, positions = poses(rays, points)
    valid = depths[..., 0] > 0
    missed = [distance(R[i], p[i], rotations[i, valid[i]], positions[i, valid[i]]) for i in range(COUNT)]
    assert np.median(missed) < 1e-11
    assert np.mean(np.array(missed) < 1e-6) > 0.998


def test_every_solution_fits():
    rays, points, _, _ = scenes(noise=1e-3)
    depths, rotations, positions = poses(rays, points)
    i, k = np.nonzero(depths[..., 0] > 0)
    carried = np.einsum("nij,nkj->nki", rotations[i, k], points[i]) + positions[i, k, None]
    off = carried / np.linalg.norm(carried, axis=-1, keepdims=True) - rays[i]
    worst = np.abs(off).max(axis=(1, 2))
    assert np.median(worst) < 1e-14 and np.mean(worst < 1e-8) > 0.998
    np.testing.assert_allclose(np.linalg.det(rotations[i, k]), 1.0, atol=1e-9)


@pytest.mark.parametrize("theirs", ["poselib", "opencv"])
def test_solutions_are_those_of_others(theirs):
    rays, points, _, _ = scenes(seed=1, noise=1e-3)
    depths, rotations, positions = poses(rays, points)
    missed = []
    for i in range(500):
        valid = depths[i, :, 0] > 0
        for R, p in others(theirs, rays[i], points[i]):
            missed.append(distance(R, p, rotations[i, valid], positions[i, valid]))
    assert len(missed) > 500
    assert np.mean(np.array(missed) < 1e-4) > 0.99


def others(name, rays, points):
    """Poses by another library that fit the triple."""
    if name == "poselib":
        found = [(pose.R, pose.t) for pose in poselib.p3p(rays, points)]
    else:
        pixels = (rays[:, :2] / rays[:, 2:]).reshape(3, 1, 2)
        _, turns, shifts = cv2.solveP3P(points.reshape(3, 1, 3), pixels, np.eye(3), None, cv2.SOLVEPNP_AP3P)
        found = [(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True)]
    fitting = []
    for R, p in found:
        carried = points @ R.T + p
        off = carried / np.linalg.norm(carried, axis=-1, keepdims=True) - rays
        if np.abs(off).max() < 1e-7:
            fitting.append((R, p))
    return fitting


def test_triples_on_a_line_and_rays_that_coincide_give_no_nonsense():
    line = np.array([[[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.1, 0.0, 0.0]]])
    rays, _, _, _ = scenes()
    same = np.repeat(rays[:1, :1], 3, axis=1)
    for given in ((rays[:1], line), (same, scenes()[1][:1]), (np.full((1, 3, 3), np.nan), line)):
        depths, _, _ = poses(*given)
        assert np.all(np.isfinite(depths)) and np.all(depths >= 0)

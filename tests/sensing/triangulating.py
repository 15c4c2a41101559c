"""Spots seen by two cameras, drawn from known poses, pixels and calibrations, and kernels that triangulate them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from coop_envs.device import prepare
from coop_envs.sensing.bearings import Fix, Limits, SpotView
from coop_envs.sensing.camera import body_from_camera
from coop_envs.sensing.triangulation import mat1212d, midpoint, optimal

wp.set_module_options({"enable_backward": False})

LEVER = np.array([0.05, 0.0, 0.05])


@wp.kernel
def midpoints(
    a: wp.array[SpotView], b: wp.array[SpotView], joint: wp.array[mat1212d], limits: Limits, out: wp.array[Fix]
):
    i = wp.tid()
    out[i] = midpoint(a[i], b[i], joint[i], limits)


@wp.kernel
def optima(a: wp.array[SpotView], b: wp.array[SpotView], joint: wp.array[mat1212d], limits: Limits, out: wp.array[Fix]):
    i = wp.tid()
    out[i] = optimal(a[i], b[i], joint[i], limits)


METHODS = {"midpoint": midpoints, "optimal": optima}


@dataclass(frozen=True)
class Scene:
    """Two bodies (x, y, heading in the team frame, metres and radians), the spot and what is uncertain about them.

    ``joint`` (12, 12) is the covariance of (theta_a, p_a, theta_b, p_b).
    """

    bodies: tuple[tuple[float, float, float], tuple[float, float, float]]
    point: tuple[float, float, float]
    joint: np.ndarray
    focal: tuple[float, float] = (680.0, 676.0)
    noise_px: float = 0.5
    focal_sigma: float = 0.0
    centre_sigma_px: float = 0.0

    @property
    def rotations(self) -> np.ndarray:
        """R_team_body (2, 3, 3)."""
        return Rotation.from_euler("zyx", [(yaw, 0.05, -0.03) for _, _, yaw in self.bodies]).as_matrix()

    @property
    def positions(self) -> np.ndarray:
        """p_team_body (2, 3)."""
        return np.array([(x, y, 0.02 * k) for k, (x, y, _) in enumerate(self.bodies)])


def drift(theta: float, p: float, shared: float = 0.0) -> np.ndarray:
    """A joint covariance of independent poses with these standard deviations (rad, m), and errors that both share."""
    own = np.diag(np.tile([theta**2] * 3 + [p**2] * 3, 2))
    both = np.tile(np.diag([theta**2] * 3 + [p**2] * 3), (2, 2))
    return (1 - shared) * own + shared * both


def images(R_team_body, p_team_body, point) -> np.ndarray:
    """Normalised image points (..., 2) of points seen from bodies at (R, p)."""
    R = R_team_body @ body_from_camera(0.0)
    seen = np.einsum("...ji,...j->...i", R, point - p_team_body - R_team_body @ LEVER)
    return seen[..., :2] / seen[..., 2:]


def exact(scene: Scene) -> np.ndarray:
    """What the two cameras see of the scene without any error: image points (2, 2)."""
    return images(scene.rotations, scene.positions, np.array(scene.point))


def drawn(scene: Scene, count: int, seed: int = 0) -> np.ndarray:
    """Image points (count, 2, 2) as the cameras may see them: truth drawn about the believed poses, noise on top."""
    rng = np.random.default_rng(seed)
    error = rng.multivariate_normal(np.zeros(12), scene.joint, count).reshape(count, 2, 6)
    turn = Rotation.from_rotvec(error[..., :3].reshape(-1, 3)).as_matrix().reshape(count, 2, 3, 3)
    xy = images(turn @ scene.rotations, scene.positions + error[..., 3:], np.array(scene.point))
    xy *= 1 + scene.focal_sigma * rng.normal(size=(count, 2, 1))
    pixel = scene.noise_px * rng.normal(size=xy.shape) + scene.centre_sigma_px * rng.normal(size=xy.shape)
    return xy + pixel / scene.focal


def directions(xy: np.ndarray) -> np.ndarray:
    """Unit directions (..., 3) in camera axes of normalised image points (..., 2)."""
    ray = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
    return ray / np.linalg.norm(ray, axis=-1, keepdims=True)


def views(scene: Scene, direction: np.ndarray, camera: int) -> wp.array:
    """The believed views (n,) of one camera, one for each direction (n, 3)."""
    entry: Any = np.zeros(len(direction), dtype=SpotView.numpy_dtype())
    entry["R_team_body"], entry["p_team_body"] = scene.rotations[camera], scene.positions[camera]
    entry["R_body_camera"], entry["p_body_camera"] = body_from_camera(0.0), LEVER
    entry["direction"], entry["focal"], entry["noise_px"] = direction, scene.focal, scene.noise_px
    entry["focal_sigma"], entry["centre_sigma_px"] = scene.focal_sigma, scene.centre_sigma_px
    return wp.array(entry, dtype=SpotView, device="cpu")


def limits(max_range=100.0, gap_gate=1e9, max_sigma=1e3) -> Limits:
    made = Limits()
    made.max_range, made.gap_gate, made.max_sigma = max_range, gap_gate, max_sigma
    return made


def fixes(scene: Scene, xy: np.ndarray, method: str, bounds: Limits | None = None) -> np.ndarray:
    """Structured array (n,) of point, covariance, answer for image points (n, 2, 2)."""
    return fixes_along(scene, directions(xy), method, bounds)


def fixes_along(scene: Scene, direction: np.ndarray, method: str, bounds: Limits | None = None) -> np.ndarray:
    """As `fixes`, of directions (n, 2, 3) in camera axes."""
    device = prepare("cpu")
    n = len(direction)
    joint = wp.array(np.broadcast_to(scene.joint, (n, 12, 12)).copy(), dtype=mat1212d, device=device)
    out = wp.zeros(n, dtype=Fix, device=device)
    seen = [views(scene, direction[:, k], k) for k in range(2)]
    wp.launch(METHODS[method], n, inputs=[*seen, joint, bounds or limits()], outputs=[out], device=device)
    return out.numpy()


def moved(scene: Scene, **changes) -> Scene:
    """The scene with some fields replaced."""
    return replace(scene, **changes)

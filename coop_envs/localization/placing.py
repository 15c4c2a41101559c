"""Placing a team in the world: three positions not in a line, or one pose, of any of its robots suffice.

What robots see of each other leaves the team's frame free to move in the world, six degrees for the whole group. The
first fixes settle them: a closed form finds ``T_world_team``, the belief is carried there with that frame's error added
to everybody's, and from then on fixes are plain updates of one robot (`estimation.fixes`).

The filter takes gravity along -z of whatever frame it works in, so z of the world must point up. Who trusts that to
``level_rad`` needs but two positions apart in the ground plane.

Source: thesis section 4.1.2; Horn, "Closed-form solution of absolute orientation", 1987, in Kabsch's form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_envs.estimation.fixes import FixFuser
from coop_envs.estimation.team_filter import Snapshot, TeamFilter

Array = NDArray[np.float64]

ERROR_STATES = 15
OPEN_RAD, OPEN_M = 3.0, 100.0
"""Standard deviations of a frame of which nothing is known."""
VAGUE_RAD = 0.5
"""A rotation known no better cannot be linearised."""


@dataclass(frozen=True, eq=False)
class BodyFix:
    """A robot's position (3,) or, with ``rotation`` (3, 3), pose in the world.

    ``covariance`` (3, 3), or (6, 6) of (theta, p), the rotation's error from the left, world axes.
    """

    robot: int
    position: Array
    rotation: Array | None
    covariance: Array


@dataclass(frozen=True, eq=False)
class Placement:
    """p_world = rotation @ p_team + position, with the covariance (6, 6) of its errors (theta, p), theta from the left:
    p_world moves by theta x (rotation @ p_team) + p.
    """

    rotation: Array
    position: Array
    covariance: Array


@dataclass(frozen=True)
class Unplaced:
    """Why fixes do not place a team."""

    reason: str


def skew(v: Array) -> Array:
    """Matrices (..., 3, 3) of the cross product with v (..., 3)."""
    K = np.zeros((*v.shape, 3))
    K[..., 2, 1], K[..., 0, 2], K[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    return K - np.swapaxes(K, -1, -2)


def place_by_pose(R_team: Array, p_team: Array, covariance_team: Array, fix: BodyFix) -> Placement:
    """The placement that one robot's pose in both frames gives; covariances (6, 6) of (theta, p)."""
    assert fix.rotation is not None
    R = fix.rotation @ R_team.T
    p = fix.position - R @ p_team
    J = np.eye(6)
    J[3:, :3] = skew(R @ p_team)
    own = np.kron(np.eye(2), R)
    return Placement(R, p, J @ (fix.covariance + own @ covariance_team @ own.T) @ J.T)


def place_by_points(
    p_team: Array, covariance_team: Array, p_world: Array, covariance_world: Array, level_rad: float | None = None
) -> Placement | Unplaced:
    """The placement that carries K points (K, 3) of the team onto where the world has them.

    ``covariance_team`` (3 K, 3 K) of all points together, ``covariance_world`` (K, 3, 3). With ``level_rad`` z of both
    frames points up to so many radians. Weighted closed form, then Gauss-Newton for the full covariances.
    """
    if (missing := too_few(p_team, p_world, level_rad)) is not None:
        return missing
    K = len(p_team)
    blocks = covariance_team.reshape(K, 3, K, 3)[range(K), :, range(K), :]
    weight = 1.0 / np.maximum(np.trace(covariance_world + blocks, axis1=1, axis2=2), 1e-12)
    R, p = closed_form(p_team, p_world, weight, upright=level_rad is not None)
    covariance = np.zeros((6, 6))
    for _ in range(10):
        shift, covariance = _gauss_newton(R, p, p_team, covariance_team, p_world, covariance_world, level_rad)
        R, p = Rotation.from_rotvec(shift[:3]).as_matrix() @ R, p + shift[3:]
        if np.abs(shift).max() < 1e-10:
            break
    vague_rad = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    if vague_rad > VAGUE_RAD:
        return Unplaced(f"the positions leave the team's attitude open to {vague_rad:.2g} rad: too near to a line")
    return Placement(R, p, covariance)


def too_few(p_team: Array, p_world: Array, level_rad: float | None) -> Unplaced | None:
    """Why points (K, 3) cannot tell of a rotation, if so: too few, on one spot, in a line."""
    needed = 3 if level_rad is None else 2
    if len(p_team) < needed:
        return Unplaced(f"{len(p_team)} positions, where {needed} robots' are needed")
    axes = 3 if level_rad is None else 2
    for points in (p_team, p_world):
        spread = np.linalg.svd(points[:, :axes] - points[:, :axes].mean(0), compute_uv=False)
        if spread[needed - 2] < 1e-6 + 1e-6 * spread[0]:
            return Unplaced("the positions lie in a line" if level_rad is None else "the positions lie on one spot")
    return None


def closed_form(p_team: Array, p_world: Array, weight: Array, upright: bool) -> tuple[Array, Array]:
    """Rotation and shift that minimise the weighted (K,) squared distances; ``upright``: a rotation about z."""
    share = weight / weight.sum()
    middle_team, middle_world = share @ p_team, share @ p_world
    moment = (p_world - middle_world).T @ ((p_team - middle_team) * share[:, None])
    if upright:
        yaw = np.arctan2(moment[1, 0] - moment[0, 1], moment[0, 0] + moment[1, 1])
        R = Rotation.from_euler("z", yaw).as_matrix()
    else:
        U, _, Vt = np.linalg.svd(moment)
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return R, middle_world - R @ middle_team


def _gauss_newton(
    R: Array, p: Array, p_team: Array, P_team: Array, p_world: Array, P_world: Array, level_rad: float | None
) -> tuple[Array, Array]:
    """One step (6,) of (theta, p) and the covariance there."""
    K = len(p_team)
    turned = p_team @ R.T
    H = np.concatenate([-skew(turned), np.tile(np.eye(3), (K, 1, 1))], axis=2).reshape(3 * K, 6)
    axes = np.kron(np.eye(K), R)
    S = axes @ P_team @ axes.T
    S.reshape(K, 3, K, 3)[range(K), :, range(K), :] += P_world
    weighted = np.linalg.solve(S, H).T
    information, gradient = weighted @ H, weighted @ (p_world - turned - p).ravel()
    if level_rad is not None:
        tilt = np.cross([0.0, 0.0, 1.0], R[:, 2])[:2]
        information[:2, :2] += np.eye(2) / level_rad**2
        gradient[:2] -= tilt / level_rad**2
    scale = 1.0 / np.sqrt(np.diag(information))
    covariance = scale[:, None] * np.linalg.pinv(information * np.outer(scale, scale), hermitian=True) * scale
    return covariance @ gradient, covariance


def carried(belief: Snapshot, placement: Placement) -> Snapshot:
    """A belief of one team in another frame: states and covariance turned, that frame's error added to everybody's.

    P_world = T P T^T + N Sigma N^T, where N holds how each robot's errors follow the frame's: theta for its attitude,
    theta x p + p for its place, theta x v for its velocity.
    """
    R, p = placement.rotation, placement.position
    made = {name: array.copy() for name, array in belief.items()}
    for name, shift in (("position", p), ("first_position", p), ("velocity", 0.0), ("first_velocity", 0.0)):
        made[name] = belief[name] @ R.T + shift
    made["rotation"] = R @ belief["rotation"]
    T, N = np.eye(made["covariance"].shape[1]), np.zeros((made["covariance"].shape[1], 6))
    for r, slot in enumerate(belief["slot"][0]):
        G = gauge(R @ belief["position"][0, r], made["velocity"][0, r])
        if slot >= 0:
            row = ERROR_STATES * int(slot)
            T[row : row + 9, row : row + 9] = np.kron(np.eye(3), R)
            N[row : row + 9] = G
        axes, N6 = np.kron(np.eye(2), R), G[:6]
        kept = axes @ belief["pose_covariance"][0, r] @ axes.T + N6 @ placement.covariance @ N6.T
        made["pose_covariance"][0, r] = kept
    P = T @ belief["covariance"][0] @ T.T + N @ placement.covariance @ N.T
    made["covariance"][0] = 0.5 * (P + P.T)
    anchored = belief["anchor"].copy()
    anchored[..., 2] = 0.0
    made["anchor"][..., :2] = (anchored @ R.T + p)[..., :2]
    made["goal"][..., :2] = (np.append(belief["goal"][0, :2], 0.0) @ R.T + p)[:2]
    return made


def gauge(lever: Array, v: Array) -> Array:
    """How errors (theta, p) of a frame show in (theta, p, v) of a robot: (9, 6); ``lever`` from the frame's origin."""
    N = np.eye(9, 6)
    N[3:6, :3], N[6:9, :3] = -skew(lever), -skew(v)
    return N


def place(team: TeamFilter, fixes: Sequence[BodyFix], level_rad: float | None = None) -> Placement | Unplaced:
    """Carry the belief of one team into the world that its first fixes are given in, and fuse them there.

    All fixes hold now: the belief's present is their time. The frame enters as unknown (but for ``level_rad``), so that
    the fixes, fused one by one, leave what is jointly known of frame and robots, each counted once. Returns where the
    team was placed (before the fixes refined it), or why it was not; then nothing is changed.
    """
    before = team.snapshot()
    found = find_placement(before, fixes, level_rad)
    if isinstance(found, Unplaced):
        return found
    tilt_rad = OPEN_RAD if level_rad is None else level_rad
    R, p = found.rotation, found.position
    if level_rad is not None:
        upright = Rotation.from_euler("z", np.arctan2(R[1, 0], R[0, 0])).as_matrix()
        centre = before["position"][0].mean(0)
        R, p = upright, p + (R - upright) @ centre
    sigma = np.array([tilt_rad, tilt_rad, OPEN_RAD, OPEN_M, OPEN_M, OPEN_M])
    team.restore(carried(before, Placement(R, p, np.diag(sigma**2))))
    fuser = FixFuser(team.belief, team.rows)
    taken = [fuser.fuse(fix.robot, fix.position, fix.rotation, fix.covariance) for fix in fixes]
    if not all(taken):
        team.restore(before)
        return Unplaced("the fixes contradict each other or the team's own idea of its shape")
    return found


def find_placement(belief: Snapshot, fixes: Sequence[BodyFix], level_rad: float | None = None) -> Placement | Unplaced:
    """Where fixes put one team's frame: by the most certain pose if there is one, else by the positions."""
    known = [fix for fix in fixes if belief["slot"][0, fix.robot] >= 0]
    poses = [fix for fix in known if fix.rotation is not None]
    if poses:
        fix = min(poses, key=lambda fix: float(np.trace(fix.covariance)))
        r = fix.robot
        covariance = _block(belief, [r], np.arange(6))
        return place_by_pose(belief["rotation"][0, r], belief["position"][0, r], covariance, fix)
    robots = [fix.robot for fix in known]
    return place_by_points(
        belief["position"][0, robots],
        _block(belief, robots, np.arange(3, 6)),
        np.array([fix.position for fix in known]).reshape(-1, 3),
        np.array([fix.covariance for fix in known]).reshape(-1, 3, 3),
        level_rad,
    )


def _block(belief: Snapshot, robots: Sequence[int], states: NDArray[np.int64]) -> Array:
    """Covariance of some states of some robots, together."""
    rows = (ERROR_STATES * belief["slot"][0, list(robots)][:, None] + states).ravel()
    return belief["covariance"][0][np.ix_(rows, rows)]

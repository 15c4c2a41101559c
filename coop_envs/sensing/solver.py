"""From blobs of light to poses of hats: each hat in each camera's frame gets a pose with covariance, or a reason.

Hats share hues, so one hat's blobs may look like another's. The hat that is explained best takes its blobs, one whose
LEDs are all explained at once; the others are then solved without them.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import warp as wp

from coop_envs.geometry.arrays import allocate
from coop_envs.sensing.camera import CameraModel, bearing_d
from coop_envs.sensing.correspondence import MAX_CANDIDATES, SolverModel, collect, search_hat
from coop_envs.sensing.features import Features
from coop_envs.sensing.hats import MAX_LEDS, Hats
from coop_envs.sensing.leds import LedModel, pixel_noise
from coop_envs.sensing.measurements import Measurements
from coop_envs.sensing.poses import cholesky6, inverse_from_cholesky6
from coop_envs.sensing.refinement import Pose, Workspace, leds_used, linearised

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


class Answer(IntEnum):
    """What became of the search for a hat in a frame."""

    NOT_ASKED = 0
    POSE = 1
    TOO_FEW_LEDS = 2
    INCONSISTENT = 3
    AMBIGUOUS = 4
    OUT_OF_REACH = 5
    DIVERGED = 6
    CROWDED = 7


NOT_ASKED = wp.constant(int(Answer.NOT_ASKED))
POSE = wp.constant(int(Answer.POSE))
TOO_FEW_LEDS = wp.constant(int(Answer.TOO_FEW_LEDS))
INCONSISTENT = wp.constant(int(Answer.INCONSISTENT))
AMBIGUOUS = wp.constant(int(Answer.AMBIGUOUS))
OUT_OF_REACH = wp.constant(int(Answer.OUT_OF_REACH))
DIVERGED = wp.constant(int(Answer.DIVERGED))
CROWDED = wp.constant(int(Answer.CROWDED))
OPEN, POSE_FOUND, DOUBLE_FOUND = wp.constant(-1), wp.constant(-2), wp.constant(-3)


def allocate_workspace(teams: int, robots: int, blobs: int, device: str) -> Workspace:
    """Scratch for `solve_poses`."""
    shapes: dict[str, tuple[int, ...]] = {
        "candidates": (teams, robots, MAX_LEDS),
        "candidate": (teams, robots, MAX_LEDS, MAX_CANDIDATES),
        "pose": (teams, robots, robots),
    }
    return allocate(Workspace, (teams, robots, blobs), device, **shapes)


@wp.func
def prepare(camera: CameraModel, features: Features, work: Workspace, leds: LedModel, b: int, i: int):
    """Rays and noise of a frame's blobs, none of them claimed."""
    for k in range(features.count[b, i]):
        ray = bearing_d(camera, wp.vec2d(features.pixel[b, i, k]))
        work.ray[b, i, k] = ray
        work.sigma[b, i, k] = wp.float64(pixel_noise(leds, features.signal[b, i, k]))
        work.owner[b, i, k] = -1
        if wp.length_sq(ray) == wp.float64(0.0):
            work.owner[b, i, k] = i


@wp.func
def look_for(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, model: SolverModel, b: int, i: int, j: int,
    effort: int,
) -> int:  # fmt: skip
    """Search hat j among the unclaimed blobs; its best pose goes to the workspace."""
    found = collect(features, hats, work, model, b, i, j)
    if found < model.min_leds:
        return TOO_FEW_LEDS
    search = search_hat(camera, features, hats, work, model, b, i, j, effort, found)
    work.pose[b, i, j] = search.best
    if search.checks >= model.max_checks and search.best.inliers < hats.leds[j]:
        return CROWDED
    if search.best.inliers > 0:
        close = search.best.score - search.second.score < wp.float64(model.ambiguity)
        if search.second.inliers > 0 and close:
            return DOUBLE_FOUND
        return POSE_FOUND
    if search.diverged > 0:
        return DIVERGED
    if search.unreachable == search.solutions:
        return OUT_OF_REACH
    return INCONSISTENT


@wp.func
def claim(work: Workspace, answer: wp.array3d[int], b: int, i: int, j: int, robots: int):
    """Hat j takes its blobs; the search is opened again for hats that wanted one of them."""
    mine = work.pose[b, i, j].blob
    for k in range(8):
        if mine[k] >= 0:
            work.owner[b, i, mine[k]] = j
    for other in range(robots):
        if answer[b, i, other] == POSE_FOUND or answer[b, i, other] == DOUBLE_FOUND:
            theirs = work.pose[b, i, other].blob
            for k in range(8):
                if theirs[k] >= 0 and work.owner[b, i, theirs[k]] >= 0:
                    answer[b, i, other] = OPEN


@wp.func
def report(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, out: Measurements, b: int, i: int, j: int,
    pose: Pose,
) -> int:  # fmt: skip
    """Write a pose with its covariance."""
    fit = linearised(camera, features, hats, work, b, i, j, pose.rotation, pose.position, pose.blob)
    low = cholesky6(fit.information)
    if not low[0, 0] > wp.float64(0.0):
        return DIVERGED
    out.seen[b, i, j] = 1
    out.R_camera_body[b, i, j] = wp.mat33(pose.rotation)
    out.p_camera_body[b, i, j] = wp.vec3(pose.position)
    out.leds[b, i, j] = leds_used(pose.blob, hats.leds[j])
    out.covariance[b, i, j] = inverse_from_cholesky6(low)
    return POSE


@wp.func
def settle(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, out: Measurements, answer: wp.array3d[int],
    b: int, i: int, j: int, robots: int,
):  # fmt: skip
    """Hat j is where it was found, or in one of two places; its blobs are explained."""
    if answer[b, i, j] == POSE_FOUND:
        answer[b, i, j] = report(camera, features, hats, work, out, b, i, j, work.pose[b, i, j])
    else:
        answer[b, i, j] = AMBIGUOUS
    claim(work, answer, b, i, j, robots)


@wp.func
def best_found(work: Workspace, answer: wp.array3d[int], b: int, i: int, robots: int) -> int:
    """The hat whose pose explains its blobs best, of those not yet settled; -1 if there is none."""
    best = int(-1)
    score = wp.float64(-1.0)
    for j in range(robots):
        found = answer[b, i, j] == POSE_FOUND or answer[b, i, j] == DOUBLE_FOUND
        if found and work.pose[b, i, j].score > score:
            best = j
            score = work.pose[b, i, j].score
    return best


@wp.func
def reopen(answer: wp.array3d[int], b: int, i: int, robots: int):
    """Hats for which all tried triples failed may still have others."""
    for j in range(robots):
        a = answer[b, i, j]
        if a >= INCONSISTENT and a != AMBIGUOUS and a != CROWDED:
            answer[b, i, j] = OPEN


@wp.func
def search_open(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, model: SolverModel, out: Measurements,
    answer: wp.array3d[int], b: int, i: int, effort: int,
):  # fmt: skip
    """Search for every hat whose search is open; one whose LEDs are all explained is settled at once."""
    robots = hats.leds.shape[0]
    for j in range(robots):
        if answer[b, i, j] == OPEN:
            answer[b, i, j] = look_for(camera, features, hats, work, model, b, i, j, effort)
            if answer[b, i, j] == POSE_FOUND and work.pose[b, i, j].inliers >= hats.leds[j]:
                settle(camera, features, hats, work, out, answer, b, i, j, robots)


@wp.kernel
def solve_poses(
    features: Features, cameras: wp.array[CameraModel], hats: Hats, lit: wp.array2d[float], docked: wp.array2d[int],
    leds: LedModel, model: SolverModel, work: Workspace, out: Measurements, answer: wp.array3d[int],
    running: wp.array[int],
):  # fmt: skip
    """Poses of all lit hats from all cameras' blobs; one thread a team and camera.

    ``lit`` (B, N) is the brightness that each hat was told, ``answer`` (B, N, N) an `Answer`.
    """
    b, i = wp.tid()
    if running[b] == 0:
        return
    robots = hats.leds.shape[0]
    camera = cameras[i]
    for j in range(robots):
        out.seen[b, i, j] = 0
        asked = camera.fitted == 1 and i != j and hats.leds[j] > 0 and lit[b, j] > 0.0 and docked[b, j] == 0
        answer[b, i, j] = NOT_ASKED
        if asked:
            answer[b, i, j] = OPEN
    if camera.fitted == 0:
        return
    prepare(camera, features, work, leds, b, i)
    for effort in range(2):
        reopen(answer, b, i, robots)
        best = int(0)
        while best >= 0:
            search_open(camera, features, hats, work, model, out, answer, b, i, effort)
            best = best_found(work, answer, b, i, robots)
            if best >= 0:
                settle(camera, features, hats, work, out, answer, b, i, best, robots)


def solver_model(
    leds: LedModel,
    tolerance_px: float = 5.0,
    upright: float = 0.35,
    ambiguity: float = 4.0,
    max_checks: int = 4000,
) -> SolverModel:
    """Tolerances of the solver; back-projection tolerance as the authors set it (5 px)."""
    model: Any = SolverModel()
    model.hue_tolerance, model.tolerance_px, model.min_leds = leds.hue_tolerance, tolerance_px, leds.min_leds
    model.upright, model.ambiguity, model.max_checks = upright, ambiguity, max_checks
    return model

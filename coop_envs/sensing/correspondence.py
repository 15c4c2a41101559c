"""Which blobs are a hat's LEDs: every assignment that the hues allow, tested with P3P, the best by likelihood.

Blobs within a tolerance of an LED's hue are its candidates, as many as there are; any LED may be missing. All
assignments of three LEDs are solved, and each pose is checked against the other LEDs. A pose that explains four LEDs
explains all triples among them, so it is enough to try triples of which every four LEDs contain one: Turan's
construction, 6 of the 20 triples of six LEDs. Where many hats share hues, a pose that explains all LEDs of a hat ends
the search among other blobs than its own.

Source: thesis section 4.3.2.4, whose authors take the first consistent assignment; `assignments` is eq (4.15) as
corrected.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

from coop_envs.sensing.camera import CameraModel
from coop_envs.sensing.features import Features, hue_apart
from coop_envs.sensing.hats import Hats
from coop_envs.sensing.p3p import p3p_depths, triad
from coop_envs.sensing.refinement import NEAREST_M, Pose, Workspace, refined, vec8i

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

MAX_CANDIDATES = 16
CROWD = wp.constant(1000)
NEAR_COS = wp.constant(wp.float64(0.995))
NEAR_SHARE = wp.constant(wp.float64(0.05))
NOISES = wp.constant(wp.float64(5.0))


@wp.struct
class SolverModel:
    """Tolerances: of hues (degrees), of other LEDs' pixels under a P3P pose (px), of log-likelihoods between two poses.

    ``upright`` is the cosine of the most that a hat leans against the camera's robot, ``max_checks`` bounds the P3P
    problems solved for one hat.
    """

    hue_tolerance: float
    tolerance_px: float
    min_leds: int
    upright: float
    ambiguity: float
    max_checks: int


@wp.struct
class Search:
    """The best pose so far, the next best that is another one; P3P problems, their solutions, those out of reach."""

    best: Pose
    second: Pose
    checks: int
    crowded: int
    solutions: int
    unreachable: int
    diverged: int


@wp.func
def assignments(counts: vec8i) -> int:
    """How many ways there are to give each LED that has candidates one of them.

    Source: thesis eq (4.15) for evenly spread hues, its exponents swapped as they should be.
    """
    product = int(1)
    for k in range(8):
        product = product * wp.max(counts[k], 1)
    return product


@wp.func
def collect(features: Features, hats: Hats, work: Workspace, model: SolverModel, b: int, i: int, j: int) -> int:
    """List the unclaimed blobs of each LED's hue; how many LEDs have any."""
    found = int(0)
    for k in range(hats.leds[j]):
        n = int(0)
        for blob in range(features.count[b, i]):
            free = work.owner[b, i, blob] < 0 and n < work.candidate.shape[3]
            if free and hue_apart(features.hue[b, i, blob], hats.hue[j, k]) <= model.hue_tolerance:
                work.candidate[b, i, k, n] = blob
                n = n + 1
        work.candidates[b, i, k] = n
        found = found + int(n > 0)
    return found


@wp.func
def ranked(work: Workspace, b: int, i: int, leds: int) -> vec8i:
    """LEDs that have candidates, those with the fewest first; -1 beyond."""
    order = vec8i(-1, -1, -1, -1, -1, -1, -1, -1)
    n = int(0)
    for k in range(leds):
        count = work.candidates[b, i, k]
        if count > 0:
            place = n
            while place > 0 and work.candidates[b, i, wp.max(order[wp.max(place - 1, 0)], 0)] > count:
                order[place] = order[place - 1]
                place = place - 1
            order[place] = k
            n = n + 1
    return order


@wp.func
def in_turans_set(a: int, b: int, c: int) -> bool:
    """Whether a triple of ranks belongs to the few of which every four ranks contain one.

    Ranks fall into three groups; a triple is in if all are of one group, or two of one and one of the next.
    """
    x = a % 3
    y = b % 3
    z = c % 3
    if x == y and y == z:
        return True
    if x == y:
        return z == (x + 1) % 3
    if x == z:
        return y == (x + 1) % 3
    if y == z:
        return x == (y + 1) % 3
    return False


@wp.func
def near(a: Pose, b: Pose) -> bool:
    """Whether two poses are about the same."""
    cosine = (wp.trace(wp.transpose(a.rotation) * b.rotation) - wp.float64(1.0)) * wp.float64(0.5)
    return cosine > NEAR_COS and wp.length(a.position - b.position) < NEAR_SHARE * wp.length(a.position)


@wp.func
def explained(by: Pose, pose: Pose) -> bool:
    """Whether a pose is about one that is known, on no other blobs."""
    same = by.inliers > 0 and near(by, pose)
    for k in range(8):
        same = same and (pose.blob[k] < 0 or pose.blob[k] == by.blob[k])
    return same


@wp.func
def entered(search: Search, pose: Pose) -> Search:
    """The search with one more refined pose."""
    out = search
    if out.best.inliers == 0 or (near(out.best, pose) and pose.score > out.best.score):
        out.best = pose
    elif not near(out.best, pose):
        if pose.score > out.best.score:
            out.second = out.best
            out.best = pose
        elif out.second.inliers == 0 or pose.score > out.second.score:
            out.second = pose
    return out


@wp.func
def checked(
    camera: CameraModel, hats: Hats, work: Workspace, model: SolverModel, b: int, i: int, j: int, start: Pose,
    needed: int,
) -> Pose:  # fmt: skip
    """A P3P pose with each further LED given the nearest blob within tolerance; score -1 where they are too few."""
    out = Pose()
    out.rotation = start.rotation
    out.position = start.position
    out.inliers = 3
    blob = start.blob
    focal = wp.float64(0.5) * wp.float64(camera.focal[0] + camera.focal[1])
    open_leds = int(0)
    for k in range(hats.leds[j]):
        open_leds = open_leds + int(blob[k] < 0 and work.candidates[b, i, k] > 0)
    for k in range(hats.leds[j]):
        if blob[k] < 0 and work.candidates[b, i, k] > 0:
            if out.inliers + open_leds < needed:
                out.score = wp.float64(-1.0)
                return out
            open_leds = open_leds - 1
            p = start.rotation * wp.vec3d(hats.position[j, k]) + start.position
            if p[2] > NEAREST_M:
                ray = wp.normalize(p)
                nearest = wp.float64(1.0e9)
                which = int(-1)
                for c in range(work.candidates[b, i, k]):
                    at = work.candidate[b, i, k, c]
                    apart = focal * wp.length(ray - work.ray[b, i, at])
                    if apart < nearest and apart < wp.float64(model.tolerance_px) + NOISES * work.sigma[b, i, at]:
                        nearest = apart
                        which = at
                if which >= 0:
                    blob[k] = which
                    out.inliers = out.inliers + 1
    out.blob = blob
    if out.inliers < needed:
        out.score = wp.float64(-1.0)
    return out


@wp.func
def reachable(camera: CameraModel, model: SolverModel, pose: Pose) -> bool:
    """Whether a robot could stand so: upright, and within the camera's range."""
    up = wp.vec3d(wp.vec3(camera.R_body_camera[2, 0], camera.R_body_camera[2, 1], camera.R_body_camera[2, 2]))
    lean = wp.vec3d(pose.rotation[0, 2], pose.rotation[1, 2], pose.rotation[2, 2])
    upright = wp.dot(up, lean) >= wp.float64(model.upright)
    return upright and wp.length(pose.position) < wp.float64(1.3) * wp.float64(camera.max_range)


@wp.func
def try_depths(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, model: SolverModel, b: int, i: int, j: int,
    leds: wp.vec3i, blobs: wp.vec3i, body: wp.mat33d, depths: wp.vec3d, so_far: Search,
) -> Search:  # fmt: skip
    """Follow one solution of a P3P problem."""
    out = so_far
    out.solutions = out.solutions + 1
    first = work.ray[b, i, blobs[0]] * depths[0]
    axes = triad(first, work.ray[b, i, blobs[1]] * depths[1], work.ray[b, i, blobs[2]] * depths[2])
    pose = Pose()
    pose.rotation = axes * wp.transpose(body)
    pose.position = first - pose.rotation * wp.vec3d(hats.position[j, leds[0]])
    blob = vec8i(-1, -1, -1, -1, -1, -1, -1, -1)
    for k in range(3):
        blob[leds[k]] = blobs[k]
    pose.blob = blob
    if not reachable(camera, model, pose):
        out.unreachable = out.unreachable + 1
        return out
    needed = wp.max(model.min_leds, so_far.best.inliers - 1)
    rough = checked(camera, hats, work, model, b, i, j, pose, needed)
    if rough.score < wp.float64(0.0) or explained(so_far.best, rough) or explained(so_far.second, rough):
        return out
    fine = refined(camera, features, hats, work, b, i, j, rough)
    if fine.score < wp.float64(0.0):
        out.diverged = out.diverged + 1
    elif fine.inliers >= model.min_leds and reachable(camera, model, fine):
        out = entered(out, fine)
    return out


@wp.func
def try_triple(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, model: SolverModel, b: int, i: int, j: int,
    leds: wp.vec3i, so_far: Search,
) -> Search:  # fmt: skip
    """All assignments of blobs to three LEDs."""
    out = so_far
    x = wp.vec3d(hats.position[j, leds[0]])
    y = wp.vec3d(hats.position[j, leds[1]])
    z = wp.vec3d(hats.position[j, leds[2]])
    square = wp.vec3d(wp.length_sq(x - y), wp.length_sq(x - z), wp.length_sq(y - z))
    if wp.length_sq(wp.cross(y - x, z - x)) < wp.float64(1.0e-4) * square[0] * square[1]:
        return out
    body = triad(x, y, z)
    mine = out.best.blob
    settled = out.crowded == 1 and out.best.inliers == hats.leds[j]
    for a in range(work.candidates[b, i, leds[0]]):
        first = work.candidate[b, i, leds[0], a]
        for c in range(work.candidates[b, i, leds[1]]):
            second = work.candidate[b, i, leds[1], c]
            for e in range(work.candidates[b, i, leds[2]]):
                third = work.candidate[b, i, leds[2], e]
                worth = first != second and first != third and second != third and out.checks < model.max_checks
                if settled:
                    worth = worth and first == mine[leds[0]] and second == mine[leds[1]] and third == mine[leds[2]]
                if worth:
                    out.checks = out.checks + 1
                    u = work.ray[b, i, first]
                    v = work.ray[b, i, second]
                    w = work.ray[b, i, third]
                    depths = p3p_depths(square, wp.vec3d(wp.dot(u, v), wp.dot(u, w), wp.dot(v, w)))
                    for s in range(4):
                        if depths[s, 0] > wp.float64(0.0):
                            d = wp.vec3d(depths[s, 0], depths[s, 1], depths[s, 2])
                            blobs = wp.vec3i(first, second, third)
                            out = try_depths(
                                camera, features, hats, work, model, b, i, j, leds, blobs, body, d, out
                            )  # fmt: skip
    return out


@wp.func
def search_hat(
    camera: CameraModel, features: Features, hats: Hats, work: Workspace, model: SolverModel, b: int, i: int, j: int,
    effort: int, found: int,
) -> Search:  # fmt: skip
    """Search the triples of Turan's set (effort 0), or all others (effort 1), of the ``found`` LEDs with candidates."""
    out = Search()
    order = ranked(work, b, i, hats.leds[j])
    counts = vec8i()
    for k in range(hats.leds[j]):
        counts[k] = work.candidates[b, i, k]
    out.crowded = int(assignments(counts) > CROWD)
    for x in range(found - 2):
        for y in range(x + 1, found - 1):
            for z in range(y + 1, found):
                if in_turans_set(x, y, z) == (effort == 0):
                    leds = wp.vec3i(order[x], order[y], order[z])
                    out = try_triple(camera, features, hats, work, model, b, i, j, leds, out)
    return out

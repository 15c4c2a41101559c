from __future__ import annotations

import cv2
import gtsam
import numpy as np
import pytest
from scipy.linalg import block_diag, null_space
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from coop_envs.sensing.bearings import Answer
from coop_envs.sensing.camera import body_from_camera
from tests.sensing.triangulating import (
    LEVER,
    METHODS,
    Scene,
    directions,
    drawn,
    drift,
    exact,
    fixes,
    fixes_along,
    images,
    limits,
    moved,
)

APART_BODIES = ((0.0, 0.0, 0.3), (1.0, 2.0, -0.6))
SCENES = {
    "near": Scene(
        ((0.0, 0.0, 0.0), (1.0, 1.0, -1.5)),
        (1.0, 0.1, 0.2),
        drift(0.01, 0.01, 0.5),
        focal_sigma=0.01,
        centre_sigma_px=2.0,
    ),
    "far": Scene(APART_BODIES, (3.0, 0.5, 0.1), drift(0.01, 0.01, 0.5), focal_sigma=0.005, centre_sigma_px=1.0),
    "small baseline": Scene(
        ((0.0, 0.0, 0.3), (0.0, 0.5, 0.0)),
        (2.0, 0.4, 0.1),
        drift(0.002, 0.002, 0.9),
        focal_sigma=0.002,
        centre_sigma_px=0.5,
    ),
    "errors shared": Scene(APART_BODIES, (3.0, 0.5, 0.1), drift(0.02, 0.02, 0.95)),
    "one near, one far": Scene(((2.6, 0.0, 0.2), (0.0, 1.0, -0.2)), (3.0, 0.2, 0.1), drift(1e-4, 1e-4), noise_px=2.0),
}
DRAWS = 40000


def squared_errors(fix, scene):
    """Squared Mahalanobis distance (n,) of the fixes from the spot's true place."""
    error = fix["point"] - scene.point
    return np.einsum("ni,ni->n", error, np.linalg.solve(fix["covariance"], error[..., None])[..., 0])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_bearings_without_error_give_the_spot_itself(name, method):
    fix = fixes(SCENES[name], exact(SCENES[name])[None], method)
    assert fix["answer"][0] == Answer.OK
    np.testing.assert_allclose(fix["point"][0], SCENES[name].point, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_the_covariance_is_that_of_the_error(name, method):
    """Poses, pixels and calibrations drawn from their covariances: the squared distance has three degrees of freedom.

    Its mean over the draws scatters by sqrt(2 / (3 n)), here 0.4 %.
    """
    fix = fixes(SCENES[name], drawn(SCENES[name], DRAWS), method)
    assert np.all(fix["answer"] == Answer.OK)
    d2 = squared_errors(fix, SCENES[name])
    assert d2.mean() / 3 == pytest.approx(1.0, abs=0.05)
    assert np.mean(d2 < chi2.ppf(0.9, 3)) == pytest.approx(0.9, abs=0.02)


def rms_error(scene, xy, method):
    return np.sqrt(np.mean(np.sum((fixes(scene, xy, method)["point"] - scene.point) ** 2, axis=-1)))


@pytest.mark.parametrize("name", SCENES)
def test_the_optimal_method_errs_no_more_than_the_midpoint(name):
    """The draws are the same for both, which makes their errors comparable to a per mille."""
    xy = drawn(SCENES[name], DRAWS)
    ratio = rms_error(SCENES[name], xy, "optimal") / rms_error(SCENES[name], xy, "midpoint")
    assert ratio < (0.96 if name == "one near, one far" else 1.001)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_the_gate_turns_away_the_share_of_gaps_that_it_says(name, method):
    fix = fixes(SCENES[name], drawn(SCENES[name], DRAWS), method, limits(gap_gate=float(chi2.ppf(0.95, 1))))
    assert np.mean(fix["answer"] == Answer.APART) == pytest.approx(0.05, abs=0.005)


def camera_poses(scene):
    """R_team_camera (2, 3, 3) and centres (2, 3)."""
    return scene.rotations @ body_from_camera(0.0), scene.positions + scene.rotations @ LEVER


def perturbed(scene, errors):
    """Rotations and positions of the bodies turned and shifted by errors (12,)."""
    theta, delta = errors.reshape(2, 2, 3).swapaxes(0, 1)
    return Rotation.from_rotvec(theta).as_matrix() @ scene.rotations, scene.positions + delta


def slopes(function, size, h=1e-6):
    """Central differences of a function of a (size,) vector about zero, (outputs, size)."""
    return np.column_stack([(function(h * e) - function(-h * e)) / (2 * h) for e in np.eye(size)])


def image_covariance(scene, xy):
    """(4, 4) covariance of the image points by pixels, principal points and focal lengths."""
    blocks = []
    for point in xy:
        pixel = (scene.noise_px**2 + scene.centre_sigma_px**2) / np.square(scene.focal)
        blocks.append(np.diag(pixel) + scene.focal_sigma**2 * np.outer(point, point))
    return block_diag(*blocks)


def midpoint_by_hand(R_team_body, p_team_body, xy):
    """The point nearest to both rays, by linear least squares."""
    rows, right = [], []
    for R, p, ray in zip(R_team_body, p_team_body, directions(xy), strict=True):
        across = null_space((R @ body_from_camera(0.0) @ ray)[None]).T
        rows.append(across)
        right.append(across @ (p + R @ LEVER))
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]


def entangled(name):
    """A scene whose pose errors are correlated in every way, and bearings that miss each other."""
    factor = np.random.default_rng(7).normal(size=(12, 12)) * 2e-3
    scene = moved(SCENES[name], joint=factor @ factor.T)
    return scene, drawn(scene, 3, seed=5)


@pytest.mark.parametrize("name", SCENES)
def test_the_midpoint_and_its_covariance_are_those_of_finite_differences(name):
    scene, seen = entangled(name)
    for xy, fix in zip(seen, fixes(scene, seen, "midpoint"), strict=True):
        np.testing.assert_allclose(fix["point"], midpoint_by_hand(*perturbed(scene, np.zeros(12)), xy), atol=1e-9)
        by_pose = slopes(lambda e, xy=xy: midpoint_by_hand(*perturbed(scene, e), xy), 12)
        by_image = slopes(lambda e, xy=xy: midpoint_by_hand(*perturbed(scene, np.zeros(12)), xy + e.reshape(2, 2)), 4)
        expected = by_pose @ scene.joint @ by_pose.T + by_image @ image_covariance(scene, xy) @ by_image.T
        np.testing.assert_allclose(fix["covariance"], expected, rtol=1e-5, atol=1e-6 * np.trace(expected))


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("draw", range(3))
def test_the_optimal_point_minimises_the_weighted_error_and_has_its_curvature(name, draw):
    """With Jacobians by finite differences, weights from the whole covariance, and SciPy's minimiser."""
    scene, seen = entangled(name)
    xy, fix, nominal = seen[draw], fixes(scene, seen, "optimal")[draw], perturbed(scene, np.zeros(12))
    by_pose = slopes(lambda e: images(*perturbed(scene, e), fix["point"]).ravel(), 12)
    by_point = slopes(lambda e: images(*nominal, fix["point"] + e).ravel(), 3)
    S = by_pose @ scene.joint @ by_pose.T + image_covariance(scene, xy)
    expected = np.linalg.inv(by_point.T @ np.linalg.solve(S, by_point))
    np.testing.assert_allclose(fix["covariance"], expected, rtol=1e-3, atol=1e-4 * np.trace(expected))
    white = np.linalg.inv(np.linalg.cholesky(S))
    best = least_squares(lambda x: white @ (images(*nominal, x) - xy).ravel(), fix["point"], xtol=1e-12).x
    assert np.linalg.norm(fix["point"] - best) < 5e-3 * np.sqrt(np.trace(expected))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_opencv_finds_the_same_point(name, method):
    scene = SCENES[name]
    R, centres = camera_poses(scene)
    projections = [np.hstack([r.T, -(r.T @ c)[:, None]]) for r, c in zip(R, centres, strict=True)]
    point = np.array([scene.point])
    xy = [cv2.projectPoints(point, cv2.Rodrigues(P[:, :3])[0], P[:, 3], np.eye(3), None)[0][0, 0] for P in projections]
    homogeneous = cv2.triangulatePoints(projections[0], projections[1], xy[0][:, None], xy[1][:, None])[:, 0]
    fix = fixes(scene, np.array([xy]), method)
    np.testing.assert_allclose(fix["point"][0], homogeneous[:3] / homogeneous[3], atol=1e-9)


@pytest.mark.parametrize("name", SCENES)
def test_with_known_poses_gtsam_finds_the_same_optimum(name):
    """gtsam minimises pixel errors of equal weight, to which ours come down without other uncertainty."""
    scene = moved(SCENES[name], joint=np.zeros((12, 12)), focal_sigma=0.0, centre_sigma_px=0.0, noise_px=3.0)
    seen = drawn(scene, 20, seed=3)
    intrinsics = gtsam.Cal3_S2(*scene.focal, 0.0, 0.0, 0.0)
    poses = gtsam.Pose3Vector([gtsam.Pose3(gtsam.Rot3(R), c) for R, c in zip(*camera_poses(scene), strict=True)])
    noise = gtsam.noiseModel.Isotropic.Sigma(2, scene.noise_px)
    for xy, fix in zip(seen, fixes(scene, seen, "optimal"), strict=True):
        pixels = gtsam.Point2Vector(list(xy * scene.focal))
        found = gtsam.triangulatePoint3(poses, intrinsics, pixels, 1e-9, True, noise)
        assert np.linalg.norm(fix["point"] - found) < 5e-3 * np.sqrt(np.trace(fix["covariance"]))


def answer(scene, direction=None, method="optimal", **bounds):
    """Why there is no answer, or that there is one."""
    along = directions(exact(scene)) if direction is None else np.asarray(direction, dtype=float)
    fix = fixes_along(scene, along[None], method, limits(**bounds))[0]
    return Answer(fix["answer"])


@pytest.mark.parametrize("method", METHODS)
def test_every_reason_for_no_answer(method):
    scene = SCENES["far"]
    ahead, none = [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]
    seen = directions(exact(scene))
    assert answer(scene, method=method) is Answer.OK
    assert answer(scene, [seen[0], none], method) is Answer.NO_BEARING
    assert answer(scene, [seen[0], [np.nan] * 3], method) is Answer.NO_BEARING
    side_by_side = moved(scene, bodies=((0.0, 0.0, 0.0), (0.0, 0.5, 0.0)))
    assert answer(side_by_side, [ahead, ahead], method) is Answer.PARALLEL
    assert answer(scene, method=method, max_range=2.5) is Answer.TOO_FAR
    assert answer(scene, method=method, max_sigma=0.01) is Answer.UNCERTAIN
    high = directions(exact(scene) + [[0.0, 0.0], [0.0, -0.3]])
    assert answer(scene, high, method, gap_gate=6.63) is Answer.APART
    assert answer(moved(scene, joint=-np.eye(12)), method=method) is Answer.UNCERTAIN


@pytest.mark.parametrize("method", METHODS)
def test_one_camera_sees_the_spot_behind_the_other(method):
    scene = moved(SCENES["far"], bodies=((0.0, 0.0, 0.0), (0.0, 0.5, 0.0)))
    diverging = [directions(np.array([x, 0.0])) for x in (0.2, -0.2)]
    swapped = diverging[::-1]
    assert {answer(scene, diverging, method), answer(scene, swapped, method)} == {Answer.OK, Answer.BEHIND}

"""Poses of hats from blobs: against OpenCV and poselib, against generated truth, and every reason for no answer."""

from __future__ import annotations

import itertools
from dataclasses import replace

import cv2
import numpy as np
import poselib
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_hat, load_team
from coop_envs.agents.specification import Hat, Led
from coop_envs.sensing.solver import Answer
from tests.sensing.scenes import (
    AHEAD,
    CAMERA,
    HATS,
    LIFECAM,
    Blob,
    lights,
    matrix,
    positions,
    project,
    random_pose,
    solve,
)

SHORT = np.array([0.0, 0.0, 0.8])
BOARD = Hat("board", tuple(Led(90.0 * k, (0.0, 0.08 * (-1) ** k, 0.08 + 0.05 * (-1) ** (k // 2))) for k in range(4)))


def scene(rng, hats=HATS, camera=CAMERA, noise_px=0.5, **where):
    """A frame of these hats, shuffled, and their poses."""
    poses = [random_pose(rng, **where) for _ in hats]
    frame = []
    for hat, (R, p) in zip(hats, poses, strict=True):
        uv = project(camera, hat, R, p)
        frame += lights(hat, uv + rng.normal(size=uv.shape) * noise_px)
    rng.shuffle(frame)
    return frame, poses


def error(solution, b, h, pose):
    """(theta, delta) of a solved pose."""
    turn = Rotation.from_matrix(solution.R[b, h] @ pose[0].T).as_rotvec()
    return np.append(turn, solution.p[b, h] - pose[1])


@pytest.mark.parametrize("camera", [CAMERA, LIFECAM], ids=["ch6", "lifecam"])
def test_without_noise_poses_are_exact(camera):
    rng = np.random.default_rng(0)
    scenes = [scene(rng, camera=camera, noise_px=0.0) for _ in range(100)]
    found = solve([frame for frame, _ in scenes], camera=camera)
    for (b, (_, poses)), h in itertools.product(enumerate(scenes), range(2)):
        if found.answer[b, h] == Answer.POSE:
            assert np.abs(error(found, b, h, poses[h])).max() < 5e-5
    assert np.mean(found.answer == Answer.POSE) > 0.9


def test_errors_have_the_covariance_they_come_with():
    """Normalised error squared over 1200 poses of two mixed hats: chi-square with six degrees of freedom."""
    rng = np.random.default_rng(1)
    scenes = [scene(rng) for _ in range(600)]
    found = solve([frame for frame, _ in scenes])
    squares = []
    for (b, (_, poses)), h in itertools.product(enumerate(scenes), range(2)):
        if found.answer[b, h] == Answer.POSE:
            e = error(found, b, h, poses[h])
            squares.append(e @ np.linalg.solve(found.covariance[b, h], e))
    assert len(squares) > 1150
    low, high = stats.chi2(6 * len(squares)).ppf([1e-4, 1 - 1e-4])
    assert low < np.sum(squares) < high
    assert stats.kstest(squares, stats.chi2(6).cdf).pvalue > 1e-3


def test_dim_blobs_weigh_less():
    """LEDs of unequal signal: errors still have the covariance they come with."""
    rng = np.random.default_rng(2)
    signal = np.array([1.0, 0.05, 1.0, 0.05, 1.0, 0.3])
    growth = np.sqrt((1.0 + 0.25 / signal) / 1.25)
    squares = []
    frames, poses = [], []
    for _ in range(400):
        R, p = random_pose(rng, far_m=1.2)
        uv = project(CAMERA, HATS[0], R, p) + rng.normal(size=(6, 2)) * 0.5 * growth[:, None]
        frames.append([Blob(at, led.hue_deg, s) for at, led, s in zip(uv, HATS[0].leds, signal, strict=True)])
        poses.append((R, p))
    found = solve(frames, hats=HATS[:1])
    for b, pose in enumerate(poses):
        if found.answer[b, 0] == Answer.POSE:
            e = error(found, b, 0, pose)
            squares.append(e @ np.linalg.solve(found.covariance[b, 0], e))
    assert len(squares) > 380
    low, high = stats.chi2(6 * len(squares)).ppf([1e-4, 1 - 1e-4])
    assert low < np.sum(squares) < high


@pytest.mark.parametrize("camera", [CAMERA, LIFECAM], ids=["ch6", "lifecam"])
def test_the_minimum_is_that_of_opencv_and_poselib(camera):
    rng = np.random.default_rng(3)
    frames, pixels = [], []
    for _ in range(100):
        R, p = random_pose(rng)
        uv = project(camera, HATS[0], R, p) + rng.normal(size=(6, 2)) * 0.5
        uv = uv.astype(np.float32).astype(float)
        frames.append(lights(HATS[0], uv))
        pixels.append(uv)
    found = solve(frames, hats=HATS[:1], camera=camera)
    assert np.sum(found.answer == Answer.POSE) > 95
    for b in np.nonzero(found.answer[:, 0] == Answer.POSE)[0]:
        sigma = np.sqrt(np.diag(found.covariance[b, 0]))
        for R, p in refined_by_others(camera, pixels[b], found.R[b, 0], found.p[b, 0]):
            apart = error(found, b, 0, (R, p))
            assert np.all(np.abs(apart) < 0.01 * sigma + 2e-6), (b, apart / sigma)


def refined_by_others(camera, uv, R, p):
    """The pose where OpenCV's and poselib's refinements end from near a pose."""
    points, distortion = positions(HATS[0]), np.array(camera.distortion)
    off = Rotation.from_rotvec([0.01, -0.01, 0.01]).as_matrix()
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    turn, shift = cv2.solvePnPRefineLM(
        points, uv, matrix(camera), distortion, cv2.Rodrigues(off @ R)[0], 1.01 * p.reshape(3, 1), criteria
    )
    start = poselib.CameraPose()
    start.R, start.t = off @ R, 1.01 * p
    size = {"model": "FULL_OPENCV", "width": camera.width_px, "height": camera.height_px}
    k1, k2, p1, p2, k3 = camera.distortion
    params = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    options = {"max_iterations": 200, "loss_type": "TRIVIAL", "gradient_tol": 1e-14, "step_tol": 1e-14}
    pose, _ = poselib.refine_absolute_pose(uv, points, start, {**size, "params": params}, options)
    return [(cv2.Rodrigues(turn)[0], shift.ravel()), (pose.R, pose.t)]


def test_the_best_of_all_assignments_is_taken():
    """Against OpenCV on every one of the 64 ways to give one hat's LEDs the blobs of two."""
    rng = np.random.default_rng(4)
    hat = HATS[0]
    for _ in range(4):
        frame, _ = scene(rng, near_m=0.8, far_m=1.5)
        found = solve([frame], hats=(hat,))
        assert found.answer[0, 0] == Answer.POSE
        by_hue = [[blob.uv for blob in frame if blob.hue == led.hue_deg] for led in hat.leds]
        assert [len(c) for c in by_hue] == [2] * 6
        best, best_pose = np.inf, None
        for uv in itertools.product(*by_hue):
            uv = np.array(uv)
            _, turns, shifts, misfits = cv2.solvePnPGeneric(
                positions(hat), uv, matrix(CAMERA), None, flags=cv2.SOLVEPNP_SQPNP
            )
            for turn, shift, misfit in zip(turns, shifts, misfits.ravel(), strict=True):
                if misfit < best:
                    best, best_pose = misfit, (cv2.Rodrigues(turn)[0], shift.ravel())
        assert best < 1.5
        sigma = np.sqrt(np.diag(found.covariance[0, 0]))
        assert np.all(np.abs(error(found, 0, 0, best_pose)) < 0.5 * sigma + 1e-4)


def test_losses_and_other_lights_leave_the_pose_right():
    rng = np.random.default_rng(5)
    frames, poses = [], []
    for _ in range(300):
        frame, truth = scene(rng, hats=HATS[:1], near_m=0.5, far_m=1.5)
        del frame[:2]
        lamps = [Blob(rng.uniform([0, 0], [640, 480]), rng.uniform(0, 360)) for _ in range(6)]
        frames.append(frame + lamps)
        poses.append(truth[0])
    found = solve(frames, hats=HATS[:1])
    solved = found.answer[:, 0] == Answer.POSE
    assert solved.mean() > 0.85
    wrong = 0
    for b in np.nonzero(solved)[0]:
        e = error(found, b, 0, poses[b])
        wrong += e @ np.linalg.solve(found.covariance[b, 0], e) > 40.0
    assert wrong <= 3
    assert set(np.unique(found.answer)) <= {Answer.POSE, Answer.AMBIGUOUS, Answer.INCONSISTENT}


def test_red_is_red_on_both_sides_of_zero():
    rng = np.random.default_rng(6)
    frame, poses = scene(rng, hats=HATS[:1], near_m=0.6, far_m=0.8)
    for turn in (-12.0, 12.0):
        shifted = [replace(blob, hue=(blob.hue + turn) % 360.0) for blob in frame]
        found = solve([shifted], hats=HATS[:1])
        assert found.answer[0, 0] == Answer.POSE
        assert np.abs(error(found, 0, 0, poses[0])).max() < 0.1


def test_hats_of_one_shape_are_told_apart_by_their_colours():
    hats = [member.hat for member in load_team("scouts").members[1:7]]
    rng = np.random.default_rng(7)
    scenes = [scene(rng, hats=hats[:5]) for _ in range(20)]
    found = solve([frame for frame, _ in scenes], hats=hats)
    assert np.mean(found.answer[:, :5] == Answer.POSE) > 0.95
    assert not np.any(found.answer[:, 5] == Answer.POSE), "it is not there"
    for (b, (_, poses)), h in itertools.product(enumerate(scenes), range(5)):
        if found.answer[b, h] == Answer.POSE:
            assert np.linalg.norm(error(found, b, h, poses[h])[3:]) < 0.2


def test_a_hat_that_is_not_there_is_not_seen_in_the_blobs_of_another():
    rng = np.random.default_rng(8)
    frames = [scene(rng, hats=HATS[:1])[0] for _ in range(300)]
    found = solve(frames)
    assert np.all(found.answer[:, 0] == Answer.POSE)
    assert np.all(found.answer[:, 1] == Answer.TOO_FEW_LEDS)


def test_too_few_leds():
    R, p = AHEAD, SHORT
    frame = lights(HATS[0], project(CAMERA, HATS[0], R, p))
    assert solve([frame[:3]], hats=HATS[:1]).answer[0, 0] == Answer.TOO_FEW_LEDS
    assert solve([[]], hats=HATS[:1]).answer[0, 0] == Answer.TOO_FEW_LEDS
    colourless = [replace(blob, hue=30.0) for blob in frame]
    assert solve([colourless], hats=HATS[:1]).answer[0, 0] == Answer.TOO_FEW_LEDS


def test_no_consistent_assignment():
    """Lights of the right hues at random: no pose of the hat explains four of them."""
    rng = np.random.default_rng(9)
    frames = [lights(HATS[0], rng.uniform([100, 100], [540, 380], (6, 2))) for _ in range(100)]
    answers = solve(frames, hats=HATS[:1]).answer[:, 0]
    assert np.mean(np.isin(answers, [Answer.INCONSISTENT, Answer.OUT_OF_REACH])) > 0.97
    assert Answer.INCONSISTENT in answers


def test_two_poses_of_near_equal_likelihood_are_no_answer():
    """Four LEDs on an upright board, far away: it may be turned to the left or to the right."""
    turn = Rotation.from_euler("z", 0.4).as_matrix()
    frames = [lights(BOARD, project(CAMERA, BOARD, AHEAD @ turn, np.array([0.1, 0.1, d]))) for d in (0.4, 2.6)]
    answers = solve(frames, hats=(BOARD,)).answer[:, 0]
    assert list(answers) == [Answer.POSE, Answer.AMBIGUOUS]


def test_a_hat_on_its_head_or_beyond_the_range_is_out_of_reach():
    over = AHEAD @ Rotation.from_euler("x", np.pi).as_matrix()
    frames = [
        lights(HATS[0], project(CAMERA, HATS[0], over, SHORT)),
        lights(HATS[0], project(CAMERA, HATS[0], AHEAD, 10.0 * SHORT)),
    ]
    answers = solve(frames, hats=HATS[:1], noise_px=0.1).answer[:, 0]
    assert set(answers) <= {Answer.OUT_OF_REACH, Answer.INCONSISTENT, Answer.AMBIGUOUS}


def test_the_order_of_blobs_does_not_matter():
    rng = np.random.default_rng(10)
    frame, _ = scene(rng)
    found = solve([frame, frame[::-1]])
    assert np.all(found.answer == Answer.POSE)
    np.testing.assert_allclose(found.R[0], found.R[1], atol=1e-5)
    np.testing.assert_allclose(found.p[0], found.p[1], atol=1e-5)


def test_nonsense_in_an_image_is_survived():
    nan, inf = np.full(2, np.nan), np.full(2, np.inf)
    rng = np.random.default_rng(11)
    frame, _ = scene(rng, hats=HATS[:1], near_m=0.6, far_m=0.8)
    frame += [Blob(nan, 0.0), Blob(inf, 60.0), Blob(np.array([1e9, 0.0]), 120.0), Blob(frame[0].uv, frame[0].hue)]
    frame += [Blob(np.array([10.0, 10.0]), np.nan), Blob(np.array([20.0, 10.0]), 60.0, 0.0)]
    found = solve([frame], hats=HATS[:1])
    assert found.answer[0, 0] == Answer.POSE and np.all(np.isfinite(found.covariance[0, 0]))


def test_hats_whose_hues_lie_close_share_candidates():
    """Eight LEDs, 45 degrees apart: most blobs might be either of two LEDs."""
    zumy = load_hat("hat0")
    extra = (Led(0.0, (-0.05, 0.05, 0.12)), Led(0.0, (0.05, 0.02, 0.02)))
    places = [led.position_m for led in (*zumy.leds, *extra)]
    hat = Hat("eight", tuple(Led(45.0 * k, place) for k, place in enumerate(places)))
    rng = np.random.default_rng(12)
    scenes = [scene(rng, hats=(hat,), far_m=1.2) for _ in range(30)]
    frames = [[replace(blob, hue=blob.hue + rng.normal() * 8.0) for blob in frame] for frame, _ in scenes]
    found = solve(frames, hats=(hat,))
    assert np.mean(found.answer == Answer.POSE) > 0.9
    for b in np.nonzero(found.answer[:, 0] == Answer.POSE)[0]:
        e = error(found, b, 0, scenes[b][1][0])
        assert e @ np.linalg.solve(found.covariance[b, 0], e) < 40.0

"""Blobs found in drawn frames: where, of what hue, how bright; and a hat's pose through the whole chain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from coop_envs.errors import ConfigError
from coop_envs.sensing.solver import Answer
from hardware_bridge.cameras.detection import DetectionSettings, detect, find_blobs
from hardware_bridge.emulators.frame_drawing import FrameDrawer
from tests.sensing.scenes import CAMERA, HATS, LIFECAM, Blob, lights, project, random_pose, solve

SETTINGS = DetectionSettings()


def scattered(rng, signal, count=4):
    """Lights apart from one another."""
    column = 640 / count
    return [
        (rng.uniform(column * (k + 0.3), column * (k + 0.7)), rng.uniform(50, 430), rng.uniform(0, 360), signal)
        for k in range(count)
    ]


def paired(truth, found):
    """Errors (u px, v px, hue deg, signal ratio) of the lights that were found."""
    rows = []
    for u, v, hue, signal in found:
        near = min(truth, key=lambda light: np.hypot(light[0] - u, light[1] - v))
        rows.append((u - near[0], v - near[1], (hue - near[2] + 180) % 360 - 180, signal / near[3]))
    return np.array(rows)


@pytest.mark.parametrize("signal", [0.15, 0.3, 1.0, 6.0, 20.0])
def test_lights_are_found_where_they_are(signal):
    rng, drawer = np.random.default_rng(0), FrameDrawer(640, 480)
    errors = []
    for _ in range(15):
        truth = scattered(rng, signal)
        found = find_blobs(drawer.draw(truth), SETTINGS)
        assert len(found) == len(truth)
        errors.append(paired(truth, found))
    u, v, hue, ratio = np.concatenate(errors).T
    assert np.sqrt(np.mean(u**2 + v**2) / 2) < 0.1
    assert np.abs(hue).max() < 5.0
    assert np.all(np.abs(ratio - 1) < 0.15 if signal >= 1 else np.abs(ratio - 1) < 0.5)


@pytest.mark.parametrize("hue", [358.0, 359.5, 0.0, 0.5, 2.0])
def test_red_is_red_on_both_sides_of_zero(hue):
    frame = FrameDrawer(640, 480).draw([(100.3, 200.7, hue, 1.0)])
    [(_, _, found, _)] = find_blobs(frame, SETTINGS)
    assert 0 <= found < 360
    assert abs((found - hue + 180) % 360 - 180) < 2.0


def test_the_centre_of_a_single_lit_square_is_known_by_hand():
    """Rows 10 to 12 and columns 20 to 23, green: centre (21.5, 11), without any drawing of ours."""
    frame = np.zeros((480, 640, 3), dtype=np.uint8)
    frame[10:13, 20:24, 1] = 200
    [(u, v, hue, signal)] = find_blobs(frame, DetectionSettings(blur_sigma_px=0.0, full_light=200 * 12))
    assert (u, v, hue) == pytest.approx((21.5, 11.0, 120.0))
    assert signal == pytest.approx(1 / (1 - 63 / 200))


def test_what_is_too_dim_too_small_or_too_large_is_no_blob():
    frame = np.zeros((480, 640, 3), dtype=np.uint8)
    frame[100:110, 100:110] = 50
    frame[200, 200] = 255
    frame[300:400, 300:400] = 255
    assert find_blobs(frame, SETTINGS) == ()
    assert detect(1.0, frame, SETTINGS).spot is None


def test_the_brightest_is_first_and_is_the_spot():
    lights = [(100.0, 100.0, 0.0, 0.5), (300.0, 200.0, 120.0, 2.0), (500.0, 300.0, 240.0, 1.0)]
    frame = detect(3.5, FrameDrawer(640, 480).draw(lights), SETTINGS)
    assert frame.host_s == 3.5 and [round(blob[2] / 120) % 3 for blob in frame.blobs] == [1, 2, 0]
    assert frame.spot is not None and frame.spot[:2] == frame.blobs[0][:2]
    few = detect(0.0, FrameDrawer(640, 480).draw(lights), DetectionSettings(max_blobs=2))
    assert len(few.blobs) == 2


def test_a_frame_of_nothing_but_noise_is_survived():
    rng = np.random.default_rng(1)
    for low in (0, 128):
        frame = rng.integers(low, 256, (480, 640, 3), dtype=np.uint8)
        blobs = find_blobs(frame, DetectionSettings(min_area_px=1, blur_sigma_px=0.0, threshold=250))
        assert len(blobs) == 64 and np.all(np.isfinite(blobs))


@pytest.mark.parametrize("image", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3)), np.zeros((0, 4, 3), np.uint8)])
def test_other_images_are_refused(image):
    with pytest.raises(ConfigError, match=r"image: got .*, expected uint8 \(height, width, 3\)"):
        find_blobs(image, SETTINGS)


@pytest.mark.parametrize(
    "wrong",
    [{"threshold": 0}, {"min_area_px": 9, "max_area_px": 8}, {"blur_sigma_px": -1.0}, {"full_light": 0.0},
     {"max_blobs": 0}, {"spot_sigma_px": 0.0}],
)  # fmt: skip
def test_settings_are_checked(wrong):
    with pytest.raises(ConfigError, match="detection"):
        DetectionSettings(**wrong)


@pytest.mark.parametrize("camera", [CAMERA, LIFECAM], ids=["ch6", "lifecam"])
def test_a_hat_is_seen_where_it_stands(camera):
    """Drawn through OpenCV's projection, found as blobs, solved: within 1 cm and 2 degrees a metre away."""
    drawer, hat, rng = FrameDrawer(camera.width_px, camera.height_px), HATS[0], np.random.default_rng(2)
    frames, poses = [], []
    while len(poses) < 6:
        R, _ = random_pose(rng)
        p = np.array([rng.uniform(-0.2, 0.2), 0.1, 1.0])
        uv = project(camera, hat, R, p)
        if pdist(uv).min() > 12:  # lights that touch are one blob
            blobs = find_blobs(drawer.draw([(*blob.uv, blob.hue, 1.0) for blob in lights(hat, uv)]), SETTINGS)
            assert len(blobs) == len(hat.leds)
            frames.append([Blob(np.array(blob[:2]), blob[2], blob[3]) for blob in blobs])
            poses.append((R, p))
    solved = solve(frames, hats=(hat,), camera=camera)
    assert np.all(solved.answer == Answer.POSE)
    for b, (R, p) in enumerate(poses):
        assert np.linalg.norm(solved.p[b, 0] - p) < 0.01
        assert np.degrees(Rotation.from_matrix(solved.R[b, 0] @ R.T).magnitude()) < 2.0

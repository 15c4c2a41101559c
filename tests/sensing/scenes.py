"""Frames of LED blobs made by OpenCV, and the solver run on them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_camera, load_hat
from coop_envs.agents.specification import Camera, Hat
from coop_envs.device import prepare
from coop_envs.sensing.camera import CameraModel, camera_model
from coop_envs.sensing.features import allocate_features
from coop_envs.sensing.hats import pack_hats
from coop_envs.sensing.leds import LedModel
from coop_envs.sensing.measurements import allocate_measurements
from coop_envs.sensing.solver import Answer, allocate_workspace, solve_poses, solver_model

CAMERA = load_camera("ch6")
LIFECAM = load_camera("lifecam")
HATS = (load_hat("hat0"), load_hat("hat1"))
AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""R_camera_body of a robot that faces away from a level camera."""
BLOBS = 32


@dataclass(frozen=True)
class Blob:
    """One light in an image."""

    uv: NDArray[np.float64]
    hue: float
    signal: float = 1.0


@dataclass(frozen=True)
class Solution:
    """What the solver says of every hat (first axis: frame, second: hat)."""

    answer: NDArray[np.int32]
    R: NDArray[np.float64]
    p: NDArray[np.float64]
    covariance: NDArray[np.float64]


def matrix(camera: Camera) -> NDArray[np.float64]:
    """Intrinsics (3, 3)."""
    K: NDArray[np.float64] = np.zeros((3, 3), dtype=np.float64)
    K[0] = camera.fx_px, 0.0, camera.cx_px
    K[1] = 0.0, camera.fy_px, camera.cy_px
    K[2, 2] = 1.0
    return K


def positions(hat: Hat) -> NDArray[np.float64]:
    """LEDs (n, 3) as the device holds them."""
    return np.array([led.position_m for led in hat.leds], dtype=np.float32).astype(float)


def project(camera: Camera, hat: Hat, R, p) -> NDArray[np.float64]:
    """Pixels (n, 2) of a hat's LEDs."""
    turn, distortion = cv2.Rodrigues(np.asarray(R))[0], np.array(camera.distortion)
    uv = cv2.projectPoints(positions(hat), turn, p, matrix(camera), distortion)[0]
    return np.asarray(uv, dtype=np.float64).reshape(-1, 2)


def random_pose(rng, near_m=0.4, far_m=2.0):
    """R_camera_body and p_camera_body of a robot that stands somewhere in view, any heading, tilted a little."""
    turn = Rotation.from_euler("zyx", [rng.uniform(-np.pi, np.pi), *rng.normal(size=2) * 0.1]).as_matrix()
    depth = rng.uniform(near_m, far_m)
    return AHEAD @ turn, np.array([rng.uniform(-0.4, 0.4) * depth, rng.uniform(-0.1, 0.25) * depth, depth])


def lights(hat: Hat, uv, signal=1.0) -> list[Blob]:
    return [Blob(at, led.hue_deg, signal) for at, led in zip(uv, hat.leds, strict=True)]


def led_model(noise_px=0.5) -> LedModel:
    model = LedModel()
    model.hue_tolerance = 29.0
    model.noise_px, model.reference_range, model.detection_signal, model.min_leds = noise_px, 1.0, 0.05, 4
    return model


def solve(frames: list[list[Blob]], hats=HATS, camera: Camera = CAMERA, noise_px=0.5, **settings) -> Solution:
    """What camera 0 makes of each frame; robot r + 1 wears hat r."""
    device, teams, robots = prepare("cpu"), len(frames), len(hats) + 1
    features = allocate_features(teams, robots, BLOBS, device)
    pixel, hue, signal = features.pixel.numpy(), features.hue.numpy(), features.signal.numpy()
    for b, frame in enumerate(frames):
        features.count.numpy()[b, 0] = len(frame)
        for k, blob in enumerate(frame):
            pixel[b, 0, k], hue[b, 0, k], signal[b, 0, k] = blob.uv, blob.hue, blob.signal
    cameras = wp.array([camera_model(camera)] + [camera_model(None)] * len(hats), dtype=CameraModel)
    out = allocate_measurements(teams, robots, 1, device)
    answer = wp.zeros((teams, robots, robots), dtype=int, device=device)
    leds = led_model(noise_px)
    inputs = [
        features,
        cameras,
        pack_hats([(), *(hat.leds for hat in hats)], device),
        wp.ones((teams, robots), dtype=float, device=device),
        wp.zeros((teams, robots), dtype=int, device=device),
        leds,
        solver_model(leds, **settings),
        allocate_workspace(teams, robots, BLOBS, device),
        out,
        answer,
        wp.ones(teams, dtype=int, device=device),
    ]
    wp.launch(solve_poses, (teams, robots), inputs=inputs, device=device)
    answers = answer.numpy()[:, 0, 1:]
    np.testing.assert_array_equal(out.seen.numpy()[:, 0, 1:], answers == Answer.POSE)
    R, p = (a.numpy()[:, 0, 1:].astype(float) for a in (out.R_camera_body, out.p_camera_body))
    return Solution(answers, R, p, out.covariance.numpy()[:, 0, 1:])

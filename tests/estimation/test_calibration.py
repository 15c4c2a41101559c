"""Calibration states: their effect on poses against OpenCV's solver, and what the filter learns of them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from coop_envs.agents.catalog import load_team
from coop_envs.estimation.belief import Belief, MemberModel
from coop_envs.estimation.calibration import CENTRE, FOCAL, HAT_EFFECT, PLACE, TURN, Optics, Seen, find_effects
from coop_envs.estimation.rows import Rows
from tests.estimation.bench import Bench, transform

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

CAMERA, SEEN = 0, 1
SETTINGS = {"focal_sigma": 0.01, "centre_sigma_px": 2.0, "hat_sigma_m": 0.001, "lever_sigma_m": 0.002}
TEAM = load_team(
    {
        "members": [
            {"role": "observer", "robot": "zumy", "cameras": [{"base": "lifecam", "pitch_down_rad": 0.2}]},
            {"role": "picket", "robot": "zumy", "hat": "zumy"},
        ]
    }
)


@wp.kernel
def run_effects(
    belief: Belief, rows: Rows, optics: Optics, members: wp.array[MemberModel], R: wp.mat33d, p: wp.vec3d, leds: int
):
    seen = Seen()
    seen.j = 1
    seen.hat_slot = members[1].hat_slot
    seen.R = R
    seen.p = p
    seen.leds = leds
    find_effects(belief, rows, optics, members[0], members[1], 0, seen)


class Scene:
    """A hat before the camera, as OpenCV sees and solves it."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        camera, hat = TEAM.members[CAMERA].camera, TEAM.members[SEEN].hat
        assert camera and hat
        self.K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
        self.distortion = np.array(camera.distortion)
        self.leds = np.array([led.position_m for led in hat.leds])
        facing = Rotation.from_matrix([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
        self.R = (Rotation.from_rotvec(rng.normal(size=3) * 0.2) * facing).as_matrix()
        self.p = np.array([rng.uniform(-0.2, 0.2), rng.uniform(-0.1, 0.1), rng.uniform(0.5, 1.2)])

    def error(self, K: np.ndarray, leds: np.ndarray) -> np.ndarray:
        """(theta, delta) of the pose that OpenCV finds with what is believed, in an image of the truth."""
        image = cv2.projectPoints(leds, cv2.Rodrigues(self.R)[0], self.p, K, self.distortion)[0].reshape(-1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-14)
        start = [part.reshape(3, 1).copy() for part in (cv2.Rodrigues(self.R)[0], self.p)]
        rvec, tvec = cv2.solvePnPRefineLM(self.leds, image, self.K, self.distortion, start[0], start[1], criteria)
        theta = Rotation.from_matrix(cv2.Rodrigues(rvec)[0] @ self.R.T).as_rotvec()
        return np.array([*theta, *(tvec.ravel() - self.p)])


def effects_of(scene: Scene) -> np.ndarray:
    """(6, 45) by the filter."""
    bench = Bench(TEAM, settings=SETTINGS)
    bench.run(
        run_effects,
        bench.belief,
        bench.rows,
        bench.optics,
        bench.members,
        wp.mat33d(*scene.R.ravel()),
        wp.vec3d(*scene.p),
        0,
    )
    return bench.rows.effect_entries.numpy()[0].copy()


@pytest.mark.parametrize("seed", range(4))
def test_a_lens_that_is_off_moves_poses_as_opencv_finds(seed):
    scene = Scene(seed)
    effects = effects_of(scene)
    for column, change in (
        (FOCAL, np.diag([1.0, 1.0, 0.0]) @ scene.K * [1, 1, 0]),
        (CENTRE, [[0, 0, 1.0], [0] * 3, [0] * 3]),
    ):
        step = 1e-4 if column == FOCAL else 0.05
        slope = (
            scene.error(scene.K + step * np.array(change), scene.leds)
            - scene.error(scene.K - step * np.array(change), scene.leds)
        ) / (2 * step)
        np.testing.assert_allclose(effects[:, int(column)], slope, atol=2e-3 * np.abs(slope).max())


@pytest.mark.parametrize("seed", range(4))
def test_an_led_that_is_out_of_place_moves_poses_as_opencv_finds(seed):
    scene = Scene(seed)
    effects, step = effects_of(scene), 1e-4
    for k in range(5):
        for axis in range(3):
            shift = np.zeros((5, 3))
            shift[k, axis] = step
            slope = (scene.error(scene.K, scene.leds + shift) - scene.error(scene.K, scene.leds - shift)) / (2 * step)
            column = effects[:, 15 * HAT_EFFECT + 3 * k + axis]
            np.testing.assert_allclose(column, slope, atol=5e-3 * np.abs(slope).max())


def test_a_camera_that_sits_elsewhere_sees_robots_elsewhere():
    scene = Scene(0)
    effects = effects_of(scene)
    camera = TEAM.members[CAMERA].camera
    assert camera
    from coop_envs.sensing.camera import body_from_camera

    T_body_camera = transform(body_from_camera(camera.pitch_down_rad), camera.position_m)
    T_body_seen = T_body_camera @ transform(scene.R, scene.p)
    rng = np.random.default_rng(0)
    place, turn = rng.normal(size=3) * 1e-5, rng.normal(size=3) * 1e-5
    moved = transform(T_body_camera[:3, :3] @ Rotation.from_rotvec(turn).as_matrix(), T_body_camera[:3, 3] + place)
    T = np.linalg.inv(moved) @ T_body_seen
    theta = Rotation.from_matrix(T[:3, :3] @ scene.R.T).as_rotvec()
    found = effects[:, PLACE : PLACE + 3] @ place + effects[:, TURN : TURN + 3] @ turn
    np.testing.assert_allclose(found, [*theta, *(T[:3, 3] - scene.p)], atol=1e-9)

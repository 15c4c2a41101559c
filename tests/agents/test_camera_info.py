from __future__ import annotations

import pytest
import yaml

from coop_envs.agents.catalog import load_camera, load_team
from coop_envs.errors import ConfigError

INFO = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "narrow_stereo/left",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [438.78, 0.0, 305.59, 0.0, 437.33, 243.74, 0.0, 0.0, 1.0]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.3619, 0.1614, -0.0007, 0.0003, 0.0]},
    "rectification_matrix": {"rows": 3, "cols": 3, "data": [1, 0, 0, 0, 1, 0, 0, 0, 1]},
    "projection_matrix": {"rows": 3, "cols": 4, "data": [393.6, 0, 322.8, 0, 0, 393.6, 241.1, 0, 0, 0, 1, 0]},
}


def written(tmp_path, **changes):
    """A calibration file; an entry changed to None is left out."""
    info = {k: v for k, v in {**INFO, **changes}.items() if v is not None}
    path = tmp_path / "left.yaml"
    path.write_text(yaml.safe_dump(info))
    return str(path)


def test_a_calibration_file_is_a_camera(tmp_path):
    camera = load_camera({"file": written(tmp_path), "position_m": [0.0, 0.0, 0.2], "max_range_m": 2.0})
    assert (camera.name, camera.width_px, camera.height_px) == ("narrow_stereo/left", 640, 480)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == (438.78, 437.33, 305.59, 243.74)
    assert camera.distortion == (-0.3619, 0.1614, -0.0007, 0.0003, 0.0)
    assert camera.position_m == (0.0, 0.0, 0.2)
    mounted = load_camera({"base": "lifecam_mast", "file": written(tmp_path)})
    assert mounted.fx_px == 438.78 and mounted.pitch_down_rad == load_camera("lifecam_mast").pitch_down_rad


def test_a_team_takes_a_calibration_file(tmp_path):
    member = {"role": "observer", "robot": "zumy", "cameras": [{"file": written(tmp_path)}]}
    camera = load_team({"members": [member]}).members[0].camera
    assert camera is not None and camera.fx_px == 438.78


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"image_width": None}, "image_width: got None, expected a whole number of pixels"),
        ({"image_height": 480.5}, "image_height: got 480.5"),
        ({"camera_matrix": None}, "camera_matrix: got None, expected a mapping whose 'data' lists 9 numbers"),
        ({"camera_matrix": {"data": [1, 2]}}, "camera_matrix: got"),
        ({"camera_matrix": {"data": [1, 0.1, 2, 0, 1, 2, 0, 0, 1]}}, "camera_matrix: got"),
        ({"distortion_coefficients": {"data": [0, 0, 0, 0]}}, "distortion_coefficients: got"),
        ({"distortion_coefficients": {"data": [0, 0, 0, 0, "k"]}}, "distortion_coefficients: got"),
        ({"distortion_model": "equidistant"}, "distortion_model: got 'equidistant', expected plumb_bob"),
        ({"distortion_model": None}, "distortion_model: got None"),
    ],
)
def test_bad_files_are_told_in_one_line(tmp_path, changes, message):
    with pytest.raises(ConfigError) as error:
        load_camera({"file": written(tmp_path, **changes)})
    assert message in str(error.value) and "\n" not in str(error.value)


def test_a_calibration_of_another_image_size_is_refused(tmp_path):
    path = written(tmp_path)
    assert load_camera({"file": path, "width_px": 640}).width_px == 640
    with pytest.raises(ConfigError, match=r"left\.yaml: width_px: got 640, expected 1280, the size that the camera"):
        load_camera({"file": path, "width_px": 1280, "height_px": 960})


@pytest.mark.parametrize("file", ["nowhere.yaml", 3, None])
def test_a_file_that_is_none_is_told(file):
    with pytest.raises(ConfigError, match=r"^camera\.file: got"):
        load_camera({"file": file})

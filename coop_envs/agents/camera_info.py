"""Camera calibrations as ROS tools write them (``camera_info`` YAML), read into the entries of a `Camera`.

Source: http://wiki.ros.org/camera_calibration_parsers; OpenCV's camera model (k1, k2, p1, p2, k3).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coop_envs.errors import ConfigError, require
from coop_envs.validation import read_yaml


def read_camera_info(path: str | Path) -> dict[str, Any]:
    """Name, image size, intrinsics and distortion of a calibration file.

    Raises:
        ConfigError: no such file; an entry that is missing or of the wrong size; a lens that is not plumb-bob.
    """
    file = str(path)
    require(Path(path).is_file(), "camera.file", file, "a file that exists")
    info = read_yaml(Path(path).read_text(encoding="utf-8"), file)
    lens = info.get("distortion_model")
    require(lens == "plumb_bob", f"{file}: distortion_model", lens, "plumb_bob (pinhole with k1, k2, p1, p2, k3)")
    fx, skew, cx, *zeros, fy, cy = _reordered(_numbers(info, "camera_matrix", 9, file))
    plain = skew == 0 and zeros == [0, 0, 0, 1]
    require(plain, f"{file}: camera_matrix", info["camera_matrix"], "[fx, 0, cx, 0, fy, cy, 0, 0, 1]")
    return {
        "name": str(info.get("camera_name", Path(path).stem)),
        "width_px": _pixels(info, "image_width", file),
        "height_px": _pixels(info, "image_height", file),
        "fx_px": fx,
        "fy_px": fy,
        "cx_px": cx,
        "cy_px": cy,
        "distortion": _numbers(info, "distortion_coefficients", 5, file),
    }


def from_file(entries: Mapping[str, Any]) -> dict[str, Any]:
    """A camera's entries with those of the calibration that its ``file`` names; the image size must be the same.

    Raises:
        ConfigError: as `read_camera_info`; the calibration is of another image size than ``entries`` ask for.
    """
    given = dict(entries)
    file = given.pop("file")
    if not isinstance(file, str | Path):
        raise ConfigError("camera.file", file, "the path of a ROS camera_info YAML file")
    info = read_camera_info(file)
    for name in ("width_px", "height_px"):
        asked = given.pop(name, info[name])
        require(asked == info[name], f"{file}: {name}", info[name], f"{asked}, the size that the camera is used at")
    return {**info, **given}


def _reordered(k: tuple[float, ...]) -> tuple[float, ...]:
    return (k[0], k[1], k[2], k[3], k[6], k[7], k[8], k[4], k[5])


def _numbers(info: Mapping[str, Any], name: str, count: int, file: str) -> tuple[float, ...]:
    """The ``data`` of a matrix."""
    matrix = info.get(name)
    data = matrix.get("data") if isinstance(matrix, Mapping) else None
    fits = isinstance(data, list) and len(data) == count and all(type(x) in (int, float) for x in data)
    if not fits or data is None:
        raise ConfigError(f"{file}: {name}", matrix, f"a mapping whose 'data' lists {count} numbers")
    return tuple(float(x) for x in data)


def _pixels(info: Mapping[str, Any], name: str, file: str) -> int:
    value = info.get(name)
    if type(value) is not int or value <= 0:
        raise ConfigError(f"{file}: {name}", value, "a whole number of pixels")
    return value

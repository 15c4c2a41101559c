from __future__ import annotations

import os
import zlib

import cv2
import numpy as np
import pytest

from coop_envs.errors import ConfigError, WorldError
from coop_envs.scenario import load_scenario, scenario_world
from coop_envs.worlds.build import build_world
from coop_envs.worlds.height_map import HeightMapGeometry
from coop_envs.worlds.raster import heights_at
from tests.worlds.builders import team_of


def png(path, values, dtype: type = np.uint16) -> str:
    assert cv2.imwrite(str(path), np.asarray(values).astype(dtype))
    return str(path)


@pytest.fixture
def plain(tmp_path):
    return png(tmp_path / "plain.png", np.full((81, 121), 30000))


def test_columns_run_along_x_and_rows_from_the_bottom_along_y(tmp_path):
    values = np.zeros((81, 121))
    values[0, 120], values[80, 30], values[20, 0] = 65535, 13107, 6553.5 * 2
    path = png(tmp_path / "posts.png", values)
    world = build_world(HeightMapGeometry(path, full_scale_m=2.0, base_m=-0.5, hazards=0), team_of(1))
    ground = world.ground
    assert world.mesh is None
    assert ground.bounds_m == pytest.approx((0.0, 0.0, 3.0, 2.0))
    posts = heights_at(ground, np.array([3.0, 0.75, 0.0, 1.5]), np.array([2.0, 0.0, 1.5, 1.0]))
    assert posts == pytest.approx([1.5, -0.1, -0.1, -0.5], abs=1e-4)
    assert np.sum(ground.heights_m > -0.49) == 3


@pytest.mark.parametrize(("pixel_m", "cell_m"), [(0.02, 0.02), (0.025, 0.025), (0.04, 0.02), (0.2, 0.025)])
def test_a_tilted_plane_stays_one_at_every_resolution(tmp_path, pixel_m, cell_m):
    rows, columns = np.meshgrid(np.arange(40), np.arange(50), indexing="ij")
    path = png(tmp_path / "plane.png", 1000 + 40 * columns + 24 * (39 - rows))
    world = build_world(
        HeightMapGeometry(path, pixel_m=pixel_m, full_scale_m=65535e-4 * pixel_m, hazards=0), team_of(1)
    )
    ground = world.ground
    assert ground.cell_m == pytest.approx(cell_m)
    assert ground.bounds_m[2:] == pytest.approx((49 * pixel_m, 39 * pixel_m))
    i, j = np.meshgrid(*map(np.arange, ground.heights_m.shape), indexing="ij")
    x, y = i * ground.cell_m, j * ground.cell_m
    assert ground.heights_m == pytest.approx(0.1 * pixel_m + 0.004 * x + 0.0024 * y, abs=1e-6)


def test_world_takes_a_picture(plain):
    scenario = load_scenario("arena", world=plain, team="surveyors", **{"environment.geometry.hazards": 2})
    assert (scenario.name, scenario.task.success, scenario.map.ego_stride) == ("plain", "coverage", 2)
    assert scenario.environment.geometry == HeightMapGeometry(plain, hazards=2)
    assert "height map plain.png" in scenario.description
    world = scenario_world(scenario)
    assert len(world.starts) == 3
    assert 1 <= len(world.hazards) <= 2
    assert world.hazards != scenario_world(scenario, "heldout").hazards


def test_a_picture_that_changes_is_read_again(tmp_path, plain):
    first = build_world(HeightMapGeometry(plain, hazards=0), team_of(1))
    png(tmp_path / "plain.png", np.full((81, 141), 30000))
    os.utime(plain, ns=(1, 1))
    second = build_world(HeightMapGeometry(plain, hazards=0), team_of(1))
    assert second.ground.bounds_m[2] == pytest.approx(first.ground.bounds_m[2] + 0.5)


def refusal(path, **fields) -> str:
    with pytest.raises(WorldError) as caught:
        build_world(HeightMapGeometry(str(path), **fields), team_of(1))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_other_pictures_are_refused_by_what_they_are(tmp_path):
    grey = np.full((80, 80), 100)
    assert "16-bit grey PNG, heights 0 to 65535, not 8-bit grey" in refusal(png(tmp_path / "8.png", grey, np.uint8))
    colour = np.dstack([grey] * 3)
    assert "not 16-bit colour" in refusal(png(tmp_path / "rgb.png", colour))
    assert "not 8-bit colour with alpha" in refusal(png(tmp_path / "rgba.png", np.dstack([grey] * 4), np.uint8))
    jpeg = tmp_path / "jpeg.png"
    jpeg.write_bytes(cv2.imencode(".jpg", grey.astype(np.uint8))[1].tobytes())
    assert "a readable PNG" in refusal(jpeg)


def test_broken_pictures_are_refused(tmp_path, plain, capfd):
    data = (tmp_path / "plain.png").read_bytes()
    at = data.index(b"IDAT")
    broken = {
        "empty": (b"", "empty file"),
        "head": (data[:20], "a readable PNG"),
        "cut": (data[: len(data) // 2], "cut short"),
        "noise": (data[: at + 4] + bytes(len(data) - at - 20) + data[-16:], "damaged chunk IDAT"),
        "endless": (data[:-12], "cut short"),
    }
    for name, (content, reason) in broken.items():
        path = tmp_path / f"{name}.png"
        path.write_bytes(content)
        assert reason in refusal(path), name
    assert capfd.readouterr() == ("", "")
    assert "a file that exists" in refusal(tmp_path / "missing.png")
    assert "a height map: .png" in refusal(tmp_path / "mesh.ply")


def test_a_picture_too_large_is_refused_before_it_is_unpacked(tmp_path, plain):
    data = bytearray((tmp_path / "plain.png").read_bytes())
    data[16:24] = (60000).to_bytes(4, "big") * 2
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
    (tmp_path / "huge.png").write_bytes(data)
    assert "at most 16 million pixels, not 60000 x 60000" in refusal(tmp_path / "huge.png")


def test_scales_that_do_not_suit_robots_are_refused(tmp_path, plain):
    assert "environment.geometry.pixel_m: got 0.002, expected 0.3 m or more each way" in refusal(plain, pixel_m=0.002)
    assert "environment.geometry.pixel_m: got 2.0, expected at most 100 x 100 m" in refusal(plain, pixel_m=2.0)
    assert "0.3 m or more" in refusal(png(tmp_path / "dot.png", [[5]]))
    rough = png(tmp_path / "rough.png", np.random.default_rng(0).integers(0, 65535, (60, 60)))
    assert "environment.geometry.pixel_m: got 0.025, expected free level ground" in refusal(rough)
    assert "environment.geometry.start" in refusal(plain, start=(9.0, 9.0, 0.0))
    assert "environment.geometry.goal" in refusal(plain, goal=(9.0, 9.0, 0.1))


@pytest.mark.parametrize(
    "fields",
    [{"pixel_m": 0.0}, {"full_scale_m": 0.0}, {"full_scale_m": float("nan")}, {"base_m": float("inf")},
     {"hazards": -1}, {"hazard_radius_m": (0.3, 0.1)}, {"goal": (0.0, 0.0, 0.0)}],
)  # fmt: skip
def test_impossible_settings_are_refused(fields):
    with pytest.raises(ConfigError, match=rf"environment\.geometry\.{next(iter(fields))}"):
        HeightMapGeometry("map.png", **fields)

import dataclasses

import numpy as np
import pytest

from coop_envs.errors import ConfigError
from coop_envs.recording import Frame, Scan, WorldPicture
from coop_envs.recording.frame import (
    HazardPicture,
    frame_from_arrays,
    frame_to_arrays,
    world_from_arrays,
    world_to_arrays,
)


def test_a_frame_survives_being_taken_apart(frames: list[Frame]) -> None:
    arrays = frame_to_arrays(frames[3])
    again = frame_to_arrays(frame_from_arrays(arrays))
    assert list(again) == [field.name for field in dataclasses.fields(Frame)]
    for name, value in arrays.items():
        assert again[name].dtype == value.dtype
        np.testing.assert_array_equal(again[name], value)


def test_a_frame_is_a_snapshot(frames: list[Frame]) -> None:
    poses = np.zeros((3, 3))
    frame = dataclasses.replace(frames[0], true_xy_yaw=poses)
    poses[:] = 7.0
    assert not frame.true_xy_yaw.any()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("status", [1, 1]),
        ("belief_cov_xy", np.zeros((3, 2))),
        ("map_obstacle", np.zeros((3, 3))),
        ("role", ("observer",)),
        ("points_m", np.zeros((3, 2))),
        ("point_sigma_m", np.zeros(9)),
        ("map_volume", np.zeros((2, 3, 3))),
    ],
)
def test_a_wrong_shape_is_named(frames: list[Frame], name: str, value: object) -> None:
    with pytest.raises(ConfigError, match=f"frame.{name}"):
        dataclasses.replace(frames[0], **{name: value})


def test_a_frame_of_before_there_was_scanning_is_read_as_one_without(frames: list[Frame]) -> None:
    arrays = frame_to_arrays(frames[3])
    for name in (
        "scanning",
        "points_m",
        "point_sigma_m",
        "point_robots",
        "point_eyes_m",
        "map_volume",
        "volume_floor_m",
    ):
        del arrays[name]
    frame = frame_from_arrays(arrays)
    assert len(frame.scan) == len(frame.map_volume) == 0
    assert not frame.scanning.any()
    np.testing.assert_array_equal(frame.map_ground, frames[3].map_ground)


def test_points_of_several_scans_keep_their_order(frames: list[Frame]) -> None:
    joined = Scan.joined([frame.scan for frame in frames[:4]])
    assert len(joined) == 0 + 1 + 2 + 3
    frame = frames[0].with_scan(joined)
    np.testing.assert_array_equal(frame.points_m[3:], frames[3].points_m)
    np.testing.assert_array_equal(frame.point_robots[1:3], frames[2].point_robots)
    assert len(Scan.joined([])) == 0


def test_a_frame_without_maps_is_else_the_same(frames: list[Frame]) -> None:
    bare = frames[3].without_maps()
    assert bare.map_ground.size == bare.map_obstacle.size == bare.map_volume.size == 0
    np.testing.assert_array_equal(bare.points_m, frames[3].points_m)


@pytest.mark.parametrize("goal", [None, (0.6, 0.3, 0.08)])
@pytest.mark.parametrize(
    "hazards", [(), (HazardPicture("trap", (0.1, 0.2), (0.3, 0.4)), HazardPicture("hole", (1, 2)))]
)
def test_a_world_survives_being_taken_apart(goal: tuple[float, float, float] | None, hazards: tuple) -> None:
    heights = np.array([[0.0, np.nan, 0.1]], np.float32)
    world = WorldPicture(heights, (-1.0, 2.0), 0.01, hazards, goal, ((0.0, 0.1, 0.2),), (0.0, 0.0, 1.0, 1.0))
    again = world_from_arrays(world_to_arrays(world))
    np.testing.assert_array_equal(again.heights, heights)
    for name in ("origin", "cell", "hazards", "goal", "starts", "bounds"):
        assert getattr(again, name) == getattr(world, name)

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from coop_envs.errors import ConfigError
from coop_envs.recording import EpisodeReader, EpisodeWriter, Frame, LogMetadata, WorldPicture
from coop_envs.recording.frame import frame_to_arrays
from coop_envs.recording.json_arrays import decode_array, encode_array
from coop_envs.recording.log_format import MAP_FIELDS, MEASUREMENTS, VOLUME_FIELDS
from coop_envs.recording.whole_file import unfinished_path, written_whole

METADATA = LogMetadata("name: arena\nteam: scouts\n", 7, "goal_grid", "0.1.0", "coop evaluate --policy goal_grid")
WORLD = WorldPicture(np.zeros((4, 3), np.float32), (0.0, 0.0), 0.1, (), None, ((0, 0, 0),), (0.0, 0.0, 0.3, 0.2))


def measurements(k: int) -> dict[str, np.ndarray]:
    return {"gyro_rad_s": np.random.default_rng(k).normal(size=(3, 3)), "visible": np.arange(k) % 2 == 0}


def write_episode(path: Path, frames: list[Frame]) -> Path:
    with EpisodeWriter(path, METADATA) as log:
        log.write_world(WORLD)
        for k, frame in enumerate(frames):
            log.write_frame(frame)
            log.write_arrays(MEASUREMENTS, frame.time_s, measurements(k))
    return path


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


dtypes: st.SearchStrategy[np.dtype] = st.one_of(
    hnp.floating_dtypes(endianness="?"),
    hnp.integer_dtypes(endianness="?"),
    hnp.unsigned_integer_dtypes(endianness="?"),
    hnp.boolean_dtypes(),
    hnp.complex_number_dtypes(),
    hnp.unicode_string_dtypes(min_len=1, max_len=5),
)
arrays = hnp.arrays(dtypes, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))


@given(array=arrays, compress=st.booleans())
def test_arrays_survive_json_bit_for_bit(array: np.ndarray, compress: bool) -> None:
    assert same(decode_array(json.loads(json.dumps(encode_array(array, compress)))), array)


def test_objects_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"array\.dtype"):
        encode_array(np.array([None, {}], dtype=object))


def test_a_log_gives_back_what_was_written(tmp_path: Path, frames: list[Frame]) -> None:
    reader = EpisodeReader(write_episode(tmp_path / "episode.mcap", frames))
    assert reader.note is None
    assert reader.metadata == METADATA
    world = reader.world()
    assert world is not None
    assert same(world.heights, WORLD.heights)
    assert [time_s for time_s, _ in reader.arrays()] == [frame.time_s for frame in frames]
    for k, (_, read) in enumerate(reader.arrays()):
        expected = measurements(k)
        assert list(read) == list(expected)
        assert all(same(read[name], expected[name]) for name in expected)


def test_frames_are_exact_and_their_maps_at_most_a_second_old(tmp_path: Path, frames: list[Frame]) -> None:
    read = list(EpisodeReader(write_episode(tmp_path / "episode.mcap", frames)).frames())
    assert len(read) == len(frames)
    for k, (got, frame) in enumerate(zip(read, frames, strict=True)):
        arrays, expected = frame_to_arrays(got), frame_to_arrays(frame)
        assert all(same(arrays[name], expected[name]) for name in expected if name not in MAP_FIELDS + VOLUME_FIELDS)
        recent = frames[max(0, k - 5) : k + 1]
        assert any(same(got.map_ground, other.map_ground) for other in recent)
    assert same(read[-1].map_ground, frames[-1].map_ground)
    assert same(read[-1].map_obstacle, frames[-1].map_obstacle)
    assert [len(frame.map_volume) for frame in read[:-1]] == [0] * (len(frames) - 1)
    assert same(read[-1].map_volume, frames[-1].map_volume)
    assert read[-1].volume_floor_m == frames[-1].volume_floor_m


def test_a_standard_reader_finds_plottable_numbers(tmp_path: Path, frames: list[Frame]) -> None:
    from mcap.reader import make_reader

    with write_episode(tmp_path / "episode.mcap", frames).open("rb") as stream:
        found = [(s, c, json.loads(m.data)) for s, c, m in make_reader(stream).iter_messages(topics=["/frame"])]
    assert len(found) == len(frames)
    schema, channel, message = found[-1]
    assert schema is not None
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    properties = json.loads(schema.data)["properties"]
    assert set(message) == set(properties)
    assert properties["coverage"] == {"type": "number"}
    assert message["coverage"] == frames[-1].coverage
    assert message["range_m"][0] == "Infinity"


def test_a_log_cut_short_is_read_up_to_the_cut(tmp_path: Path, frames: list[Frame]) -> None:
    whole = write_episode(tmp_path / "episode.mcap", frames).read_bytes()
    cut, counts = tmp_path / "cut.mcap", []
    for size in range(400, len(whole), len(whole) // 60):
        cut.write_bytes(whole[:size])
        reader = EpisodeReader(cut)
        assert reader.note is not None
        assert "cut short" in reader.note
        read = list(reader.frames())
        assert [frame.time_s for frame in read] == [frame.time_s for frame in frames[: len(read)]]
        counts.append(len(read))
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] == len(frames)


def test_a_damaged_log_says_so(tmp_path: Path, frames: list[Frame]) -> None:
    path = write_episode(tmp_path / "episode.mcap", frames)
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 0xFF
    path.write_bytes(data)
    reader = EpisodeReader(path)
    read = list(reader.frames())
    assert len(read) < len(frames)
    assert reader.note is not None


def write_until_interrupted(path: Path, frame: Frame, keep: bool) -> None:
    with EpisodeWriter(path, METADATA, keep_unfinished=keep) as log:
        log.write_frame(frame)
        raise KeyboardInterrupt


def test_json_and_metadata_of_others_are_read_back_in_order(tmp_path: Path) -> None:
    with EpisodeWriter(tmp_path / "episode.mcap", METADATA) as log:
        log.write_metadata("other", {"team": "a: ü"})
        for k in range(4):
            log.write_json(f"/topic_{k % 2}", "other.Message", {"type": "object"}, 0.1 * k, b'{"k":%d}' % k)
        with pytest.raises(ConfigError, match="topic"):
            log.write_json("/map", "other.Message", {"type": "object"}, 1.0, b"{}")
    reader = EpisodeReader(tmp_path / "episode.mcap")
    assert list(reader.messages("/topic_0", "/topic_1")) == [(f"/topic_{k % 2}", {"k": k}) for k in range(4)]
    assert [message["k"] for _, message in reader.messages("/topic_1")] == [1, 3]
    assert reader.metadata_record("other") == {"team": "a: ü"}
    assert reader.metadata_record("none") == {}
    assert reader.metadata == METADATA


def test_what_was_flushed_can_be_read_while_writing_goes_on(tmp_path: Path, frames: list[Frame]) -> None:
    path = tmp_path / "episode.mcap"
    with EpisodeWriter(path, METADATA) as log:
        log.write_frame(frames[1])
        log.write_arrays(MEASUREMENTS, 0.5, measurements(1))
        assert not list(EpisodeReader(unfinished_path(path)).arrays())
        log.flush()
        assert len(list(EpisodeReader(unfinished_path(path)).arrays())) == 1


def test_a_failure_leaves_nothing_unless_asked(tmp_path: Path, frames: list[Frame]) -> None:
    path = tmp_path / "episode.mcap"
    for keep in (False, True):
        with pytest.raises(KeyboardInterrupt):
            write_until_interrupted(path, frames[0], keep)
        assert list(tmp_path.iterdir()) == ([unfinished_path(path)] if keep else [])
    assert len(list(EpisodeReader(unfinished_path(path)).frames())) == 1


def test_maps_are_written_once_a_second_and_at_the_end(tmp_path: Path, frames: list[Frame]) -> None:
    from mcap.reader import make_reader

    with write_episode(tmp_path / "episode.mcap", frames).open("rb") as stream:
        times = [m.log_time / 1e9 for _, _, m in make_reader(stream).iter_messages(topics=["/map"])]
    assert times == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0, 4.6])


def test_bad_input_is_told_in_one_line(tmp_path: Path, frames: list[Frame]) -> None:
    with pytest.raises(ConfigError, match="existing episode log"):
        EpisodeReader(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_text("not a log")
    with pytest.raises(ConfigError, match="an MCAP file"):
        EpisodeReader(tmp_path / "text.mcap")
    with pytest.raises(ConfigError, match=r"\.mcap"):
        EpisodeWriter(tmp_path / "episode.bag", METADATA)
    with EpisodeWriter(tmp_path / "episode.mcap", METADATA) as log:
        log.write_frame(frames[1])
        with pytest.raises(ConfigError, match="time_s"):
            log.write_frame(frames[0])
        with pytest.raises(ConfigError, match="topic"):
            log.write_arrays("/points", 1.0, {})


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "new" / "report.html"
    with written_whole(path) as part:
        part.write_text("first")
        assert not path.exists()
    with pytest.raises(UnicodeEncodeError), written_whole(path) as part:
        part.write_text("half \u2192", encoding="ascii")
    assert path.read_text() == "first"
    assert list(path.parent.iterdir()) == [path]

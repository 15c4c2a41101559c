"""What a mission log gives back, what it costs, and what a kill, a slow disk or a full one do to it."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from coop_envs.errors import ConfigError
from coop_envs.recording import EpisodeReader, EpisodeWriter, LogMetadata
from coop_envs.recording.whole_file import unfinished_path
from hardware_bridge import mission_log
from hardware_bridge.command import RobotCommand
from hardware_bridge.mission_log import MissionLog
from hardware_bridge.mission_log_format import (
    BELIEF,
    EVENTS,
    INPUTS,
    INTERVENTIONS,
    SENT,
    TIMING,
    WANTED,
    MissionEvent,
    adapter,
    encode_message,
    schema_of,
)
from hardware_bridge.mission_reader import MissionReader
from hardware_bridge.reading import CameraFrame, Sample
from hardware_bridge.tick_inputs import HumanInput, KeyEvent, TickInputs
from tests.hardware_bridge.missions import METADATA, TICK_S, belief, commands, intervention, tick, write_tick
from tests.recording.conftest import random_frame

ROOT = Path(__file__).parents[2]
SLACK_S = 30.0


def written(path: Path, ticks: int) -> Path:
    with MissionLog(path, METADATA) as log:
        for k in range(ticks):
            write_tick(log, k)
    return path


def bits(value: object) -> object:
    """A value in which two floats are equal only if their bits are, or both are NaN."""
    if isinstance(value, float):
        return value.hex()
    if dataclasses.is_dataclass(value):
        return type(value).__name__, [bits(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, dict):
        return {key: bits(item) for key, item in value.items()}
    return [bits(item) for item in value] if isinstance(value, tuple) else value


floats = st.floats()
pairs, triples = st.tuples(floats, floats), st.tuples(floats, floats, floats)
samples = st.builds(
    Sample, floats, st.none() | floats, pairs, pairs, st.none() | triples, st.none() | triples, st.none() | floats
)
blobs = st.lists(st.tuples(floats, floats, floats, floats), max_size=3).map(tuple)
camera_frames = st.builds(CameraFrame, floats, blobs, st.none() | triples)
robot_commands = st.builds(RobotCommand, pairs, floats, floats, st.tuples(st.integers(-99, 99), st.integers(-99, 99)))
humans = st.builds(
    HumanInput,
    floats,
    st.lists(st.none() | robot_commands, max_size=3).map(tuple),
    estop=st.just(False),
    release_estop=st.booleans(),
    age_s=st.floats(min_value=0.0),
)
names = st.text(max_size=8)
inputs = st.builds(
    TickInputs,
    st.floats(0.0, 1e6),
    st.dictionaries(names, st.lists(samples, max_size=2).map(tuple), max_size=3),
    st.dictionaries(names, st.lists(camera_frames, max_size=2).map(tuple), max_size=2),
    st.lists(st.builds(KeyEvent, floats, names), max_size=2).map(tuple),
    st.none() | humans,
    st.booleans(),
    st.booleans(),
    st.dictionaries(names, names, max_size=2),
)


@given(inputs=inputs)
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_inputs_survive_json_bit_for_bit(inputs: TickInputs) -> None:
    again = adapter(TickInputs).validate_python(json.loads(encode_message(inputs)))
    assert bits(again) == bits(inputs)


def test_numbers_of_numpy_are_read_back_as_plain_ones_of_the_same_value() -> None:
    odd = Sample(np.float64(0.1), np.float32(0.1), (np.int32(3), 0.5), (0.0, 0.0))  # type: ignore[arg-type]
    again = adapter(Sample).validate_python(json.loads(encode_message(odd)))
    assert again == Sample(0.1, float(np.float32(0.1)), (3.0, 0.5), (0.0, 0.0))


def test_any_mapping_will_do() -> None:
    inputs = TickInputs(1.0, MappingProxyType({"picket_0": ()}), failures=MappingProxyType({"picket_0": "unplugged"}))
    assert adapter(TickInputs).validate_python(json.loads(encode_message(inputs))) == TickInputs(
        1.0, {"picket_0": ()}, failures={"picket_0": "unplugged"}
    )


def test_a_mission_is_read_back_exactly(tmp_path: Path) -> None:
    reader = MissionReader(written(tmp_path / "run.mcap", 30))
    assert reader.note is None
    assert reader.metadata == METADATA
    ticks = list(reader.ticks())
    assert [bits(one.inputs) for one in ticks] == [bits(tick(k)) for k in range(30)]
    assert [(one.wanted, one.sent) for one in ticks] == [(commands(k), commands(k + 1)) for k in range(30)]
    assert list(reader.interventions()) == [intervention(k) for k in range(30)]
    assert [timing.measurement_to_command_s for timing in reader.timings()] == [None, 0.02] * 15
    read = list(reader.arrays(BELIEF))
    assert [time_s for time_s, _ in read] == [k * TICK_S for k in range(0, 30, 6)]
    for (_, arrays), k in zip(read, range(0, 30, 6), strict=True):
        for name, array in belief(k).items():
            assert arrays[name].dtype == array.dtype
            assert arrays[name].tobytes() == array.tobytes()


def test_standard_tools_read_it_and_its_schemas(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    with written(tmp_path / "run.mcap", 6).open("rb") as stream:
        messages = list(make_reader(stream, validate_crcs=True).iter_messages())
        stream.seek(0)
        names = {record.name for record in make_reader(stream).iter_metadata()}
    assert {channel.topic for _, channel, _ in messages} == {INPUTS, WANTED, SENT, INTERVENTIONS, TIMING, BELIEF}
    assert names == {"coop_envs", "hardware_bridge"}
    for schema, channel, message in messages:
        assert schema is not None
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        known = json.loads(schema.data)["properties"]
        assert set(json.loads(message.data)) <= set(known)


def test_schemas_have_no_references_and_no_numbers_that_json_lacks() -> None:
    text = json.dumps(schema_of(TickInputs), allow_nan=False)
    assert "$ref" not in text
    sample_schema = schema_of(TickInputs)["properties"]["samples"]["additionalProperties"]["items"]
    assert sample_schema["properties"]["host_s"] == {"type": "number"}


def test_the_episode_reader_draws_missions_too(tmp_path: Path) -> None:
    frames = [random_frame(0.2 * k, seed=k) for k in range(8)]
    with MissionLog(tmp_path / "run.mcap", METADATA) as log:
        for frame in frames:
            log.write_frame(dataclasses.replace(frame, true_xy_yaw=np.full((3, 3), np.nan)))
    read = list(EpisodeReader(tmp_path / "run.mcap").frames())
    assert [frame.time_s for frame in read] == [frame.time_s for frame in frames]
    np.testing.assert_array_equal(read[5].belief_xy_yaw, frames[5].belief_xy_yaw)
    assert np.isnan(read[5].true_xy_yaw).all()


def test_a_frame_that_goes_back_in_time_costs_a_line_and_nothing_else(tmp_path: Path) -> None:
    lines: list[str] = []
    with MissionLog(tmp_path / "run.mcap", METADATA, say=lines.append) as log:
        log.write_frame(random_frame(1.0, 1))
        log.write_frame(random_frame(0.5, 1))
        write_tick(log, 0)
    assert len(lines) == 1
    assert "frame.time_s: got 0.5" in lines[0]
    assert len(list(MissionReader(tmp_path / "run.mcap").ticks())) == 1


def test_what_was_queued_is_as_it_was_when_it_was_written(tmp_path: Path) -> None:
    arrays = belief(1)
    before = arrays["position"].copy()
    with MissionLog(tmp_path / "run.mcap", METADATA) as log:
        log.write_arrays(BELIEF, 0.0, arrays)
        arrays["position"][:] = 0.0
    ((_, read),) = MissionReader(tmp_path / "run.mcap").arrays(BELIEF)
    np.testing.assert_array_equal(read["position"], before)


def test_a_kill_loses_at_most_a_second(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    command = [sys.executable, "-m", "tests.hardware_bridge.missions", str(path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline().split() for _ in range(60)]
        process.send_signal(signal.SIGKILL)
        lines += [line.split() for line in process.stdout]
    assert process.returncode == -signal.SIGKILL
    assert not path.exists()
    written_s = {int(k): float(time_s) for k, time_s in lines}
    reader = MissionReader(unfinished_path(path))
    ticks = list(reader.ticks())
    assert reader.note is not None
    last = len(ticks) - 1
    assert bits(ticks[last].inputs) == bits(tick(last))
    assert max(written_s.values()) - written_s[last] <= 1.0


def test_a_mission_that_ends_by_an_exception_has_a_whole_log(tmp_path: Path) -> None:
    def interrupted() -> None:
        with MissionLog(tmp_path / "run.mcap", METADATA) as log:
            write_tick(log, 3)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    reader = MissionReader(tmp_path / "run.mcap")
    assert reader.note is None
    assert len(list(reader.ticks())) == 1
    assert list(reader.events()) == [MissionEvent(3 * TICK_S, "mission ended", "KeyboardInterrupt")]


def test_a_full_disk_costs_one_line_and_the_mission_goes_on(tmp_path: Path) -> None:
    unfinished_path(tmp_path / "run.mcap").symlink_to("/dev/full")
    lines: list[str] = []
    with MissionLog(tmp_path / "run.mcap", METADATA, say=lines.append) as log:
        end = time.monotonic() + SLACK_S
        for k in range(10**6):
            write_tick(log, k)
            if log.cut is not None or time.monotonic() > end:
                break
        write_tick(log, k + 1)
    assert log.cut == os.strerror(28)
    assert len(lines) == 1
    assert "run.mcap ends" in lines[0] and "No space left" in lines[0]
    assert not (tmp_path / "run.mcap").exists()


def write_until_full(path: Path, limit: int) -> None:
    """In a process of its own: files may not grow beyond a limit, as on a disk that fills up."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    with MissionLog(path, METADATA) as log:
        for k in range(4000):
            write_tick(log, k)
            time.sleep(0.005)
            if log.cut is not None:
                break


def test_a_log_of_a_disk_that_filled_up_is_read_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    code = "import sys; from pathlib import Path; from tests.hardware_bridge.test_mission_log import write_until_full;"
    code += "write_until_full(Path(sys.argv[1]), 600_000)"
    done = subprocess.run([sys.executable, "-c", code, str(path)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "File too large" in done.stderr and done.stderr.count("\n") == 1
    reader = MissionReader(unfinished_path(path))
    ticks = list(reader.ticks())
    assert len(ticks) > 10
    assert bits(ticks[-1].inputs) == bits(tick(len(ticks) - 1))
    assert reader.note is not None


def test_a_disk_that_stalls_never_blocks_a_tick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The log goes into a named pipe that nobody empties for a while: a write to it blocks as on a hung disk."""
    monkeypatch.setattr(mission_log, "CLOSING_S", 0.2)
    monkeypatch.setattr(mission_log, "DERIVED_WAITING", 50)
    monkeypatch.setattr(mission_log, "MOST_WAITING", 400)
    part = unfinished_path(tmp_path / "run.mcap")
    os.mkfifo(part)
    reading = os.open(part, os.O_RDONLY | os.O_NONBLOCK)
    lines: list[str] = []
    took: list[float] = []
    try:
        with MissionLog(tmp_path / "run.mcap", METADATA, say=lines.append) as log:
            for k in range(400):
                began = time.perf_counter()
                write_tick(log, k)
                took.append(time.perf_counter() - began)
    finally:
        os.close(reading)
    assert sum(took) / len(took) < 0.01
    assert log.cut is not None
    assert len(lines) == 1


def test_pictures_go_first_when_the_disk_is_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mission_log, "DERIVED_WAITING", 40)
    monkeypatch.setattr(mission_log, "DRAIN_S", 0.5)
    with MissionLog(tmp_path / "run.mcap", METADATA) as log:
        for k in range(60):
            write_tick(log, k)
    reader = MissionReader(tmp_path / "run.mcap")
    assert [one.inputs.time_s for one in reader.ticks()] == [k * TICK_S for k in range(60)]
    assert len(list(reader.arrays(BELIEF))) < 10
    (event,) = reader.events()
    assert event.text.startswith("the disk was behind")


def test_inputs_are_never_left_out_in_the_middle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mission_log, "MOST_WAITING", 100)
    monkeypatch.setattr(mission_log, "DRAIN_S", 1.0)
    lines: list[str] = []
    with MissionLog(tmp_path / "run.mcap", METADATA, say=lines.append) as log:
        for k in range(60):
            write_tick(log, k)
    assert len(lines) == 1
    assert "behind" in lines[0]
    reader = MissionReader(unfinished_path(tmp_path / "run.mcap"))
    times = [one.inputs.time_s for one in reader.ticks()]
    assert times == [k * TICK_S for k in range(len(times))]
    assert 0 < len(times) < 60
    assert reader.note is not None


def test_in_simulated_time_the_mission_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mission_log, "DERIVED_WAITING", 40)
    with MissionLog(tmp_path / "run.mcap", METADATA, waits=True) as log:
        for k in range(300):
            write_tick(log, k)
    reader = MissionReader(tmp_path / "run.mcap")
    assert len(list(reader.ticks())) == 300
    assert len(list(reader.arrays(BELIEF))) == 50
    assert not list(reader.events())


def test_bad_input_is_told_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"\.mcap"):
        MissionLog(tmp_path / "run.bag", METADATA)
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"log: got .* expected a path that can be written to"):
        MissionLog(tmp_path / "file" / "run.mcap", METADATA).__enter__()
    with EpisodeWriter(tmp_path / "episode.mcap", LogMetadata("", 1, "", "")):
        pass
    with pytest.raises(ConfigError, match="a mission's log"):
        MissionReader(tmp_path / "episode.mcap")
    with MissionLog(tmp_path / "run.mcap", METADATA) as log, pytest.raises(ConfigError, match="topic"):
        log.write_arrays(EVENTS, 0.0, {})


def test_a_tick_without_a_time_is_refused() -> None:
    with pytest.raises(ConfigError, match="time_s"):
        TickInputs(math.nan)
    with pytest.raises(ConfigError, match="age_s"):
        HumanInput(0.0, (), age_s=-1.0)

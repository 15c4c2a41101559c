from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_team
from coop_envs.errors import ConfigError
from coop_envs.localization.logs.columns import KINDS
from coop_envs.localization.logs.events import ImuSample, Log
from coop_envs.localization.logs.mcap_file import json_schema
from coop_envs.localization.logs.read_log import read_log, write_log
from coop_envs.recording import EpisodeWriter, LogMetadata
from tests.localization.logs.small_logs import log_or_refusal, same_log, small_log

IMU = {"time_s": 0.0, "robot": "a"} | dict.fromkeys(KINDS["imu"].numbers[1:], 0.0)


def write_messages(path: Path, *messages: tuple[str, bytes], encoding: str = "json") -> Path:
    """An MCAP file of any messages on any topics."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        for topic, data in messages:
            writer.add_message(writer.register_channel(topic, encoding, schema), log_time=0, data=data, publish_time=0)
        writer.finish()
    return path


@pytest.mark.parametrize("arrivals", [True, False])
def test_a_log_comes_back_as_it_was_written(tmp_path, arrivals):
    log = small_log(arrivals=arrivals)
    write_log(tmp_path / "run.mcap", log)
    back = read_log(tmp_path / "run.mcap")
    assert same_log(log, back) and back.notes == ()
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_folder_and_file_hold_the_same(tmp_path):
    log = small_log(1)
    write_log(tmp_path / "run.mcap", log)
    write_log(tmp_path / "run", log)
    assert same_log(read_log(tmp_path / "run.mcap"), read_log(tmp_path / "run"))


def test_other_tools_read_it(tmp_path):
    from mcap.reader import make_reader

    log = small_log()
    write_log(tmp_path / "run.mcap", log)
    with (tmp_path / "run.mcap").open("rb") as stream:
        messages = list(make_reader(stream).iter_messages(log_time_order=False))
    assert len(messages) == len(log.events) + 3 * 30 + 1
    for schema, channel, message in messages:
        row = json.loads(message.data)
        kind = KINDS[channel.topic[1:]]
        assert schema is not None and json.loads(schema.data) == json_schema(kind)
        assert set(row) <= set(json_schema(kind)["properties"]) and set(json_schema(kind)["required"]) <= set(row)
        assert message.log_time == round(row.get("arrival_s", row.get("time_s", 0.0)) * 1e9)


def test_a_cut_file_gives_what_it_holds_and_says_so(tmp_path):
    log, path = small_log(), tmp_path / "run.mcap"
    write_log(path, log)
    path.write_bytes(path.read_bytes()[:-40])
    back = read_log(path)
    assert back.notes == ("run.mcap was cut short or damaged: read up to there",)
    assert same_log(log, back)


def test_of_a_file_cut_anywhere_little_is_lost(tmp_path):
    path, rng = tmp_path / "run.mcap", np.random.default_rng(0)
    events = [ImuSample(0.01 * k, "observer_0", *rng.normal(size=(2, 3))) for k in range(3000)]
    write_log(path, Log(("observer_0", "picket_0", "picket_1"), events, load_team("inchworm")))
    whole = path.read_bytes()
    for share in (0.3, 0.5, 0.7):
        path.write_bytes(whole[: int(share * len(whole))])
        back = read_log(path)
        assert back.notes == ("run.mcap was cut short or damaged: read up to there",)
        assert [event.time_s for event in back.events] == [event.time_s for event in events[: len(back.events)]]
        assert share - 0.15 < len(back.events) / len(events) < share + 0.05


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ({"gyro_x_rad_s": float("nan")}, "run.mcap message 2 on /imu, gyro_x_rad_s: got nan, expected a finite number"),
        ({"gyro_x_rad_s": True}, "run.mcap message 2 on /imu, gyro_x_rad_s: got True, expected a finite number"),
        ({"gyro_x_rad_s": [1]}, "run.mcap message 2 on /imu, gyro_x_rad_s: got [1], expected a finite number"),
        ({"gyro_x_rad_s": None}, "run.mcap message 2 on /imu, gyro_x_rad_s: got None, expected a number"),
        ({"gyro_x_rad_s": 10**400}, "run.mcap message 2 on /imu, gyro_x_rad_s: got"),
        ({"robot": 3}, "run.mcap message 2 on /imu, robot: got 3, expected a name"),
        ({"temperature_k": 3}, "run.mcap message 2 on /imu, column: got 'temperature_k', expected a column"),
        ({"time_s": -1.0}, "run.mcap message 2 on /imu, time_s: got -1.0, expected time not to go back"),
    ],
)
def test_refused_with_message_and_field(tmp_path, row, message):
    path = write_messages(tmp_path / "run.mcap", *(("/imu", json.dumps(m).encode()) for m in (IMU, IMU | row)))
    with pytest.raises(ConfigError) as caught:
        read_log(path)
    assert message in str(caught.value)


def test_refused_as_a_whole(tmp_path):
    with pytest.raises(ConfigError, match=r"run.mcap message 1 on /imu: got .*expected a JSON object"):
        read_log(write_messages(tmp_path / "run.mcap", ("/imu", b"[1, 2]")))
    with pytest.raises(ConfigError, match=r"run.mcap message 1 on /imu: got"):
        read_log(write_messages(tmp_path / "run.mcap", ("/imu", b"[" * 100_000)))
    with pytest.raises(ConfigError, match="expected rows of imu or odometry"):
        read_log(write_messages(tmp_path / "run.mcap"))
    with EpisodeWriter(tmp_path / "episode.mcap", LogMetadata("", 0, "", "")) as writer:
        writer.flush()
    with pytest.raises(ConfigError, match="expected a log of events, not the record of an episode"):
        read_log(tmp_path / "episode.mcap")


def test_other_channels_are_noted(tmp_path):
    path = write_messages(tmp_path / "run.mcap", ("/imu", json.dumps(IMU).encode()), ("/camera/image", b"{}"))
    back = read_log(path)
    assert back.notes == ("run.mcap: channels not read: /camera/image",) and back.robots == ("a",)
    assert np.array_equal(back.events[0].gyro, np.zeros(3))  # type: ignore[union-attr]


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_gives_a_log_or_a_plain_refusal(tmp_path, data):
    path = tmp_path / "run.mcap"
    content = bytearray(write_messages(path, *[("/imu", json.dumps(IMU).encode())] * 20).read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(8, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(8, len(content)))])
    assert log_or_refusal(path)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300))
def test_any_bytes_give_a_plain_refusal(tmp_path, content):
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n" + content)
    assert isinstance(log_or_refusal(tmp_path / "run.mcap"), str)

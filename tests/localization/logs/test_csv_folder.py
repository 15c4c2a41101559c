from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.columns import COVARIANCE, KINDS, covariance_column
from coop_envs.localization.logs.events import ImuSample, Log
from coop_envs.localization.logs.read_log import read_log, write_log
from tests.localization.logs.small_logs import (
    IMU_HEADER,
    IMU_ROWS,
    ROBOTS,
    log_or_refusal,
    same_log,
    small_log,
    write_csv,
)

POSES = "time_s,camera,robot,x_m,y_m,z_m,qw,qx,qy,qz,sigma_rotation_rad,sigma_position_m"
RANGE_BEARING = "time_s,robot,subject,range_m,bearing_rad,range_sigma_m,bearing_sigma_rad"
TWO = [IMU_HEADER, "0.0,a,0,0,0,0,0,9.81", "0.0,b,0,0,0,0,0,9.81"]


@pytest.mark.parametrize("arrivals", [True, False])
def test_a_log_comes_back_as_it_was_written(tmp_path, arrivals):
    log = small_log(arrivals=arrivals)
    write_log(tmp_path / "log", log)
    back = read_log(tmp_path / "log")
    assert same_log(log, back) and back.notes == ()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log"]


def test_names_of_the_log_stand_for_members(tmp_path):
    log = small_log(names=("zumy1", "zumy7", "zumy9"))
    write_log(tmp_path / "log", log)
    back = read_log(tmp_path / "log")
    assert same_log(log, back)
    assert back.team is not None and [member.name for member in back.team.members] == list(ROBOTS)


def test_a_log_replaces_a_log_and_nothing_else(tmp_path):
    write_log(tmp_path / "log", small_log())
    lone = Log(("a",), [ImuSample(0.0, "a", np.zeros(3), np.zeros(3))])
    write_log(tmp_path / "log", lone)
    assert same_log(lone, read_log(tmp_path / "log"))
    (tmp_path / "log" / "diary.txt").write_text("dear")
    with pytest.raises(ConfigError, match=r"log: got \['diary.txt'\], expected a new folder, or one with a log alone"):
        write_log(tmp_path / "log", lone)
    assert len(read_log(tmp_path / "log").events) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["log"]
    with pytest.raises(ConfigError, match="expected a new folder, or one with a log alone"):
        write_log(tmp_path / "log" / "diary.txt", lone)


def test_covariance_by_hand(tmp_path):
    assert covariance_column(0, 0) == "cov_rx_rx_rad2" and covariance_column(2, 3) == "cov_rz_x_rad_m"
    assert len(set(COVARIANCE)) == 21 and COVARIANCE[-1] == "cov_z_z_m2"
    write_csv(tmp_path, imu=TWO, poses=[POSES, "0.1,a,b,1,2,3,1,0,0,0,0.02,0.005"])
    sighting = read_log(tmp_path).events[-1]
    assert np.allclose(sighting.covariance, np.diag([4e-4] * 3 + [2.5e-5] * 3))  # type: ignore[union-attr]
    assert np.array_equal(sighting.position, [1.0, 2.0, 3.0])  # type: ignore[union-attr]
    assert np.array_equal(sighting.rotation, np.eye(3))  # type: ignore[union-attr]


def test_events_are_in_the_order_of_arrival(tmp_path):
    late = f"{IMU_HEADER},arrival_s"
    rows = ["0.0,a,0,0,0,0,0,9.81,0.5", "0.2,a,0,0,0,0,0,9.81,0.6", "0.1,a,0,0,0,0,0,9.81,0.7", "0.3,b,0,0,0,0,0,9.81,"]
    write_csv(tmp_path, imu=[late, *rows])
    log = read_log(tmp_path)
    assert [(event.time_s, event.arrival_s) for event in log.events] == [
        (0.3, None),
        (0.0, 0.5),
        (0.2, 0.6),
        (0.1, 0.7),
    ]
    assert log.robots == ("a", "b") and log.team is None


def test_files_sorted_by_robot_are_merged(tmp_path):
    rows = [f"{0.1 * k},{name},0,0,0,0,0,9.81" for name in "ab" for k in range(3)]
    log = read_log(write_csv(tmp_path, imu=[IMU_HEADER, *rows]))
    assert [event.time_s for event in log.events] == sorted(event.time_s for event in log.events)


def test_spaces_quotes_and_windows_line_ends(tmp_path):
    spaced = [IMU_HEADER.replace(",", ", "), *(row.replace(",", " , ") for row in IMU_ROWS), ""]
    plain = read_log(write_csv(tmp_path))
    assert same_log(read_log(write_csv(tmp_path, imu=spaced)), plain)
    quoted = [",".join(f'"{cell}"' for cell in row.split(",")) for row in [IMU_HEADER, *IMU_ROWS]]
    assert same_log(read_log(write_csv(tmp_path, imu=quoted)), plain)
    (tmp_path / "imu.csv").write_bytes(b"\xef\xbb\xbf" + "\r\n".join([IMU_HEADER, *IMU_ROWS]).encode())
    assert same_log(read_log(tmp_path), plain)


REFUSED = {
    "nan": ({"imu": [IMU_HEADER, "0.0,a,0,nan,0,0,0,9.81"]}, "imu.csv line 2, gyro_y_rad_s: got 'nan', expected a fin"),
    "inf": ({"imu": [IMU_HEADER, *IMU_ROWS, "0.3,a,0,0,0,0,inf,9.81"]}, "imu.csv line 5, accel_y_m_s2: got 'inf'"),
    "overflow": ({"imu": [IMU_HEADER, "0.0,a,0,1e999,0,0,0,9.81"]}, "imu.csv line 2, gyro_y_rad_s: got '1e999'"),
    "text": ({"imu": [IMU_HEADER, "0.0,a,0,x,0,0,0,9.81"]}, "imu.csv line 2, gyro_y_rad_s: got 'x', expected a"),
    "underscore": ({"imu": [IMU_HEADER, "0.0,a,0,1_0,0,0,0,9.81"]}, "imu.csv line 2, gyro_y_rad_s: got '1_0'"),
    "empty cell": ({"imu": [IMU_HEADER, "0.0,a,0,,0,0,0,9.81"]}, "imu.csv line 2, gyro_y_rad_s: got '', expected a n"),
    "no name": ({"imu": [IMU_HEADER, "0.0,,0,0,0,0,0,9.81"]}, "imu.csv line 2, robot: got '', expected a name"),
    "back": (
        {"imu": [IMU_HEADER, *IMU_ROWS, "0.15,a,0,0,0,0,0,9.81"]},
        "imu.csv line 5, time_s: got 0.15, expected time not to go back: 0.2 s or later or an arrival_s",
    ),
    "arrival back": (
        {"imu": [f"{IMU_HEADER},arrival_s", *(f"{row},{at}" for row, at in zip(IMU_ROWS, (1, 3, 2), strict=True))]},
        "imu.csv line 4, arrival_s: got 2.0, expected time not to go back: 3.0 s or later",
    ),
    "arrival missing": (
        {"imu": [f"{IMU_HEADER},arrival_s", f"{IMU_ROWS[0]},1.0", f"{IMU_ROWS[1]},"]},
        "imu.csv line 3, arrival_s: got '', expected a time, as other rows of a have",
    ),
    "short": ({"imu": [IMU_HEADER, "0.0,a,0,0"]}, "imu.csv line 2: got '4 values', expected 8, as the header has"),
    "column": (
        {"imu": [IMU_HEADER.replace("gyro_x_rad_s", "gyro_x_deg_s"), *IMU_ROWS]},
        "imu.csv line 1, column: got 'gyro_x_deg_s', expected a column: accel_x_m_s2, accel_y_m_s2",
    ),
    "column missing": (
        {"imu": [IMU_HEADER.removesuffix(",accel_z_m_s2"), "0.0,a,0,0,0,0,0"]},
        "imu.csv line 1, column accel_z_m_s2: got None",
    ),
    "column twice": ({"imu": [f"{IMU_HEADER},robot", "0,a,0,0,0,0,0,0,a"]}, "imu.csv line 1, columns: got"),
    "no rows": ({"imu": [IMU_HEADER]}, "imu.csv: got 'no rows', expected at least one"),
    "nothing": ({"imu": []}, "imu.csv: got 'an empty file', expected a line that names the columns: time_s"),
    "no motion": (
        {"imu": None, "landmarks": ["name,x_m,y_m", "l,1,2"]},
        "rows of landmarks', expected rows of imu or odometry",
    ),
    "unknown camera": (
        {"poses": [POSES, "0.1,c,a,1,2,3,1,0,0,0,0.02,0.005"]},
        "poses.csv line 2, camera: got 'c', expected a robot with a camera: a",
    ),
    "sees itself": (
        {"poses": [POSES, "0.1,a,a,1,2,3,1,0,0,0,0.02,0.005"]},
        "poses.csv line 2, robot: got 'a', expected another than the one that sees it",
    ),
    "quaternion": (
        {"imu": TWO, "poses": [POSES, "0.1,a,b,1,2,3,1,1,0,0,0.02,0.005"]},
        "poses.csv line 2, qw, qx, qy, qz: got [1.0, 1.0, 0.0, 0.0], expected a norm within 0.01 of 1",
    ),
    "sigma": (
        {"imu": TWO, "poses": [POSES, "0.1,a,b,1,2,3,1,0,0,0,0.02,0"]},
        "poses.csv line 2, sigma_position_m: got 0.0, expected more than 0",
    ),
    "no covariance": (
        {"imu": TWO, "poses": [POSES.removesuffix(",sigma_position_m"), "0.1,a,b,1,2,3,1,0,0,0,0.02"]},
        "poses.csv line 1, covariance: got ['sigma_rotation_rad'], expected in full and alone: cov_rx_rx_rad2 to",
    ),
    "range": (
        {"range_bearing": [RANGE_BEARING, "0,a,l,-1,0,1,1"]},
        "range_bearing.csv line 2, range_m: got -1.0, expected more than 0",
    ),
    "landmark twice": (
        {"landmarks": ["name,x_m,y_m", "l,1,2", "l,1,3"]},
        "landmarks.csv line 3, name: got 'l', expected a name that no other landmark and no robot has",
    ),
    "truth back": (
        {"truth": ["time_s,robot,x_m,y_m,z_m,qw,qx,qy,qz", "1,a,0,0,0,1,0,0,0", "0.5,a,0,0,0,1,0,0,0"]},
        "truth.csv line 3, time_s: got 0.5, expected time not to go back: 1.0 s or later",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_line_and_field(tmp_path, case):
    files, message = REFUSED[case]
    with pytest.raises(ConfigError) as caught:
        read_log(write_csv(tmp_path, **files))
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({covariance_column(0, 0): -1e-4}, "a positive definite matrix"),
        ({covariance_column(3, 4): 2.0}, "a positive definite matrix"),
        ({covariance_column(5, 5): 0.0}, "a positive definite matrix"),
        ({covariance_column(0, 1): 1e-4}, "a positive definite matrix"),
    ],
)
def test_covariance_that_is_none(tmp_path, changes, fault):
    plain = dict.fromkeys(COVARIANCE, 0.0) | {covariance_column(i, i): 1e-4 for i in range(6)}
    good, bad = ([str(value) for value in entries.values()] for entries in (plain, plain | changes))
    header = ",".join([POSES.partition(",sigma")[0], *COVARIANCE])
    rows = [",".join(["0.1,a,b,1,2,3,1,0,0,0", *cells]) for cells in (good, bad)]
    with pytest.raises(ConfigError, match=f"poses.csv line 3, covariance: .*{fault}"):
        read_log(write_csv(tmp_path, imu=TWO, poses=[header, *rows]))
    assert len(read_log(write_csv(tmp_path, imu=TWO, poses=[header, rows[0]])).events) == 3


def test_a_robot_without_a_camera_sees_nobody(tmp_path):
    rows = [f"0.0,{name},0,0,0,0,0,9.81" for name in ROBOTS]
    write_csv(tmp_path, imu=[IMU_HEADER, *rows], poses=[POSES, "0.1,picket_0,picket_1,1,2,3,1,0,0,0,0.02,0.005"])
    expected = "poses.csv line 2, camera: got 'picket_0', expected a robot with a camera: observer_0"
    with pytest.raises(ConfigError, match=expected):
        read_log(tmp_path, "inchworm")


def test_what_is_not_read_is_noted(tmp_path):
    write_csv(tmp_path, pose=["time_s"])
    assert read_log(tmp_path).notes == (
        "pose.csv is not read: no kind of row has this name; did you mean 'poses.csv'?",
    )


def test_no_such_log(tmp_path):
    for path in (tmp_path / "none", tmp_path / "text"):
        (tmp_path / "text").write_text("hello")
        with pytest.raises(ConfigError, match="expected a folder of CSV files, an MCAP file or a ROS 1 bag"):
            read_log(path)


CELL = st.one_of(
    st.sampled_from(["", "nan", "-inf", "0", "1", "0.5", "1e400", "a", "b", "1_0", '"', " ", "\r", "\x00", "é", "0x1"]),
    st.floats().map(repr),
    st.text(max_size=4),
)
LINE = st.lists(CELL, max_size=10).map(",".join)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(sorted(KINDS)), data=st.data())
def test_any_rows_give_a_log_or_a_plain_refusal(tmp_path, kind, data):
    for path in tmp_path.iterdir():
        path.unlink()
    write_csv(tmp_path)
    columns = data.draw(st.one_of(st.just(KINDS[kind].columns), st.permutations(KINDS[kind].columns), st.lists(CELL)))
    width = len(columns)
    rows = data.draw(
        st.lists(st.one_of(LINE, st.lists(CELL, min_size=width, max_size=width).map(",".join)), max_size=4)
    )
    text = "\n".join([",".join(columns), *rows])
    (tmp_path / f"{kind}.csv").write_bytes(text.encode("utf-8", "surrogatepass"))
    assert log_or_refusal(tmp_path)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(sorted(KINDS)), content=st.binary(max_size=200))
def test_any_bytes_give_a_plain_refusal(tmp_path, kind, content):
    write_csv(tmp_path, **dict.fromkeys(KINDS))
    (tmp_path / f"{kind}.csv").write_bytes(content)
    with pytest.raises(ConfigError):
        read_log(tmp_path)


def test_reads_fast(tmp_path):
    """100,000 rows take less than 2 s of one core; half of it where nothing else runs."""
    rows = [f"{0.01 * k:.2f},robot_{k % 3},0.001,-0.002,0.1234567,0.1,-0.2,9.8123" for k in range(100_000)]
    write_csv(tmp_path, imu=[IMU_HEADER, *rows])

    def reading_s() -> float:
        start = time.process_time()
        assert len(read_log(tmp_path).events) == 100_000
        return time.process_time() - start

    assert any(reading_s() < 2.0 for _ in range(3))

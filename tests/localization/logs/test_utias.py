from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from coop_envs.errors import ConfigError
from coop_envs.localization.logs.events import Log, Odometry, RangeBearing
from coop_envs.localization.logs.utias import Landmarks, UtiasReading, is_utias, read_utias
from coop_envs.localization.planar.localizer import localize_planar
from tests.localization.logs.utias_folder import BEGIN_S, write_utias
from tests.localization.planar.generated_logs import BEARING_SIGMA_RAD, RANGE_SIGMA_M, make_log

EXACT = UtiasReading(range_sigma_m=RANGE_SIGMA_M, range_sigma_share=0.0, bearing_sigma_rad=BEARING_SIGMA_RAD)


@pytest.fixture(scope="module")
def log():
    return make_log(0, seconds=8.0)


@pytest.fixture
def folder(tmp_path, log):
    write_utias(tmp_path, log)
    return tmp_path


def told(folder, **options) -> str:
    with pytest.raises(ConfigError) as error:
        read_utias(folder, UtiasReading(**options))
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_folder_is_read_as_it_was_written(folder, log):
    assert is_utias(folder)
    read = read_utias(folder, EXACT)
    assert read.robots == ("robot_1", "robot_2", "robot_3")
    assert read.notes == () and read.starts == {} and read.team is None
    assert list(read.landmarks.values()) == list(log.landmarks.values())
    assert len(read.events) == len(log.events)
    assert all(a.time_s <= b.time_s for a, b in zip(read.events, read.events[1:], strict=False))
    ours = [e for e in read.events if isinstance(e, RangeBearing) and e.robot == "robot_2"]
    theirs = [e for e in log.events if isinstance(e, RangeBearing) and e.robot == "robot_1"]
    for a, b in zip(ours, theirs, strict=True):
        assert a.time_s - BEGIN_S == pytest.approx(b.time_s, abs=1e-3)
        assert (a.range_m, a.bearing_rad) == pytest.approx((b.range_m, b.bearing_rad), abs=1e-6)
        assert (a.range_sigma_m, a.bearing_sigma_rad) == (RANGE_SIGMA_M, BEARING_SIGMA_RAD)
    np.testing.assert_allclose(read.truth["robot_3"].rotation, log.truth["robot_2"].rotation, atol=1e-7)


def test_it_is_localized(folder, log):
    result = localize_planar(read_utias(folder, EXACT))
    assert result.frame == "world"
    for k, name in enumerate(log.robots):
        path, truth = result.paths[f"robot_{k + 1}"], log.truth[name]
        assert np.linalg.norm(path.position[-1] - truth.position[-1]) < 0.1


def test_landmarks_may_be_unknown_or_unseen(folder, log):
    unknown = read_utias(folder, UtiasReading(landmarks=Landmarks.UNKNOWN, starts_by_truth=True))
    assert unknown.landmarks == {}
    assert any(isinstance(e, RangeBearing) and e.subject == "landmark_4" for e in unknown.events)
    x, y, yaw = log.starts["robot_1"]
    assert unknown.starts["robot_2"] == pytest.approx((x, y, yaw), abs=1e-6)
    none = read_utias(folder, UtiasReading(landmarks=Landmarks.NONE, starts_by_truth=True))
    seen = {e.subject for e in none.events if isinstance(e, RangeBearing)}
    assert seen and seen <= set(none.robots)


def test_a_span_of_time(folder):
    part = read_utias(folder, UtiasReading(first_s=2.0, length_s=3.0))
    times = np.array([e.time_s for e in part.events]) - BEGIN_S
    assert 1.99 < times.min() < 2.1 and 4.9 < times.max() < 5.01


def test_strange_barcodes_are_left_out_and_told(folder):
    path = folder / "Robot1_Measurement.dat"
    before = read_utias(folder)
    path.write_text(path.read_text() + f"{BEGIN_S + 9:.3f} 99 1.0 0.1\n{BEGIN_S + 9:.3f} 14 1.0 0.1\n")
    after = read_utias(folder)
    assert len(after.events) == len(before.events)
    assert after.notes == (
        "1 measurements of barcodes that nobody carries left out",
        "1 measurements of the seer itself left out",
    )


@pytest.mark.parametrize(
    ("file", "line", "message"),
    [
        ("Robot2_Odometry.dat", "1.0 0.1", "Robot2_Odometry.dat:164: got '1.0 0.1', expected 3 columns"),
        (
            "Robot2_Odometry.dat",
            f"{BEGIN_S + 9} x 0",
            "Robot2_Odometry.dat:164: forward_m_s: got 'x', expected a number",
        ),
        ("Robot2_Odometry.dat", f"{BEGIN_S + 9} 0.1 nan", "Robot2_Odometry.dat:164: yaw_rate_rad_s: got 'nan'"),
        ("Robot2_Odometry.dat", f"{BEGIN_S - 9} 0.1 0.1", "Robot2_Odometry.dat:164: time_s: got"),
        ("Robot1_Measurement.dat", f"{BEGIN_S + 9} 14 -1.0 0.1", "range_m: got '-1.0', expected 0 or more"),
        ("Robot1_Measurement.dat", f"{BEGIN_S + 9} 14.5 1.0 0.1", "barcode: got '14.5', expected a whole number"),
        ("Robot3_Groundtruth.dat", f"{BEGIN_S + 9} inf 0 0", "x_m: got 'inf', expected a finite number"),
        ("Barcodes.dat", "30 14", "Barcodes.dat: barcode: got [14], expected each barcode once"),
        ("Landmark_Groundtruth.dat", "30 1 2 -1 0.1", "x_sigma_m: got '-1', expected 0 or more"),
    ],
)
def test_bad_lines_are_refused_with_file_line_and_field(folder, file, line, message):
    path = folder / file
    path.write_text(path.read_text() + line + "\n")
    assert message in told(folder)


def test_missing_files(folder, tmp_path):
    (folder / "Robot1_Measurement.dat").unlink()
    (folder / "Robot1_Groundtruth.dat").unlink()
    (folder / "Landmark_Groundtruth.dat").unlink()
    log = read_utias(folder)
    assert "robot_1" not in log.truth and not log.landmarks
    assert any(isinstance(e, Odometry) and e.robot == "robot_1" for e in log.events)
    (folder / "Barcodes.dat").unlink()
    assert "Barcodes.dat" in told(folder)
    assert not is_utias(folder)
    assert "Barcodes.dat" in told(tmp_path / "nowhere")


def test_a_file_that_is_no_text(folder):
    (folder / "Robot1_Odometry.dat").write_bytes(b"\xff\xfe\x00")
    assert "Robot1_Odometry.dat" in told(folder)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.one_of(st.binary(max_size=80), st.text("0123456789.eE+-# \t\nnaif", max_size=80).map(str.encode)))
def test_any_bytes_give_a_log_or_one_line(tmp_path, data):
    (tmp_path / "Barcodes.dat").write_text("1 5\n2 14\n")
    (tmp_path / "Robot1_Odometry.dat").write_bytes(data)
    (tmp_path / "Robot1_Measurement.dat").write_bytes(data)
    try:
        read = read_utias(tmp_path)
    except ConfigError as error:
        read = str(error)
    assert isinstance(read, Log) or "\n" not in read

"""What the example records, held against the laws it was recorded under."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coop_envs.localization.logs.events import ImuSample, Log, Odometry, PoseSighting
from coop_envs.localization.logs.read_log import read_log
from coop_envs.localization.logs.tum import read_tum
from coop_envs.localization.trajectories import drift, in_team_frame, interpolated, path_length_m, yaw_of
from coop_envs.sensing.camera import body_from_camera

ROOT = Path(__file__).parents[2]


def record(out: Path, *options: str) -> Log:
    command = [sys.executable, "examples/record_log.py", "--out", str(out), *options]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0 and run.stdout.startswith(f"{out}: "), run.stderr
    return read_log(out)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Log:
    return record(tmp_path_factory.mktemp("record") / "log", "--increments", "1")


def test_the_mission_is_an_inchworm_increment(log):
    assert log.robots == ("observer_0", "picket_0", "picket_1") and log.notes == ()
    for name in log.robots:
        assert path_length_m(log.truth[name].position, 0.02) == pytest.approx(0.95 * 0.2 * 2.5, rel=0.15)


def test_it_starts_where_people_set_it_down(log):
    truth = in_team_frame(log.truth, "observer_0", log.truth["observer_0"].time_s[0])
    for name, (x, y, yaw) in log.starts.items():
        assert np.allclose(truth[name].position[0, :2], (x, y), atol=0.025)
        assert yaw_of(truth[name].rotation)[0] == pytest.approx(yaw, abs=0.15)


def test_sightings_are_as_good_as_they_say(log):
    """Squared Mahalanobis distance per freedom of the relative poses, outliers aside."""
    camera = log.team.members[0].camera
    R_body_camera, p_body_camera = body_from_camera(camera.pitch_down_rad), np.array(camera.position_m)
    distances = []
    for event in (event for event in log.events if isinstance(event, PoseSighting)):
        see, seen = (interpolated(log.truth[name], np.array([event.time_s])) for name in (event.camera, event.robot))
        R = (see.rotation[0] @ R_body_camera).T
        p = R @ (seen.position[0] - see.position[0] - see.rotation[0] @ p_body_camera)
        turn = Rotation.from_matrix(event.rotation @ (R @ seen.rotation[0]).T).as_rotvec()
        e = np.concatenate([turn, event.position - p])
        distances.append(e @ np.linalg.solve(event.covariance, e) / 6.0)
    assert len(distances) > 400
    assert 0.8 < np.median(distances) < 1.25  # chi-square with 6 freedoms, over 6: 0.89
    assert np.mean(np.array(distances) > 4.0) < 0.03


def test_imu_and_wheels_agree_with_the_truth(log):
    for name in log.robots:
        truth = log.truth[name]
        samples = [event for event in log.events if isinstance(event, ImuSample) and event.robot == name]
        wheels = [event for event in log.events if isinstance(event, Odometry) and event.robot == name]
        assert len(samples) == len(wheels) == len(truth.time_s)
        assert np.allclose([event.time_s for event in samples], truth.time_s)
        assert np.allclose([event.time_s for event in wheels], truth.time_s - 1 / 30)
        turn = sum(event.gyro[2] for event in samples[1:]) / 30
        turned = np.unwrap(yaw_of(truth.rotation))
        assert turn == pytest.approx(turned[-1] - turned[0], abs=math.radians(3.0))
        assert np.linalg.norm(np.mean([event.accel for event in samples], axis=0)) == pytest.approx(9.81, abs=0.1)
        gone = sum(event.forward_m_s for event in wheels) / 30
        assert gone == pytest.approx(np.linalg.norm(truth.position[-1] - truth.position[0]), rel=0.1)


@pytest.mark.slow
def test_the_same_seed_records_the_same_and_one_file_holds_it_too(log, tmp_path):
    again = record(tmp_path / "log.mcap", "--increments", "1")
    assert len(again.events) == len(log.events)
    for a, b in zip(log.events, again.events, strict=True):
        assert type(a) is type(b) and a.time_s == b.time_s
        if isinstance(a, ImuSample) and isinstance(b, ImuSample):
            assert np.array_equal(a.gyro, b.gyro)


@pytest.mark.slow
def test_the_guide_as_it_stands(tmp_path):
    """The commands of docs/localizing.md, in another folder."""
    text = (ROOT / "docs" / "localizing.md").read_text(encoding="utf-8")
    lines = [
        line.replace("out/", f"{tmp_path}/") for line in text.partition("```bash\n")[2].partition("```")[0].splitlines()
    ]
    localize = "import sys; from coop_envs.localization.command import main; sys.exit(main(sys.argv[1:]))"
    assert [line.split()[0] for line in lines] == ["python", "coop"]
    for line in lines:
        program, *arguments = line.split()
        given = arguments if program == "python" else ["-c", localize, *arguments[1:]]
        run = subprocess.run([sys.executable, *given], cwd=ROOT, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
    written = {path.name for path in (tmp_path / "localized").iterdir()}
    assert {"events.csv", "results.json", "trajectories.png", "observer_0.tum", "picket_0.tum"} <= written
    results = json.loads((tmp_path / "localized" / "results.json").read_text())["robots"]
    truth = in_team_frame(read_log(tmp_path / "log").truth, "observer_0", 1 / 30)
    for name, found in results.items():
        path = read_tum(tmp_path / "localized" / f"{name}.tum")
        assert drift(path, truth[name]).position_m == pytest.approx(found["position_drift_m"], abs=2e-4)
        assert found["position_drift_m"] < 0.02 and found["nees_mean"] < 3.0

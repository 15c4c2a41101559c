"""`coop localize`: files out, figures printed, mistakes told in one line."""

from __future__ import annotations

import csv
import dataclasses
import json

import numpy as np
import pytest

from coop_envs import cli
from coop_envs.localization.command import Options, chosen_settings, main
from coop_envs.localization.logs.read_log import write_log
from coop_envs.localization.logs.tum import read_tum
from coop_envs.localization.result_files import file_name
from tests.localization.generated_team import generated_log


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "log"
    write_log(folder, generated_log(increments=1, imu_hz=30.0))
    return folder


def test_files_and_figures(log, tmp_path, capsys):
    out = tmp_path / "out"
    assert main([str(log), "--out", str(out), "--clocks", "stamps", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((out / "results.json").read_text())
    assert document["frame"] == "team" and set(document["robots"]) == {"observer_0", "picket_0", "picket_1"}
    observer = document["robots"]["observer_0"]
    assert observer["position_drift_m"] < 0.01 and 0.0 < observer["nees_mean"] < 3.0
    path = read_tum(out / "observer_0.tum")
    assert len(path.time_s) == observer["poses"]
    assert np.linalg.norm(path.position[-1] - (0.3, 0.0, 0.0)) < 0.05
    rows = list(csv.DictReader((out / "events.csv").open()))
    assert {row["kind"] for row in rows} >= {"rest begins", "rest ends"}
    assert [float(row["time_s"]) for row in rows] == sorted(float(row["time_s"]) for row in rows)
    assert (out / "trajectories.png").read_bytes().startswith(b"\x89PNG")
    assert not list(out.glob("*.part*"))


def test_a_table_with_drift_and_nees(log, tmp_path, capsys):
    assert main([str(log), "--out", str(tmp_path), "--self-calibrate", "--clocks", "stamps"]) == 0
    shown = capsys.readouterr()
    for word in ("observer_0", "drift (m)", "NEES"):
        assert word in shown.out
    assert "written to" in shown.err


def test_without_truth_there_is_no_drift(tmp_path, capsys):
    blind = dataclasses.replace(generated_log(increments=1, imu_hz=30.0), truth={})
    write_log(tmp_path / "log", blind)
    assert main([str(tmp_path / "log"), "--out", str(tmp_path / "out"), "--clocks", "stamps"]) == 0
    assert "drift" not in capsys.readouterr().out


def test_settings_from_a_file(tmp_path):
    file = tmp_path / "settings.yaml"
    file.write_text("bridge_s: 0.5\nestimation: {rest_s: 0.5}\n")
    found = chosen_settings(Options(tmp_path, settings=file, clocks="turns", self_calibrate=True))
    assert (found.bridge_s, found.clocks, found.estimation.rest_s) == (0.5, "turns", 0.5)
    assert found.estimation.focal_sigma == 0.005


def test_the_settings_say_how_vague_a_calibration_is(tmp_path):
    file = tmp_path / "settings.yaml"
    file.write_text("estimation: {focal_sigma: 0.02}\n")
    found = chosen_settings(Options(tmp_path, settings=file, self_calibrate=True)).estimation
    assert (found.focal_sigma, found.hat_sigma_m) == (0.02, 0.001)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["{tmp}/nothing"], "error: log: got "),
        (["{log}", "--settings", "{tmp}/none.yaml"], "error: settings: got "),
        (["{log}", "--settings", "{tmp}/bad.yaml"], "error: settings.bridg_s: got 'bridg_s', expected one of"),
        (["{log}", "--clocks", "sundial"], "error: "),
        (["{log}", "--out", "{tmp}/bad.yaml"], "error: out: got "),
        (["{log}", "--out", "{tmp}/bad.yaml/out"], "error: out: got "),
        (["{tmp}"], "error: log: got '{tmp} with bad.yaml', expected a folder with imu.csv or odometry.csv"),
    ],
)
def test_mistakes_in_one_line(log, tmp_path, capsys, arguments, expected):
    (tmp_path / "bad.yaml").write_text("bridg_s: 1\n")
    told = [word.format(log=log, tmp=tmp_path) for word in arguments]
    assert cli.guarded(lambda: main(told)) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert error.startswith(expected.format(tmp=tmp_path))


def test_who_carries_the_camera_must_be_told(log, tmp_path, capsys):
    (log / "team.yaml").rename(tmp_path / "kept.yaml")
    try:
        assert cli.guarded(lambda: main([str(log), "--out", str(tmp_path / "out")])) == 2
        assert main([str(log), "--team", str(tmp_path / "kept.yaml"), "--out", str(tmp_path / "out")]) == 0
    finally:
        (tmp_path / "kept.yaml").rename(log / "team.yaml")
    assert capsys.readouterr().err.startswith("error: team: got None, expected a team (team.yaml or --team)")


def test_names_become_file_names():
    assert file_name("picket_0") == "picket_0"
    assert file_name("../a b/ü") == "_a_b_ü"
    assert file_name("..") == "robot"

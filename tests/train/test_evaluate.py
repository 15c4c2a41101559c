"""`coop evaluate` on an environment that costs nothing: outputs, failures, interruption, bad input."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from coop_envs.errors import ConfigError
from coop_envs.recording import EpisodeReader
from tests.train.fake_team import DECISION_S, LIMIT_S, make_env
from train.episode import coverage_times
from train.evaluate import Options, evaluate
from train.results import METRICS

ROOT = Path(__file__).parents[2]
STILL = str(Path(__file__).with_name("still_policy.py"))


@pytest.fixture
def options(tmp_path):
    return Options(policy=(STILL,), episodes=3, jobs=2, out=tmp_path / "out")


def results(folder: Path) -> dict:
    return json.loads((folder / "results.json").read_text())


def test_outputs_are_complete(options, tmp_path, capsys):
    twin = tmp_path / "twin.py"
    shutil.copy(STILL, twin)
    options = dataclasses.replace(options, policy=(STILL, str(twin)), seed=4)
    assert evaluate(options, "coop evaluate ...", make_env) == 0
    document = results(options.out)
    assert document["status"] == "complete"
    assert list(document["policies"]) == ["still_policy", "twin"]
    rows = document["policies"]["twin"]["episodes"]
    assert [row["seed"] for row in rows] == [4, 5, 6]
    assert [row["world_index"] for row in rows] == [0, 1, 2]
    assert set(METRICS) <= set(rows[0])
    assert rows[0]["drift_percent_of_path"] is None
    assert rows[0]["series"]["time_s"] == [float(second) for second in range(int(LIMIT_S) + 1)]
    assert rows[0]["series"]["pickets_lost"][-1] == 1
    summary = document["policies"]["twin"]["summary"]
    assert summary["success"]["kind"] == "rate"
    assert summary["success"]["value"] == pytest.approx(2 / 3)
    assert summary["coverage"]["low"] <= summary["coverage"]["value"] <= summary["coverage"]["high"]
    same = {c["metric"]: (c["value"], c["low"], c["high"]) for c in document["comparisons"]}
    assert same["pickets_lost_per_mapped_m2"] == (0.0, 0.0, 0.0)
    assert min(path.name for path in (options.out / "episodes").iterdir()) == "still_policy_0000.mcap"
    assert "twin" in capsys.readouterr().out
    assert (options.out / "report.html").is_file()


def test_same_seed_same_results_whatever_the_number_of_processes(options, tmp_path):
    def figures(jobs: int) -> list[dict]:
        out = tmp_path / str(jobs)
        assert evaluate(dataclasses.replace(options, jobs=jobs, out=out), "", make_env) == 0
        rows = results(out)["policies"]["still_policy"]["episodes"]
        return [{key: value for key, value in row.items() if key != "wall_s"} for row in rows]

    assert figures(1) == figures(3)


def test_logs_hold_a_frame_each_second(options):
    evaluate(dataclasses.replace(options, episodes=1), "coop evaluate", make_env)
    log = EpisodeReader(options.out / "episodes" / "still_policy_0000.mcap")
    times = [frame.time_s for frame in log.frames()]
    assert times == [float(second) for second in range(int(LIMIT_S) + 1)]


def test_every_point_is_kept_though_frames_come_once_a_second(options):
    options = dataclasses.replace(options, episodes=1, team="surveyors")
    assert evaluate(options, "", make_env) == 0
    decisions = round(LIMIT_S / DECISION_S)
    row = results(options.out)["policies"]["still_policy"]["episodes"][0]
    assert row["points_measured"] == decisions + 1
    assert row["reach_m"] == pytest.approx(0.01 * decisions)
    frames = list(EpisodeReader(options.out / "episodes" / "still_policy_0000.mcap").frames())
    assert [len(frame.scan) for frame in frames] == [1] + [5] * int(LIMIT_S)
    assert [len(frame.map_volume) for frame in frames] == [0] * int(LIMIT_S) + [2]
    x = np.concatenate([frame.points_m[:, 0] for frame in frames])
    np.testing.assert_allclose(x, 0.01 * np.arange(decisions + 1))


def test_teams_without_lasers_report_no_points(options):
    evaluate(dataclasses.replace(options, episodes=1), "", make_env)
    assert "points_measured" not in results(options.out)["policies"]["still_policy"]["episodes"][0]


def test_a_crashed_episode_counts_as_a_failure_and_the_rest_goes_on(options, monkeypatch, capsys):
    monkeypatch.setenv("FAIL_SEED", "1")
    assert evaluate(options, "", make_env) == 1
    entry = results(options.out)["policies"]["still_policy"]
    assert [row["status"] for row in entry["episodes"]] == ["finished", "crashed", "finished"]
    crashed = entry["episodes"][1]
    assert crashed["error"].startswith("RuntimeError: the policy gave up (still_policy.py:")
    assert (crashed["success"], crashed["coverage"], crashed["energy_j"]) == (False, 0.0, None)
    assert entry["summary"]["success"]["n"] == entry["summary"]["coverage"]["n"] == 3
    assert not list((options.out / "episodes").glob("*.part*"))
    assert "crashed" in capsys.readouterr().err


def test_json_is_all_there_is_on_stdout(options, capsys):
    evaluate(dataclasses.replace(options, json=True), "", make_env)
    assert json.loads(capsys.readouterr().out) == results(options.out)


@pytest.mark.render
def test_video(options):
    assert evaluate(dataclasses.replace(options, episodes=1, video=True), "", make_env) == 0
    assert [path.stem for path in (options.out / "videos").iterdir()] == ["still_policy_0000"]


def test_an_earlier_evaluation_is_replaced_and_foreign_files_are_kept(options):
    evaluate(options, "", make_env)
    (options.out / "notes.txt").write_text("mine")
    evaluate(dataclasses.replace(options, episodes=1), "", make_env)
    assert len(list((options.out / "episodes").iterdir())) == 1
    assert (options.out / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"policy": ()}, "policy"),
        ({"policy": (STILL, STILL)}, "policy"),
        ({"policy": ("random_wlak",)}, "policy"),
        ({"policy": ("missing.py",)}, "policy"),
        ({"episodes": 0}, "episodes"),
        ({"seed": -1}, "seed"),
        ({"jobs": 0}, "jobs"),
        ({"scenario": "moon"}, "scenario"),
        ({"team": "dream"}, "team"),
    ],
)
def test_bad_input_is_refused_before_anything_is_written(options, change, field):
    with pytest.raises(ConfigError) as refused:
        evaluate(dataclasses.replace(options, **change), "", make_env)
    assert refused.value.field.startswith(field)
    assert "\n" not in str(refused.value)
    assert not options.out.exists()


def test_a_policy_whose_needs_the_team_does_not_meet_is_refused(options, monkeypatch):
    monkeypatch.setenv("LASERS_NEEDED", "9")
    with pytest.raises(ConfigError, match=r"lasers: got \d, expected at least 9"):
        evaluate(options, "", make_env)
    assert not options.out.exists()


def test_a_folder_with_something_else_in_it_is_refused(options):
    options.out.mkdir()
    (options.out / "thesis.tex").write_text("precious")
    with pytest.raises(ConfigError, match="out"):
        evaluate(options, "", make_env)
    assert [path.name for path in options.out.iterdir()] == ["thesis.tex"]


def test_a_folder_below_a_file_is_refused(options, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="out"):
        evaluate(dataclasses.replace(options, out=tmp_path / "file" / "out"), "", make_env)


def test_ctrl_c_keeps_finished_episodes_and_says_so(tmp_path):
    out = tmp_path / "out"
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"  # a background job ignores it
        "from pathlib import Path; from coop_envs.cli import guarded;"
        "from tests.train.fake_team import make_env; from train.evaluate import Options, evaluate;"
        f"options = Options(policy=({STILL!r},), episodes=50, jobs=2, out=Path({str(out)!r}));"
        "sys.exit(guarded(lambda: evaluate(options, 'coop evaluate', make_env)))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env=os.environ | {"SLOW_S": "0.01"},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and not (out / "results.json").is_file():
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    _, complaint = process.communicate(timeout=30)
    assert process.returncode == 130
    document = results(out)
    finished = len(document["policies"]["still_policy"]["episodes"])
    assert document["status"] == "interrupted"
    assert 1 <= finished < 50
    assert f"interrupted: {finished} of 50 episodes had finished and are kept" in complaint
    assert "Traceback" not in complaint
    assert len(list((out / "episodes").iterdir())) == finished


def test_coverage_times_on_a_straight_line():
    series = {"time_s": [0.0, 1.0, 2.0, 3.0, 4.0], "coverage": [0.0, 0.25, 0.5, 0.75, 1.0]}
    assert coverage_times(series, limit_s=8.0) == {"t50_s": 2.0, "t90_s": 4.0, "t99_s": 4.0, "coverage_auc": 0.75}
    assert coverage_times({"time_s": [0.0, 5.0], "coverage": [0.0, 0.0]}, 5.0)["t50_s"] is None

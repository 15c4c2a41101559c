"""What the planar example records, and what localizing makes of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from coop_envs.localization.logs.events import Fix, Log, RangeBearing
from coop_envs.localization.logs.read_log import read_log
from coop_envs.localization.planar.localizer import localize_planar
from tests.localization.planar.generated_logs import path_errors

ROOT = Path(__file__).parents[2]


def record(out: Path, *options: str) -> Log:
    command = [sys.executable, "examples/record_planar_log.py", "--out", str(out), *options]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0 and run.stdout.startswith(f"{out}: "), run.stderr
    return read_log(out)


def test_landmarks_place_robots_that_nobody_told_of(tmp_path):
    log = record(tmp_path / "log", "--seconds", "30")
    assert len(log.robots) == 5 and len(log.landmarks) == 8 and not log.starts and log.team is None
    seen = {event.subject for event in log.events if isinstance(event, RangeBearing)}
    assert seen > set(log.robots)
    result = localize_planar(log)
    assert result.frame == "world" and not result.notes and set(result.paths) == set(log.robots)
    for _, place, _, nees in path_errors(result, log).values():
        assert place[-1] < 0.1
        assert nees.mean() < 2.0


@pytest.mark.parametrize("name", ["log.mcap", pytest.param("log", marks=pytest.mark.slow)])
def test_two_fixes_place_a_team_with_a_frame_of_its_own(tmp_path, name):
    log = record(tmp_path / name, "--fixes", "--seconds", "20")
    assert sum(isinstance(event, Fix) for event in log.events) == 2 and not log.landmarks
    assert log.starts["robot_0"] == (0.0, 0.0, 0.0)
    result = localize_planar(log)
    assert result.frame == "world"
    errors = path_errors(result, log)
    assert np.mean([nees.mean() for _, _, _, nees in errors.values()]) < 2.5
    for times, place, _, _ in errors.values():
        assert times[0] < 0.5 and place.max() < 0.5

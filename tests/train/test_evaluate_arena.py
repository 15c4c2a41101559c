"""`coop evaluate` on the real environment: one short comparison, and every kind of bad input in one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from coop_envs.cli import main
from train.results import METRICS

STILL = str(Path(__file__).with_name("still_policy.py"))
SHORT = """
name: short
description: The arena of chapter 2 for half a minute.
environment: {geometry: {kind: arena}}
team: scouts
task: {success: goal, time_limit_s: 30}
"""


@pytest.fixture
def short(tmp_path) -> str:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return str(path)


def test_two_policies_on_the_same_worlds(short, tmp_path):
    out = tmp_path / "out"
    command = ["evaluate", "--scenario", short, "--policy", "random_walk", STILL, "--episodes", "2", "--out", str(out)]
    assert main(command) == 0
    policies = json.loads((out / "results.json").read_text())["policies"]
    rows = policies["random_walk"]["episodes"] + policies["still_policy"]["episodes"]
    assert [row["error"] for row in rows] == [None] * 4
    assert all(set(METRICS) <= set(row) for row in rows)
    assert [row["seed"] for row in rows] == [0, 1, 0, 1]
    assert policies["random_walk"]["summary"]["coverage"]["value"] > 0
    assert policies["still_policy"]["summary"]["action_energy_j"]["value"] < 200
    assert len(list((out / "episodes").glob("*.mcap"))) == 4
    assert "random_walk" in (out / "report.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--scenario", "arean"], "arean"),
        (["--scenario", "missing.yaml"], "missing.yaml"),
        (["--team", "scoots"], "scoots"),
        (["--fidelity", "photos"], "photos"),
        (["--physics", "slow"], "slow"),
        (["--world", "missing.ply"], "missing.ply"),
        (["--world", "world.txt"], "world.txt"),
        (["--policy", "goal_grd"], "goal_grd"),
        (["--split", "test"], "test"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(arguments, named, tmp_path, capsys):
    out = tmp_path / "out"
    given = arguments if "--policy" in arguments else [*arguments, "--policy", STILL]
    code = main(["evaluate", *given, "--episodes", "1", "--out", str(out)])
    complaint = capsys.readouterr().err
    assert code == 2
    assert named in complaint
    assert len([line for line in complaint.splitlines() if line.startswith("error: ")]) == 1
    assert not out.exists()


def test_an_unknown_key_is_named(tmp_path, capsys):
    path = tmp_path / "typo.yaml"
    path.write_text(SHORT + "rewards: {goal: 5}\n")
    assert main(["evaluate", "--scenario", str(path), "--policy", STILL, "--out", str(tmp_path / "out")]) == 2
    assert "rewards" in capsys.readouterr().err


@pytest.mark.parametrize("fault", ["nan", "steep"])
def test_a_mesh_without_ground_is_refused(fault, tmp_path, capsys):
    box = trimesh.creation.box((2.0, 2.0, 0.1))
    if fault == "nan":
        box.vertices[0] = np.nan
    else:
        box.apply_transform(trimesh.transformations.rotation_matrix(1.2, [1, 0, 0]))
    path = tmp_path / "world.stl"
    box.export(path)
    out = tmp_path / "out"
    assert main(["evaluate", "--world", str(path), "--policy", STILL, "--out", str(out)]) == 2
    assert capsys.readouterr().err.count("error: ") == 1
    assert not out.exists()

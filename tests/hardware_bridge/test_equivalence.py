"""The same policy and seed in simulation and through each kind of emulated robot come to the same, within 10 %.

Whole runs through processes, ports and the robots' own bytes. Noise is keyed by tick and robot, so a run and its twin
differ in little more than what links do to numbers and times.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.hardware_bridge.equivalence import Loops, Run, emulated, simulated
from tests.hardware_bridge.ros import process_master

SECONDS = 45.0
SERIAL = {"kind": "zumy_serial", "poll_hz": 1000}
UDP = {"kind": "simulator"}
RADIOS = [
    {"kind": "velociroach_xbee", "address": a, "firmware": ["emulated roach"], "hat_brightness": 0.8, "poll_hz": 200}
    for a in (0x2052, 0x2053)
]
ROACHES = {
    "name": "roaches",
    "members": [
        {"role": "observer", "robot": "zumy", "cameras": ["lifecam_mast"]},
        {"role": "picket", "robot": "velociroach_radio", "hat": "zumy"},
        {"role": "picket", "robot": "velociroach_radio", "hat": "zumy2"},
    ],
}
TEAMS: dict[str, tuple[Any, list[Any]]] = {
    "serial": ("inchworm", [SERIAL] * 3),
    "udp": ("inchworm", [UDP] * 3),
    "xbee": (ROACHES, [SERIAL, *RADIOS]),
}
KINDS = [*TEAMS, pytest.param("ros", marks=pytest.mark.ros)]


def team_and_links(kind: str) -> tuple[Any, list[Any]]:
    """A team and its links; those over ROS use this process's master, for rospy knows one alone."""
    if kind != "ros":
        return TEAMS[kind]
    return "inchworm", [{"kind": "zumy_ros1", "master": process_master(), "namespace": f"/twin{i}"} for i in range(3)]


def twins(folder: Path, kind: str, seed: int, seconds: float) -> tuple[Run, Run]:
    """A run through emulated robots and the same in simulation."""
    team, links = team_and_links(kind)
    policy = Loops()
    return emulated(folder, team, links, "u_turn", seed, seconds, policy), simulated(
        team, "u_turn", seed, seconds, policy
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_through_emulated_robots_goes_the_same_way(tmp_path, kind):
    ours, theirs = twins(tmp_path, kind, seed=0, seconds=6.0)
    assert ours.path_m == pytest.approx(theirs.path_m, rel=0.01)
    assert ours.path_error_m < 2.0 * theirs.path_error_m + 0.005


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_errors_and_drift_of_thirty_runs_are_equal_within_ten_percent(tmp_path, kind):
    pairs = [twins(tmp_path, kind, seed, SECONDS) for seed in range(30)]
    for name in ("path_error_m", "drift_m"):
        ours, theirs = (np.array([getattr(run, name) for run in runs]) for runs in zip(*pairs, strict=True))
        ratio = ours.mean() / theirs.mean()
        spread = (ours - theirs).std() / np.sqrt(len(pairs)) / theirs.mean()
        print(f"{kind} {name}: {ours.mean():.5f} against {theirs.mean():.5f}, ratio {ratio:.3f} +/- {spread:.3f}")
        assert 0.9 < ratio < 1.1

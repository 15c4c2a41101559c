"""Whatever breaks, robots stand: what is demanded of whom is in `faults`. ``pytest -s`` prints a table of times."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from hardware_bridge.deployment import load_deployment
from hardware_bridge.emulation import EmulationProcess
from tests.hardware_bridge.faults import ALLOWED_S, LINK_KINDS, TEAM_KINDS, Verdict, deck, team_of

ROOT = Path(__file__).parents[2]
COUNT = 10
SOON = [("zumys", 0), ("zumys", 1), ("roach", 0), ("ros", 0)]
LATER = [
    *(("zumys", seed) for seed in range(2, 18)),
    *(("roach", seed) for seed in range(1, 15)),
    ("ros", 1),
    ("ros", 2),
]
PATIENCE_S = 300.0


def campaigns() -> list[object]:
    """30 faults soon and 300 later, and more where there is ROS."""
    marked = []
    for team, seed in SOON + LATER:
        marks = [pytest.mark.ros] * (team == "ros") + [pytest.mark.slow] * ((team, seed) in LATER)
        marked.append(pytest.param(team, seed, marks=marks, id=f"{team}-{seed}"))
    return marked


@pytest.fixture(scope="module")
def table() -> Iterator[list[Verdict]]:
    """Every verdict; printed in the end."""
    verdicts: list[Verdict] = []
    yield verdicts
    rows = defaultdict(list)
    for verdict in verdicts:
        rows[verdict.kind].append(verdict)
    print(f"\n{'fault':12} count  wrong  worst time to zero")
    for kind, own in sorted(rows.items()):
        worst_s = max((v.worst_s for v in own if v.worst_s is not None), default=None)
        told = "nobody has to stop" if worst_s is None else f"{worst_s:.3f} s"
        print(f"{kind:12} {len(own):5}  {sum(bool(v.wrong) for v in own):5}  {told}")


@pytest.mark.parametrize(("team", "seed"), campaigns())
def test_faults(team: str, seed: int, table: list[Verdict]):
    command = [sys.executable, "-m", "tests.hardware_bridge.fault_campaign", team, str(seed), str(COUNT)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert run.returncode == 0, run.stderr
    verdicts = [Verdict(**json.loads(line)) for line in run.stdout.splitlines() if line.startswith("{")]
    table += verdicts
    assert len(verdicts) == COUNT
    assert [v for v in verdicts if v.wrong] == [], run.stderr


def test_the_first_campaigns_know_every_kind_of_fault():
    soon = {fault.kind for team, seed in SOON if team != "ros" for fault in deck(team, seed, COUNT)}
    assert soon >= {*TEAM_KINDS, *(kind for name in ("zumy_serial", "simulator") for kind in LINK_KINDS[name])}
    assert "roscore" in {fault.kind for fault in deck("ros", 0, COUNT)}


def test_all_campaigns_break_every_link_in_every_way():
    for team in ("zumys", "roach", "ros"):
        dealt = {f for name, seed in SOON + LATER if name == team for f in deck(team, seed, COUNT)}
        links = {name: wiring["link"]["kind"] for name, wiring in team_of(team)["robots"].items()}
        assert {(f.robot, f.kind) for f in dealt if f.robot} == {(n, k) for n in links for k in LINK_KINDS[links[n]]}


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_velociroach_stops_by_itself_when_the_bridge_is_gone(number: signal.Signals, tmp_path: Path):
    """Nobody can help a Zumy then: its firmware goes on as it was last told."""
    file = tmp_path / "team.yaml"
    file.write_text(json.dumps(team_of("roach")))
    with EmulationProcess(file) as emulation:
        host, port = emulation.address
        settings = json.dumps(dataclasses.asdict(emulation.settled(load_deployment(file))))
        command = [sys.executable, "-m", "tests.hardware_bridge.fault_host", settings, host, str(port)]
        with subprocess.Popen(command, cwd=ROOT) as bridge:
            try:
                assert seconds_until_standing(emulation, 1, stands=False) < PATIENCE_S
                os.kill(bridge.pid, number)
                assert seconds_until_standing(emulation, 1, stands=True) < ALLOWED_S
            finally:
                bridge.kill()


def seconds_until_standing(emulation: EmulationProcess, robot: int, *, stands: bool) -> float:
    began = time.monotonic()
    while time.monotonic() < began + PATIENCE_S / 10:
        if (emulation.truth()["set_wheels"][robot] == [0.0, 0.0]) == stands:
            return time.monotonic() - began
        time.sleep(0.01)
    return float("inf")

"""Speed of the team filter: one team, many teams, a hundred robots. Prints a table and writes JSON.

    python benchmarks/bench_localizing.py [--out FILE.json] [--quick]

A step carries every robot that moves over one tick of its IMU and fuses what the cameras saw at its end. Medians over
repetitions, one core.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from rich.console import Console
from rich.table import Table

from coop_envs.agents.catalog import load_team
from coop_envs.agents.command import Command
from coop_envs.agents.team import Team
from coop_envs.device import prepare
from coop_envs.estimation.settings import Estimation
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.geometry.arrays import allocate
from coop_envs.sensing.measurements import allocate_measurements

TICK_S = 1.0 / 30.0
CALIBRATED = {"focal_sigma": 0.005, "centre_sigma_px": 1.0, "hat_sigma_m": 0.001}


def team_of(robots: int, cameras: int = 1) -> Team:
    """Zumys, the first ones with cameras; pickets of small teams wear hats, whose calibration is then known."""
    picket = {"role": "picket", "robot": "zumy", **({"hat": "zumy"} if robots <= 8 else {})}
    observer = {"role": "observer", "robot": "zumy", "cameras": ["lifecam"]}
    return load_team({"members": [observer] * cameras + [picket] * (robots - cameras)})


class Bench:
    """B teams on a line; the first ``moving`` robots drive, their wheels are not listened to, the others rest."""

    def __init__(self, team: Team, teams: int, moving: int, seen: int, **settings: Any) -> None:
        n = len(team.members)
        self.measured = allocate_measurements(teams, n, 1, "cpu")
        command: Any = allocate(Command, (teams, n), "cpu", laser=(teams, n, 1), galvo=(teams, n, 1))
        self.filter = TeamFilter(team, Estimation(wheels=False, **settings), self.measured, command)
        start = np.zeros((teams, n, 3))
        start[:, :, 0] = np.arange(n) * 0.5
        self.filter.reset(start)
        told = np.zeros((teams, n, 2), dtype=np.float32)
        told[:, :moving] = 1.0
        command.wheels.assign(told)
        self.measured.heard.fill_(1)
        self.measured.accel.assign(np.broadcast_to(np.array([0.0, 0.0, 9.81], dtype=np.float32), (teams, n, 1, 3)))
        self._see(team, seen, start)
        for _ in range(80):
            self.filter.step(TICK_S)

    def _see(self, team: Team, seen: int, start: np.ndarray) -> None:
        """The first camera sees robots where they are."""
        level = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], dtype=np.float32)
        camera = team.members[0].camera
        assert camera is not None
        arrays = {
            name: getattr(self.measured, name).numpy()
            for name in ("seen", "R_camera_body", "p_camera_body", "covariance")
        }
        for j in range(1, 1 + seen):
            arrays["seen"][:, 0, j] = 1
            arrays["R_camera_body"][:, 0, j] = level
            arrays["p_camera_body"][:, 0, j] = level @ (start[0, j] * [1, 1, 0] - np.array(camera.position_m))
            arrays["covariance"][:, 0, j] = np.diag([2e-4] * 3 + [2e-5] * 3)

    def seconds(self, steps: int) -> float:
        """Seconds a step."""
        begin = time.perf_counter()
        for _ in range(steps):
            self.filter.step(TICK_S)
        return (time.perf_counter() - begin) / steps


CASES = {
    "one team of three: propagate three, two poses": (lambda: Bench(team_of(3), 1, 3, 2), 2000, 1),
    "1024 teams of three, each": (lambda: Bench(team_of(3), 1024, 3, 2), 4, 1024),
    "one team of three, calibrating": (lambda: Bench(team_of(3), 1, 3, 2, **CALIBRATED), 500, 1),
    "one inchworm team: one moves, two poses": (lambda: Bench(team_of(3), 1, 1, 2), 2000, 1),
    "100 robots: ten move, ten poses": (lambda: Bench(team_of(100), 1, 10, 10), 5, 1),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--quick", action="store_true", help="fewer repetitions")
    args = parser.parse_args()
    prepare("cpu")
    table = Table("case", "us a step", "steps/s")
    results: dict[str, float] = {}
    for name, (build, steps, share) in CASES.items():
        bench = build()
        bench.seconds(max(steps // 4, 1))
        results[name] = 1e6 * statistics.median(bench.seconds(steps) for _ in range(3 if args.quick else 9)) / share
        table.add_row(name, f"{results[name]:.1f}", f"{1e6 / results[name]:.0f}")
    Console().print(table)
    if args.out:
        document = {
            "machine": platform.processor() or platform.machine(),
            "warp": wp.config.version,
            "us_a_step": results,
        }
        args.out.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

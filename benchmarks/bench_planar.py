"""Speed of the planar team filter with 100 robots. Prints a table and writes JSON.

    python benchmarks/bench_planar.py [--out FILE.json]

A frame carries the robots that move over 1/30 s of odometry and fuses the ranges and bearings of that instant, gated
and stacked, in one joint covariance of 300 states. One thread: BLAS threads that wait for each other on a busy machine
cost more than they bring. Aim: 30 Hz.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.driving import driven
from coop_envs.localization.planar.filter import PlanarFilter
from coop_envs.localization.planar.settings import PlanarSettings
from coop_envs.localization.planar.sightings import sightings_now

ROBOTS, SPACING_M, AIM_MS = 100, 1.5, 1e3 / 30.0
SIGMA = np.array([0.03, 0.02])


def frames(moving: int, seen: int, count: int) -> dict[str, Any]:
    """Milliseconds a frame with so many robots moving and so many sightings of near ones."""
    rng = np.random.default_rng(0)
    team = PlanarFilter(PlanarSettings())
    for k in range(ROBOTS):
        place = [k % 10 * SPACING_M, k // 10 * SPACING_M]
        team.add(f"robot_{k}", np.array([*place, rng.uniform(-3, 3)]), np.diag([0.03, 0.05, 0.05]) ** 2)
    took_ms = []
    for _ in range(count):
        seer = rng.integers(0, ROBOTS, seen)
        subject = (seer + rng.choice([1, 9, 10, 11], seen)) % ROBOTS
        q = se2.seen_from(team.pose[seer], team.pose[subject, :2])
        exact = np.stack([np.hypot(q[:, 0], q[:, 1]), np.arctan2(q[:, 1], q[:, 0])], 1)
        measured = exact + rng.normal(size=(seen, 2)) * SIGMA
        told = sightings_now(seer, subject, np.zeros((seen, 2)), measured, np.tile(SIGMA, (seen, 1)))
        movers = np.sort(rng.choice(ROBOTS, moving, replace=False))
        forward, turn = np.full(moving, 0.2), rng.normal(0.0, 0.5, moving)
        began = time.perf_counter()
        team.move(movers, *driven(team.settings, forward, turn, 1.0 / 30.0))
        team.update(told)
        took_ms.append(1e3 * (time.perf_counter() - began))
    median, p99 = np.percentile(took_ms, [50, 99]).round(3).tolist()
    return {"moving": moving, "sightings": seen, "median_ms": median, "p99_ms": p99}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    options = parser.parse_args()
    rows = [frames(10, 10, 300), frames(100, 100, 200), frames(100, 400, 100)]
    machine = f"{platform.machine()}, one thread, Python {platform.python_version()}"
    print(f"{ROBOTS} robots, {machine}; aim {AIM_MS:.1f} ms")
    print(f"{'moving':>10}{'sightings':>12}{'median ms':>12}{'p99 ms':>12}")
    for row in rows:
        print(f"{row['moving']:>10}{row['sightings']:>12}{row['median_ms']:>12.2f}{row['p99_ms']:>12.2f}")
    if options.out:
        figures = {"machine": machine, "robots": ROBOTS, "rows": rows}
        options.out.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

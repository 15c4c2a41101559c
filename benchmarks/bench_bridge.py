"""From measurement to command on three emulated robots: latency, late ticks, processor time. Prints, writes JSON.

    python benchmarks/bench_bridge.py [--out FILE.json] [--seconds S] [--policy NAME]

Two Zumys over pseudo-terminals, one over UDP, as in `examples/emulated_team.yaml`, on the wall clock, with simulator
and firmware in processes of their own on the same machine. Latency runs from the arrival of the newest sample that a
tick takes in until the last robot has been sent its command; a tick is late by what it begins after it is due. Beside
ticks in which a decision is made stand those in which set-points are only renewed. Aim: 50 ms for 99 % of decisions.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import time
from pathlib import Path
from typing import Any

import numpy as np

from coop_envs.policy import load_policy
from hardware_bridge.mission import Mission
from hardware_bridge.runner import Tick
from hardware_bridge.session import Order, prepared

TEAM = Path(__file__).parents[1] / "examples" / "emulated_team.yaml"
AIM_MS = 50.0


def percentiles_ms(values_s: list[float]) -> dict[str, float]:
    marks = np.percentile(values_s, [50, 99, 100]) * 1e3
    return dict(zip(("median", "p99", "max"), marks.round(3).tolist(), strict=True))


def run(policy: str, seconds: float) -> dict[str, Any]:
    """One mission, tick by tick."""
    ticks: list[Tick] = []

    def watch(mission: Mission, tick: Tick) -> None:
        del mission
        ticks.append(tick)

    order = Order(TEAM, policy, load_policy(policy), 0, None, time_limit_s=seconds)
    with prepared(order, str, watch=watch) as session:
        before, began = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
        tally = session.run()
        after, took_s = resource.getrusage(resource.RUSAGE_SELF), time.monotonic() - began
    latency: dict[bool, list[float]] = {True: [], False: []}
    for tick in ticks:
        if tick.timing.measurement_to_command_s is not None:
            latency[tick.outcome.decided].append(tick.timing.measurement_to_command_s)
    decisions = [tick.timing for tick in ticks if tick.outcome.decided]
    return {
        "seconds": round(took_s, 2),
        "ticks": len(ticks),
        "decisions": tally.decisions,
        "first_decision_ms": round(decisions[0].busy_s * 1e3, 3),
        "decision_latency_ms": percentiles_ms(latency[True]),
        "renewal_latency_ms": percentiles_ms(latency[False]),
        "late_ms": percentiles_ms([tick.timing.late_s for tick in ticks]),
        "ticks_late_by_10_ms": sum(tick.timing.late_s > 0.01 for tick in ticks),
        "cpu_share": round((after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) / took_s, 3),
        "interventions": dict(tally.interventions),
        "events": tally.events,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--policy", default="inchworm_scan")
    options = parser.parse_args()
    row = run(options.policy, options.seconds)
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(f"{options.policy}, {row['decisions']} decisions in {row['seconds']} s, on {machine}")
    print(f"{'':24}{'median':>9}{'p99':>9}{'max':>9}")
    for name in ("decision_latency_ms", "renewal_latency_ms", "late_ms"):
        print(f"{name:24}" + "".join(f"{value:9.2f}" for value in row[name].values()))
    print(f"first decision {row['first_decision_ms']:.1f} ms; {row['ticks_late_by_10_ms']} ticks late by 10 ms or more")
    print(f"processor time of the bridge: {row['cpu_share']:.1%} of one core")
    print(f"stopped by the supervisor: {row['interventions'] or 'nobody'}; events: {row['events'] or 'none'}")
    met = row["decision_latency_ms"]["p99"] <= AIM_MS
    print(f"aim: 99 % of decisions within {AIM_MS:g} ms: {'met' if met else 'missed'}")
    if options.out:
        options.out.write_text(json.dumps({"machine": machine, "policy": options.policy, **row}, indent=2) + "\n")


if __name__ == "__main__":
    main()

"""Speed of the environment: import, first step, one team, many teams. Prints a table and writes JSON.

    python benchmarks/bench_environment.py [--out FILE.json] [--quick]

Figures are medians over repetitions. One team is measured next to its own floor, the kernels without PettingZoo's
dictionaries, in turn in the same run, and their ratio is reported.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from coop_envs import exploration_v0

DECISION_S = 0.2
COLD_START = """
import time
begin = time.perf_counter()
import coop_envs
imported = time.perf_counter()
from coop_envs import exploration_v0
env = exploration_v0.parallel_env("arena", team="inchworm", fidelity="poses")
observations, _ = env.reset(seed=0)
env.step({name: env.action_space(name).low for name in env.agents})
print(imported - begin, time.perf_counter() - begin)
"""


def start_seconds(cache: str | None) -> tuple[float, float]:
    """Seconds to import the package, and from there to the end of the first step, in a process of its own."""
    environment = dict(os.environ) | ({"WARP_CACHE_PATH": cache} if cache else {})
    run = subprocess.run(
        [sys.executable, "-c", COLD_START], env=environment, capture_output=True, text=True, check=True
    )
    imported, stepped = (float(word) for word in run.stdout.split())
    return imported, stepped


def wandering(agents: list[str], step: int) -> dict[str, Any]:
    """Actions that keep the pickets in motion and in sight."""
    sway = float(np.sin(0.5 * step))
    actions = {name: np.array([1, 0, 0, 0, 0, 0, 0, 0.5], dtype=np.float32) for name in agents}
    for k, name in enumerate(name for name in agents if name.startswith("picket")):
        actions[name][:3] = -1.0, 0.3 * sway, 0.2 * (-1) ** k
    return actions


def per_call_s(call: Callable[[int], object], calls: int) -> float:
    """Mean seconds a call."""
    begin = time.perf_counter()
    for k in range(calls):
        call(k)
    return (time.perf_counter() - begin) / calls


def seconds(call: Callable[[Any], object], argument: object) -> float:
    """Seconds of one call."""
    begin = time.perf_counter()
    call(argument)
    return time.perf_counter() - begin


def one_team(repetitions: int, decisions: int) -> dict[str, float]:
    """Team-decisions/s of a `parallel_env` of three robots at work, beside its kernels alone."""
    env = exploration_v0.parallel_env("arena", team="inchworm", fidelity="poses")
    rates, floors = [], []
    for repetition in range(repetitions):
        env.reset(seed=repetition)
        actions = [wandering(env.agents, k) for k in range(decisions)]
        rates.append(1.0 / per_call_s(lambda k, plan=actions: env.step(plan[k]), decisions))
        assert len(env.agents) == 3, "the benchmark's robots should all stay at work"
        floors.append(1.0 / per_call_s(lambda _: env.batch.step(), decisions))
    return {
        "decisions_per_s": statistics.median(rates),
        "kernels_per_s": statistics.median(floors),
        "share_of_kernels": statistics.median(rate / floor for rate, floor in zip(rates, floors, strict=True)),
        "times_real_time": statistics.median(rates) * DECISION_S,
    }


def surveying(repetitions: int, decisions: int) -> dict[str, float]:
    """Times real time of a `parallel_env` of three surveyors at `features`: scanning, and at rest with hats lit."""
    env = exploration_v0.parallel_env("rubble", team="surveyors", fidelity="features")
    scan, rest = (np.array([1, 0, 0, 0, ask, 0, -0.25, 1.0], dtype=np.float32) for ask in (1.0, 0.0))
    rates: dict[str, list[float]] = {"scanning": [], "lit": []}
    for repetition in range(repetitions):
        env.reset(seed=repetition)
        for name, action in (("lit", rest), ("scanning", scan)):
            actions = dict.fromkeys(env.agents, action)
            rates[name].append(DECISION_S / per_call_s(lambda _, plan=actions: env.step(plan), decisions))
    return {name: statistics.median(values) for name, values in rates.items()}


def many_teams(sizes: list[int], decisions: int) -> dict[str, float]:
    """Team-decisions/s of a `vector_env` by number of teams."""
    rates = {}
    for teams in sizes:
        env = exploration_v0.vector_env(teams, "arena", team="inchworm")
        env.reset(seed=0)
        names = [member.name for member in env.scenario.team.members]
        plan = [np.tile(np.stack(list(wandering(names, k).values())), (teams, 1, 1)) for k in range(decisions)]
        env.step(plan[0])
        rates[str(teams)] = teams / statistics.median(seconds(env.step, actions) for actions in plan)
    return rates


def measure(quick: bool) -> dict[str, Any]:
    """All figures."""
    warm = [start_seconds(None) for _ in range(2 if quick else 5)]
    with tempfile.TemporaryDirectory() as cache:
        _, cold = start_seconds(cache)
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "import_s": statistics.median(imported for imported, _ in warm),
        "first_step_warm_s": statistics.median(stepped for _, stepped in warm),
        "first_step_cold_s": cold,
        "one_team": one_team(3 if quick else 9, 300),
        "surveyors_times_real_time": surveying(3 if quick else 9, 300),
        "many_teams_per_s": many_teams([1, 32, 256] if quick else [1, 32, 1024], 10 if quick else 25),
    }


def show(figures: dict[str, Any]) -> None:
    """Print the figures beside their targets."""
    one = figures["one_team"]
    table = Table("figure", "measured", "target", title=f"arena, inchworm, poses ({figures['machine']})")
    table.add_row("import coop_envs", f"{figures['import_s']:.2f} s", "under 1 s")
    table.add_row("first step, kernels cached", f"{figures['first_step_warm_s']:.2f} s", "under 3 s")
    table.add_row("first step, kernels compiled", f"{figures['first_step_cold_s']:.1f} s", "under 60 s")
    rate = f"{one['decisions_per_s']:,.0f} team-decisions/s ({one['times_real_time']:,.0f} times real time)"
    table.add_row("one parallel_env", rate, "3,000 (600)")
    table.add_row("  of its kernels alone", f"{100 * one['share_of_kernels']:.0f} % of {one['kernels_per_s']:,.0f}", "")
    survey = figures["surveyors_times_real_time"]
    rate = f"{survey['scanning']:,.0f} times real time; hats lit {survey['lit']:,.0f}"
    table.add_row("three surveyors in rubble, features, scanning at 30 Hz", rate, "50")
    for teams, rate in figures["many_teams_per_s"].items():
        table.add_row(f"vector_env, {teams} teams", f"{rate:,.0f} team-decisions/s", "")
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions")
    options = parser.parse_args()
    figures = measure(options.quick)
    show(figures)
    if options.out:
        options.out.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()

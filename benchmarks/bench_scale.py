"""Speed and memory of many teams, beside VMAS: prints tables, writes JSON and draws the curves.

    python benchmarks/bench_scale.py [--out FILE.json] [--plot FILE.png] [--quick] [--vmas PYTHON]

Figures are medians. Pairs run in turn in the same minutes and are compared as ratios. ``--vmas`` names a Python that
has VMAS (by default this one, if it has it). What this machine has no device for is reported as not measured.
"""

from __future__ import annotations

import argparse
import importlib.util
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
import trimesh
import warp as wp
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from coop_envs import exploration_v0
from coop_envs.vector_env import ExplorationVectorEnv

VMAS_TARGETS = {1: 20.0, 32: 5.0, 1024: 2.0, 8192: 2.0}
FULL_TARGETS = {"building": 20_000.0, "rubble": 8_000.0}
SCAN = np.array([1, 0, 0, 0, 1.0, 0, -0.25, 1.0], dtype=np.float32)
FLAT = {"kind": "flat", "size_m": [8.0, 8.0], "start": [0.0, 0.0, 0.0], "goal": [3.0, 3.0, 0.2]}
MEMORY = """
import sys
from coop_envs import exploration_v0
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096
def env(teams, worlds):
    made = exploration_v0.vector_env(teams, sys.argv[1], num_worlds=worlds)
    made.reset(seed=0)
    return made
few = env(8, 2)
before = resident()
many = env(520, 2)
middle = resident()
wide = env(8, 34)
print((middle - before) / 520, (resident() - middle) / 34)
"""


def at_work(teams: int, robots: int, step: int) -> NDArray[np.float32]:
    """Observers hold, pickets drive about in sight."""
    sway = float(np.sin(0.5 * step))
    actions = np.zeros((teams, robots, 8), dtype=np.float32)
    actions[:, 0, 0], actions[:, :, 7] = 1.0, 0.5
    for k in range(1, robots):
        actions[:, k, :3] = -1.0, 0.3 * sway, 0.2 * (-1) ** k
    return actions


def median_s(call: Callable[[int], object], calls: int) -> float:
    """Median seconds of a call, after one to warm up."""
    spent = []
    for k in range(calls + 1):
        begin = time.perf_counter()
        call(k)
        spent.append(time.perf_counter() - begin)
    return statistics.median(spent[1:])


def light(teams: int, threads: int | None = None) -> ExplorationVectorEnv:
    """The light benchmark: dynamics, LED sight, filter and map of bodies, three robots."""
    env = exploration_v0.vector_env(teams, "arena", team="inchworm", threads=threads)
    env.reset(seed=0)
    return env


def rate_of(env: ExplorationVectorEnv, calls: int, actions: Callable[[int], NDArray[np.float32]]) -> float:
    """Team-decisions/s."""
    plan = [actions(k) for k in range(min(calls, 30) + 1)]
    return env.num_envs / median_s(lambda k: env.step(plan[k % len(plan)]), calls)


def light_rate(env: ExplorationVectorEnv, calls: int) -> float:
    return rate_of(env, calls, lambda k: at_work(env.num_envs, 3, k))


def vmas_rate(python: str, teams: int, steps: int) -> float:
    """Team-steps/s of VMAS `discovery` in a process of its own."""
    script = str(Path(__file__).with_name("vmas_discovery.py"))
    run = subprocess.run([python, script, str(teams), str(steps)], capture_output=True, text=True, check=True)
    return float(run.stdout.split()[-1])


def beside_vmas(python: str | None, sizes: list[int], pairs: int) -> dict[str, dict[str, float | None]]:
    """Our light benchmark and VMAS `discovery` in turn, by number of teams."""
    found: dict[str, dict[str, float | None]] = {}
    for teams in sizes:
        env, calls = light(teams), 200 if teams <= 32 else 8
        ours, theirs = [], []
        for _ in range(pairs):
            ours.append(light_rate(env, calls))
            theirs += [vmas_rate(python, teams, 40 if teams <= 32 else 8)] if python else []
        ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True)) if python else None
        vmas = statistics.median(theirs) if python else None
        found[str(teams)] = {"per_s": statistics.median(ours), "vmas_per_s": vmas, "ratio": ratio}
    return found


def floor(pairs: int, teams: int = 1024) -> dict[str, float]:
    """What a decision costs one thread, of it the kernels alone, and what a second thread gains."""
    one, two = light(teams, threads=1), light(teams, threads=2)
    plan = [at_work(teams, 3, k) for k in range(10)]
    step_s = [median_s(lambda k: one.step(plan[k]), 8) for _ in range(pairs)]

    def kernels(_: int) -> None:
        for lane in one.lanes:
            lane.batch.step()

    kernels_s = [median_s(kernels, 8) for _ in range(pairs)]
    gain = [light_rate(two, 8) / light_rate(one, 8) for _ in range(pairs)]
    return {
        "one_thread_us_a_team": 1e6 * statistics.median(step_s) / teams,
        "kernels_us_a_team": 1e6 * statistics.median(kernels_s) / teams,
        "two_threads_gain": statistics.median(gain),
    }


def full(pairs: int, teams: int = 1024) -> dict[str, float]:
    """Team-decisions/s of three surveyors that scan: over a height field (building) and a mesh (rubble)."""
    found = {}
    for scenario in FULL_TARGETS:
        env = exploration_v0.vector_env(teams, scenario, team="surveyors")
        env.reset(seed=0)
        scan = np.tile(SCAN, (teams, 3, 1))
        found[scenario] = statistics.median(rate_of(env, 6, lambda _, a=scan: a) for _ in range(pairs))
    return found


def by_robots(sizes: list[int], teams: int = 64) -> dict[str, float]:
    """Team-decisions/s by number of robots, all at work and in one filter."""
    found = {}
    for robots in sizes:
        picket = {"role": "picket", "robot": "zumy", "hat": "zumy", "count": robots - 1}
        members = [{"role": "observer", "robot": "zumy", "cameras": ["lifecam"]}, picket]
        overrides: dict[str, Any] = {"team": {"name": "many", "members": members}, "environment": {"geometry": FLAT}}
        env = exploration_v0.vector_env(teams, "u_turn", **overrides)
        env.reset(seed=0)
        found[str(robots)] = rate_of(env, 5, lambda k, n=robots: at_work(teams, n, k))
    return found


def by_triangles(sizes: list[int], teams: int = 256) -> dict[str, float]:
    """Team-decisions/s of surveyors that scan, by the number of triangles of their world's mesh."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for wanted in sizes:
            path = Path(folder) / f"{wanted}.ply"
            faces = rolling_hills(wanted, path)
            env = exploration_v0.vector_env(teams, "rubble", world=str(path), team="surveyors", num_worlds=1)
            env.reset(seed=0)
            scan = np.tile(SCAN, (teams, 3, 1))
            found[str(faces)] = rate_of(env, 5, lambda _, a=scan: a)
    return found


def rolling_hills(triangles: int, path: Path, side_m: float = 8.0) -> int:
    """Write a mesh of gentle hills with about this many triangles, and pillars that hang over nothing; its count."""
    nodes = max(int(np.sqrt(triangles / 2)) + 1, 4)
    axis = np.linspace(-0.5 * side_m, 0.5 * side_m, nodes)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = 0.1 * np.sin(1.1 * x) * np.cos(0.9 * y)
    index = np.arange(nodes * nodes).reshape(nodes, nodes)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    ground = trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), faces, process=False)
    boxes = []
    for k in range(12):
        box = trimesh.creation.box((0.3, 0.3, 1.0))
        box.apply_translation((2.5 * np.cos(k * np.pi / 6), 2.5 * np.sin(k * np.pi / 6), 0.5))
        boxes.append(box)
    trimesh.util.concatenate([ground, *boxes]).export(path)
    return len(ground.faces) + sum(len(box.faces) for box in boxes)


def memory(scenarios: list[str]) -> dict[str, dict[str, float]]:
    """Resident bytes that each further team, and each further world, costs a process."""
    found = {}
    for scenario in scenarios:
        run = subprocess.run([sys.executable, "-c", MEMORY, scenario], capture_output=True, text=True, check=True)
        team, world = (float(word) for word in run.stdout.split())
        found[scenario] = {"team_bytes": team, "world_bytes": world}
    return found


def training(steps: int) -> dict[str, dict[str, float]]:
    """Agent-steps/s of `coop train` by kind of network; three robots, none lost.

    ``per_s`` is of collecting and learning, the median over updates; ``whole_run_per_s`` also counts its start,
    checkpoints and the export at its end.
    """
    found = {}
    for kind in ("mlp", "attention"):
        with tempfile.TemporaryDirectory() as folder:
            command = ["coop", "train", "--scenario", "arena", "--team", "inchworm", "--repeat", "1", "--teams", "256"]
            command += ["--network.kind", kind, "--steps", str(steps), "--evaluate-episodes", "0"]
            command += ["--ppo.rollout-steps", "64", "--ppo.minibatch-rows", "4096", "--out", f"{folder}/run"]
            subprocess.run(command, capture_output=True, text=True, check=True)
            told = json.loads(Path(folder, "run", "progress.json").read_text())
        updates = statistics.median(row["steps_per_s"] for row in told["training"])
        found[kind] = {"per_s": 3.0 * updates, "whole_run_per_s": 3.0 * told["steps_per_s"]}
    return found


def on_cuda(pairs: int) -> dict[str, float] | str:
    """Team-decisions/s by the device arrays alone, or that there is no device."""
    if not wp.is_cuda_available():
        return "not measured: no CUDA device"
    found = {}
    for teams in (1024, 8192, 65536):
        env = exploration_v0.vector_env(teams, "arena", team="inchworm", device="cuda")
        env.reset(seed=0)

        def step(_: int, env: ExplorationVectorEnv = env) -> None:
            env.advance()
            wp.synchronize()

        found[str(teams)] = statistics.median(teams / median_s(step, 20) for _ in range(pairs))
    return found


def measure(quick: bool, python: str | None) -> dict[str, Any]:
    """All figures."""
    pairs = 2 if quick else 3
    console = Console(stderr=True)

    def say(what: str) -> None:
        console.print(f"measuring {what}")

    say("beside VMAS")
    figures: dict[str, Any] = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "light": beside_vmas(python, [1, 32, 1024] if quick else list(VMAS_TARGETS), pairs),
    }
    say("the floor")
    figures["floor"] = floor(pairs)
    say("teams that scan")
    figures["full_per_s"] = full(pairs)
    say("the cost of teams, robots and triangles")
    sizes = [1, 32, 1024] if quick else [1, 8, 32, 128, 512, 1024, 2048, 4096, 8192]
    figures["per_s_by_teams"] = {str(n): light_rate(light(n), 100 if n <= 32 else 5) for n in sizes}
    figures["per_s_by_robots"] = by_robots([2, 4, 8] if quick else [2, 3, 4, 6, 8, 12, 16, 22, 30])
    figures["per_s_by_triangles"] = by_triangles([1000, 20_000] if quick else [1000, 4000, 20_000, 100_000, 400_000])
    say("memory")
    figures["memory"] = memory(["arena", "random_arena", "rubble", "building"])
    say("training")
    figures["training_agent_steps_per_s"] = training(20_000 if quick else 200_000)
    return figures | {"cuda_per_s": on_cuda(pairs)}


def show(figures: dict[str, Any]) -> None:
    """Print the figures beside their targets."""
    table = Table("figure", "measured", "target", title=f"many teams ({figures['machine']})")
    for teams, row in figures["light"].items():
        name = f"arena, inchworm, {teams} teams"
        beside = "VMAS not at hand"
        if row["ratio"] is not None:
            beside = f"{row['ratio']:.1f} times VMAS discovery ({row['vmas_per_s']:,.0f})"
        table.add_row(name, f"{row['per_s']:,.0f} team-decisions/s; {beside}", f"{VMAS_TARGETS[int(teams)]:.0f} times")
    for scenario, rate in figures["full_per_s"].items():
        table.add_row(f"{scenario}, surveyors scanning, 1024 teams", f"{rate:,.0f}", f"{FULL_TARGETS[scenario]:,.0f}")
    base = figures["floor"]
    kernels = f"{base['kernels_us_a_team']:.1f} of {base['one_thread_us_a_team']:.1f} us"
    table.add_row("a light decision, one thread: kernels alone", kernels, "")
    table.add_row("two threads over one", f"{base['two_threads_gain']:.2f} times", "")
    for name, goal in (("mlp", 20_000), ("attention", 5_000)):
        row = figures["training_agent_steps_per_s"][name]
        rates = f"{row['per_s']:,.0f} agent-steps/s; {row['whole_run_per_s']:,.0f} with start and export"
        table.add_row(f"collecting and learning, {name}", rates, f"{goal:,}")
    for scenario, row in figures["memory"].items():
        sizes = f"{row['team_bytes'] / 1e6:.2f} MB a team, {row['world_bytes'] / 1e6:.2f} MB a world"
        table.add_row(f"memory, {scenario}", sizes, "under 1 MB a team of three" if scenario == "arena" else "")
    table.add_row("CUDA", str(figures["cuda_per_s"]), "1,000,000 at 65,536 teams")
    Console().print(table)


def draw(figures: dict[str, Any], path: Path) -> None:
    """The cost of teams, robots and triangles as three curves."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    curves = (
        ("per_s_by_teams", "teams (arena, inchworm)", [1, 32, 1024, 8192]),
        ("per_s_by_robots", "robots in a team (flat ground, 64 teams)", [2, 4, 8, 16, 30]),
        ("per_s_by_triangles", "triangles (surveyors scanning, 256 teams)", [1000, 10_000, 100_000, 400_000]),
    )
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
    for axis, (key, label, ticks) in zip(axes, curves, strict=True):
        points = sorted((int(size), rate) for size, rate in figures[key].items())
        axis.loglog(*zip(*points, strict=True), "o-", color="#1f6f8b")
        axis.set(xlabel=label, ylabel="team-decisions/s", ylim=(300, 200_000))
        axis.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
        axis.set_yticks([1000, 10_000, 100_000], ["1,000", "10,000", "100,000"])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    parser.add_argument("--plot", type=Path, help="also draw the curves as PNG")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions and sizes")
    parser.add_argument("--vmas", metavar="PYTHON", help="a Python that has VMAS")
    options = parser.parse_args()
    own = sys.executable if importlib.util.find_spec("vmas") else None
    figures = measure(options.quick, options.vmas or own)
    show(figures)
    if options.out:
        options.out.write_text(json.dumps(figures, indent=2) + "\n")
    if options.plot:
        draw(figures, options.plot)


if __name__ == "__main__":
    main()

"""Time of a pose from LEDs: P3P alone, the solver by hats in view, both rungs of fidelity. Prints a table, writes JSON.

    python benchmarks/bench_poses.py [--out FILE.json] [--quick]

Hats of six LEDs, pixel noise 0.5 px, random poses 0.4 to 2 m away; figures are medians over repetitions of a batch of
frames on one core. The last rows are one `parallel_env` of three surveyors, one LED frame a decision.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from rich.console import Console
from rich.table import Table

from coop_envs import exploration_v0
from coop_envs.agents.catalog import load_camera, load_team
from coop_envs.device import prepare
from coop_envs.sensing.camera import CameraModel, camera_model, project
from coop_envs.sensing.features import Features, allocate_features
from coop_envs.sensing.hats import Hats, pack_hats
from coop_envs.sensing.leds import LedModel
from coop_envs.sensing.measurements import allocate_measurements
from coop_envs.sensing.p3p import mat43d, p3p_depths
from coop_envs.sensing.solver import Answer, allocate_workspace, solve_poses, solver_model

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

NOISE_PX, DECISION_S, FRAMES = 0.5, 0.2, 512
TEAMS = 128  # one lane
AHEAD = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@wp.kernel
def solve_triples(square: wp.array[wp.vec3d], cosine: wp.array[wp.vec3d], depths: wp.array[mat43d]):
    k = wp.tid()
    depths[k] = p3p_depths(square[k], cosine[k])


@wp.kernel
def shine(
    camera: CameraModel, hats: Hats, rotation: wp.array2d[wp.mat33], position: wp.array2d[wp.vec3],
    noise: wp.array3d[wp.vec2], features: Features,
):  # fmt: skip
    """Blobs of all hats of a frame; one thread a frame."""
    b = wp.tid()
    for j in range(rotation.shape[1]):
        for k in range(hats.leds[j + 1]):
            n = features.count[b, 0]
            p = rotation[b, j] * hats.position[j + 1, k] + position[b, j]
            features.pixel[b, 0, n] = project(camera, p) + noise[b, j, k]
            features.hue[b, 0, n] = hats.hue[j + 1, k]
            features.signal[b, 0, n] = 1.0
            features.count[b, 0] = n + 1


def launch_us(repetitions: int, items: int, launch: Callable[[], None]) -> float:
    """Median microseconds an item."""
    launch()
    spent = []
    for _ in range(repetitions):
        begin = time.perf_counter()
        launch()
        spent.append(time.perf_counter() - begin)
    return statistics.median(spent) / items * 1e6


def triple_us(repetitions: int) -> float:
    """Microseconds for all solutions of a P3P problem."""
    rng, device, count = np.random.default_rng(0), prepare("cpu"), 20000
    points = rng.uniform(-0.12, 0.12, (count, 3, 3)) + [0.0, 0.0, 1.0]
    ray = points / np.linalg.norm(points, axis=-1, keepdims=True)
    pairs = ((0, 1), (0, 2), (1, 2))
    square = np.stack([np.sum((points[:, a] - points[:, b]) ** 2, axis=-1) for a, b in pairs], axis=-1)
    cosine = np.stack([np.sum(ray[:, a] * ray[:, b], axis=-1) for a, b in pairs], axis=-1)
    inputs = [wp.array(a, dtype=wp.vec3d, device=device) for a in (square, cosine)]
    inputs.append(wp.zeros(count, dtype=mat43d, device=device))
    return launch_us(repetitions, count, lambda: wp.launch(solve_triples, count, inputs=inputs, device=device))


def random_poses(frames: int, hats: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (frames, hats, 3, 3) and positions (frames, hats, 3) before a camera, upright."""
    rng = np.random.default_rng(1)
    yaw = rng.uniform(-np.pi, np.pi, (frames, hats))
    turn = np.zeros((frames, hats, 3, 3))
    turn[..., 0, 0] = turn[..., 1, 1] = np.cos(yaw)
    turn[..., 1, 0], turn[..., 0, 1], turn[..., 2, 2] = np.sin(yaw), -np.sin(yaw), 1.0
    depth = rng.uniform(0.4, 2.0, (frames, hats))
    off = rng.uniform([-0.4, -0.1], [0.4, 0.25], (frames, hats, 2))
    return AHEAD @ turn, np.concatenate([off * depth[..., None], depth[..., None]], axis=-1)


def solver_us(repetitions: int, hats: int) -> dict[str, float]:
    """Microseconds a hat with so many in view, and the share of them that get a pose."""
    device, robots = prepare("cpu"), hats + 1
    team = load_team("scouts").members[1 : 1 + hats]
    packed = pack_hats([(), *(member.hat.leds if member.hat else () for member in team)], device)
    camera = camera_model(load_camera("ch6"))
    features = allocate_features(FRAMES, robots, 6 * hats, device)
    rotation, position = random_poses(FRAMES, hats)
    noise = np.random.default_rng(2).normal(size=(FRAMES, hats, 8, 2)) * NOISE_PX
    poses: list[Any] = [wp.array(rotation, dtype=wp.mat33, device=device)]
    poses += [wp.array(position, dtype=wp.vec3, device=device), wp.array(noise, dtype=wp.vec2, device=device)]
    wp.launch(shine, FRAMES, inputs=[camera, packed, *poses, features], device=device)
    leds: Any = LedModel()
    leds.noise_px, leds.reference_range, leds.hue_tolerance, leds.min_leds = NOISE_PX, 1.0, 29.0, 4
    answer = wp.zeros((FRAMES, robots, robots), dtype=int, device=device)
    inputs = [
        features,
        wp.array([camera] + [camera_model(None)] * hats, dtype=CameraModel, device=device),
        packed,
        wp.ones((FRAMES, robots), dtype=float, device=device),
        wp.zeros((FRAMES, robots), dtype=int, device=device),
        leds,
        solver_model(leds),
        allocate_workspace(FRAMES, robots, 6 * hats, device),
        allocate_measurements(FRAMES, robots, 1, device),
        answer,
        wp.ones(FRAMES, dtype=int, device=device),
    ]
    spent = launch_us(
        repetitions, FRAMES * hats, lambda: wp.launch(solve_poses, (FRAMES, robots), inputs=inputs, device=device)
    )
    return {"us_per_hat": spent, "solved": float(np.mean(answer.numpy()[:, 0, 1:] == Answer.POSE))}


def rung_us(repetitions: int, fidelity: str) -> dict[str, float]:
    """Microseconds a team of three surveyors: the frames of blobs, and what the rung makes of them."""
    env = exploration_v0.vector_env(TEAMS, "u_turn", team="surveyors", fidelity=fidelity, num_worlds=1, threads=1)
    env.reset(seed=0)
    actions = np.zeros((TEAMS, 3, 8), dtype=np.float32)
    actions[..., 0] = actions[..., 7] = 1.0
    env.step(actions)
    frame, poses = env.batch.physics.sight
    seen = float(env.batch.measurements.seen.numpy().sum()) / TEAMS
    return {
        "blobs_us_per_team": launch_us(repetitions, TEAMS, frame.launch),
        "poses_us_per_team": launch_us(repetitions, TEAMS, poses.launch),
        "poses_per_team": seen,
    }


def environment_rate(decisions: int, fidelity: str) -> dict[str, float]:
    """Team-decisions/s of one `parallel_env` of three surveyors that scan."""
    env = exploration_v0.parallel_env("u_turn", team="surveyors", fidelity=fidelity)
    env.reset(seed=0)
    action = np.array([1, 0, 0, 0, 1, 0, 0, 1], dtype=np.float32)
    actions = dict.fromkeys(env.agents, action)
    env.step(actions)
    begin = time.perf_counter()
    for _ in range(decisions):
        env.step(actions)
    rate = decisions / (time.perf_counter() - begin)
    return {"decisions_per_s": rate, "times_real_time": rate * DECISION_S}


def measure(quick: bool) -> dict[str, Any]:
    """All figures."""
    repetitions = 5 if quick else 15
    rungs = ("poses", "features")
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "p3p_us": triple_us(repetitions),
        "solver": {str(hats): solver_us(repetitions, hats) for hats in (1, 2, 3, 4)},
        "rungs": {fidelity: rung_us(repetitions, fidelity) for fidelity in rungs},
        "one_env": {fidelity: environment_rate(200 if quick else 1000, fidelity) for fidelity in rungs},
    }


def show(figures: dict[str, Any]) -> None:
    """Print the figures beside their targets."""
    table = Table("figure", "measured", "target", title=f"poses from LEDs ({figures['machine']})")
    table.add_row("P3P, all solutions", f"{figures['p3p_us']:.2f} us", "")
    for hats, row in figures["solver"].items():
        text = f"{row['us_per_hat']:.0f} us a hat, {100 * row['solved']:.1f} % solved"
        table.add_row(f"solver, {hats} hats in view", text, "50 us" if hats == "2" else "")
    for fidelity, row in figures["rungs"].items():
        text = f"{row['blobs_us_per_team']:.1f} + {row['poses_us_per_team']:.1f} us a team"
        table.add_row(f"{fidelity}: blobs + poses ({row['poses_per_team']:.1f} poses)", text, "")
    for fidelity, row in figures["one_env"].items():
        text = f"{row['decisions_per_s']:,.0f} team-decisions/s ({row['times_real_time']:,.0f} times real time)"
        table.add_row(f"one parallel_env, {fidelity}", text, "250 (50)" if fidelity == "features" else "")
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

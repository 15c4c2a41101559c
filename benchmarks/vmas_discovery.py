"""Team-steps/s of VMAS's `discovery` with three agents on the CPU: what `bench_scale.py` compares with.

    python benchmarks/vmas_discovery.py TEAMS STEPS

Prints one number. VMAS is GPL-3.0 and no dependency of this project: `pip install vmas==1.5.2` where it is to run.
"""

from __future__ import annotations

import statistics
import sys
import time

import torch
import vmas  # pyright: ignore[reportMissingImports]


def main() -> None:
    teams, steps = int(sys.argv[1]), int(sys.argv[2])
    env = vmas.make_env("discovery", num_envs=teams, device="cpu", continuous_actions=True, n_agents=3, seed=0)
    env.reset()
    actions = [torch.rand((teams, 2)) * 2.0 - 1.0 for _ in env.agents]
    spent = []
    for _ in range(steps + 2):
        begin = time.perf_counter()
        env.step(actions)
        spent.append(time.perf_counter() - begin)
    print(teams / statistics.median(spent[2:]))


if __name__ == "__main__":
    main()

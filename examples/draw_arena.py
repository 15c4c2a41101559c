"""Explore the arena with goal_grid and draw what the team knows halfway: the picture of the README."""

from __future__ import annotations

import argparse
from pathlib import Path

from coop_envs import exploration_v0
from coop_envs.policy import load_policy
from coop_envs.viewer.report import encode_png
from coop_envs.viewer.robots import Trail
from coop_envs.viewer.topview import draw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images/arena.png"), help="the picture (.png)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the episode")
    parser.add_argument("--time_s", type=float, default=120.0, help="simulated time at which to draw (s)")
    options = parser.parse_args()

    env = exploration_v0.parallel_env(scenario="arena")
    policy = load_policy("goal_grid")
    observations, _ = env.reset(seed=options.seed)
    policy.reset(env.team_description, options.seed)
    frames = [env.frame()]
    while env.agents and frames[-1].time_s < options.time_s:
        observations, *_ = env.step(policy.act({agent: observations[agent] for agent in env.agents}))
        frames.append(env.frame())
    picture = draw(env.world_picture(), frames[-1], Trail.from_frames(frames), size_px=900)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_bytes(encode_png(picture))
    print(options.out)


if __name__ == "__main__":
    main()

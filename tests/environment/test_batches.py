"""One seed, one result: at any batch size, in any process, after any pause."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from coop_envs import exploration_v0
from tests.environment.policies import hold_all, random_actions

KEYS = ("self", "mates", "mask", "map")
DIGEST = """
import hashlib, numpy as np
from coop_envs import exploration_v0
from tests.environment.policies import random_actions
env = exploration_v0.parallel_env("random_arena", team="inchworm")
observations, _ = env.reset(seed=5)
rng, digest = np.random.default_rng(5), hashlib.sha256()
for _ in range(60):
    if not env.agents:
        break
    actions = random_actions(rng, len(env.agents))
    observations, rewards, *_ = env.step(dict(zip(env.agents, actions)))
    for name in observations:
        digest.update(b"".join(part.tobytes() for part in observations[name].values()))
        digest.update(np.float64(rewards[name]).tobytes())
print(digest.hexdigest())
"""


@pytest.mark.parametrize(
    ("scenario", "team", "fidelity"), [("random_arena", "inchworm", "poses"), ("arena", "scouts", "features")]
)
def test_a_team_in_a_batch_does_what_it_does_alone(scenario: str, team: str, fidelity: str) -> None:
    """Bit for bit, through ends and restarts."""
    teams, limit = 4, {"task.time_limit_s": 8.0, "num_worlds": 3, "fidelity": fidelity}
    batch = exploration_v0.vector_env(teams, scenario, team=team, **limit)
    alone = [exploration_v0.parallel_env(scenario, team=team, **limit) for _ in range(teams)]
    together, _ = batch.reset(seed=30)
    for b, env in enumerate(alone):
        env.reset(seed=30 + b)
    robots, rng, restarts = len(alone[0].possible_agents), np.random.default_rng(2), 0
    for _ in range(70):
        actions = np.stack([random_actions(rng, robots) for _ in range(teams)])
        together, reward, terminated, truncated, info = batch.step(actions)
        for b, env in enumerate(alone):
            assert bool(info["started"][b]) == (not env.agents)
            if not env.agents:
                observations, _ = env.reset()
                restarts += 1
                assert reward[b] == 0.0
            else:
                acts = {name: actions[b, env.possible_agents.index(name)] for name in env.agents}
                observations, rewards, terminations, truncations, infos = env.step(acts)
                for name, value in rewards.items():
                    i = env.possible_agents.index(name)
                    assert value == reward[b]
                    assert terminations[name] == terminated[b, i]
                    assert truncations[name] == truncated[b, i]
                    assert list(infos[name]["reward_terms"].values()) == info["reward_terms"][b].tolist()
            for name, observation in observations.items():
                i = env.possible_agents.index(name)
                for key in KEYS:
                    np.testing.assert_array_equal(observation[key], together[key][b, i])
    assert restarts >= teams


def test_another_process_gets_the_same_bits() -> None:
    digests = {
        subprocess.run([sys.executable, "-c", DIGEST], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    }
    assert len(digests) == 1


def test_a_saved_state_goes_on_as_if_nothing_had_happened() -> None:
    env = exploration_v0.parallel_env("arena", team="inchworm")
    rng = np.random.default_rng(0)
    plan = [random_actions(rng, 3) for _ in range(40)]

    def run(steps: slice) -> list[dict[str, np.ndarray]]:
        seen = []
        for actions in plan[steps]:
            if not env.agents:
                break
            rows = {name: actions[env.possible_agents.index(name)] for name in env.agents}
            seen.append(env.step(rows)[0]["observer_0"])
        return seen

    env.reset(seed=3)
    run(slice(0, 15))
    state = env.get_state()
    first = run(slice(15, 40))
    env.set_state(state)
    second = run(slice(15, 40))
    assert len(first) == len(second) > 0
    for a, b in zip(first, second, strict=True):
        for key in KEYS:
            np.testing.assert_array_equal(a[key], b[key])


def test_a_masked_reset_leaves_the_others_alone() -> None:
    env = exploration_v0.vector_env(3, "arena", team="inchworm")
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(5):
        before, *_ = env.step(np.stack([random_actions(rng, 3) for _ in range(3)]))
    ticks = env.batch.state.tick.numpy().copy()
    after, _ = env.reset(mask=[False, True, False])
    assert env.batch.state.tick.numpy().tolist() == [ticks[0], 6, ticks[2]]
    for key in KEYS:
        np.testing.assert_array_equal(after[key][[0, 2]], before[key][[0, 2]])


def test_teams_filled_up_to_a_size_play_the_same_game() -> None:
    plain = exploration_v0.vector_env(2, "arena", team="inchworm")
    filled = exploration_v0.vector_env(2, "arena", team="inchworm", max_robots=5)
    a, _ = plain.reset(seed=1)
    b, _ = filled.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(5):
        actions = np.stack([random_actions(rng, 5) for _ in range(2)])
        a, reward_a, *_ = plain.step(actions[:, :3])
        b, reward_b, terminated, _, _ = filled.step(actions)
        np.testing.assert_array_equal(reward_a, reward_b)
    assert filled.observation_space.contains(b)
    assert terminated.shape == (2, 5)
    for key in (*KEYS, "alive"):
        np.testing.assert_array_equal(a[key], b[key][:, :3])
        assert not b[key][:, 3:].any()


def test_tensors_share_the_memory_of_the_batch() -> None:
    env = exploration_v0.vector_env(2, "arena", team="inchworm")
    env.reset(seed=0)
    tensors = env.torch()
    observations, reward, *_ = env.step(np.stack([hold_all(3)] * 2))
    np.testing.assert_array_equal(tensors["self"].numpy(), observations["self"])
    np.testing.assert_array_equal(tensors["map"].numpy(), observations["map"])
    np.testing.assert_array_equal(tensors["reward"].numpy(), reward)

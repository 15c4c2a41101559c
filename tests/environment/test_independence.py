"""A team's episodes depend on its seed and actions alone, through losses, reserves and changes of world."""

from __future__ import annotations

import multiprocessing
from typing import Any

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.errors import ConfigError
from coop_envs.observations import self_field
from tests.environment.policies import hold_all

KEYS = ("self", "mates", "mask", "map")
RISKY: dict[str, Any] = {"environment.geometry.trap_size_m": (0.3, 0.3), "task.time_limit_s": 60.0}


def scouting(rng: np.random.Generator, robots: int) -> np.ndarray:
    """Pickets go ahead and weave, so that many are lost; the observer looks about."""
    actions = hold_all(robots)
    actions[:, 7] = 1.0
    actions[0, :3] = -1.0, 0.0, rng.uniform(-0.5, 0.5)
    actions[1:, 0], actions[1:, 1] = -1.0, rng.uniform(0.3, 1.0, robots - 1)
    actions[1:, 2] = rng.uniform(-0.6, 0.6, robots - 1)
    return actions


def plans(seed: int, teams: int, robots: int, decisions: int) -> np.ndarray:
    """Actions (decisions, teams, robots, 8), held for one second each."""
    rng = np.random.default_rng(seed)
    seconds = [np.stack([scouting(rng, robots) for _ in range(teams)]) for _ in range(decisions // 5 + 1)]
    return np.repeat(np.stack(seconds), 5, axis=0)[:decisions]


@pytest.mark.slow
@pytest.mark.parametrize(("scenario", "decisions"), [("arena", 700), ("random_arena", 500)])
def test_a_batch_equals_its_teams_alone_over_long_and_lossy_episodes(scenario, decisions):
    teams = 8
    settings: dict[str, Any] = {"num_worlds": 5, "task": {"time_limit_s": 60.0}, "fidelity": "features"}
    batch = exploration_v0.vector_env(teams, scenario, **settings)
    alone = [exploration_v0.parallel_env(scenario, **settings) for _ in range(teams)]
    robots = len(alone[0].possible_agents)
    batch.reset(seed=11)
    for b, env in enumerate(alone):
        env.reset(seed=11 + b)
    lost = joined = 0
    for actions in plans(3, teams, robots, decisions):
        together, reward, *_ = batch.step(actions)
        for b, env in enumerate(alone):
            if env.agents:
                rows = {name: actions[b, env.possible_agents.index(name)] for name in env.agents}
                observations, rewards, *_ = env.step(rows)
                assert set(rewards.values()) == {reward[b]}
            else:
                observations, _ = env.reset()
            for name, observation in observations.items():
                i = env.possible_agents.index(name)
                for key in KEYS:
                    np.testing.assert_array_equal(observation[key], together[key][b, i], err_msg=f"{name} {key}")
        declared = batch.batch.belief.declared.numpy()
        lost, joined = max(lost, int((declared == 2).sum())), max(joined, int((declared[:, 2:] == 1).sum()))
    assert lost >= 5 and joined >= 3


def test_a_state_goes_on_after_other_episodes_in_other_worlds():
    """Reserves join where the restored world has its dock, not where the last one had it."""
    env = exploration_v0.vector_env(4, "random_arena", num_worlds=6, task={"time_limit_s": 60.0})
    robots = len(env.scenario.team.members)
    actions = plans(5, 4, robots, 260)
    env.reset(seed=3)
    for a in actions[:40]:
        env.step(a)
    state = env.get_state()
    first = [env.step(a) for a in actions[40:]]
    env.reset(seed=1000)
    for a in actions[:20]:
        env.step(a)
    env.set_state(state)
    second, joined = [], False
    for a in actions[40:]:
        second.append(env.step(a))
        joined |= bool((env.batch.belief.declared.numpy()[:, 2:] == 1).any())
    for (a, reward_a, *_), (b, reward_b, *_) in zip(first, second, strict=True):
        np.testing.assert_array_equal(reward_a, reward_b)
        for key in KEYS:
            np.testing.assert_array_equal(a[key], b[key])
    assert joined


def test_a_state_of_another_batch_is_refused():
    small, large = exploration_v0.vector_env(1, "u_turn"), exploration_v0.vector_env(2, "u_turn")
    small.reset(seed=0)
    large.reset(seed=0)
    with pytest.raises(ConfigError, match="state: got"):
        large.set_state(small.get_state())


def rewards_of(seed: int) -> bytes:
    """Rewards and observations of a short batch, as bytes."""
    env = exploration_v0.vector_env(3, "arena", **RISKY)
    env.reset(seed=seed)
    out = [env.step(actions) for actions in plans(1, 3, len(env.scenario.team.members), 60)]
    return b"".join(reward.tobytes() + observation["self"].tobytes() for observation, reward, *_ in out)


def test_spawned_processes_compute_the_same_bits():
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert pool.map(rewards_of, [6, 6]) == [rewards_of(6)] * 2


def test_docked_robots_are_observed_alike_in_a_first_and_in_a_later_episode():
    env = exploration_v0.parallel_env("arena", **RISKY)
    fresh, _ = exploration_v0.parallel_env("arena", **RISKY).reset(seed=9)
    env.reset(seed=8)
    for actions in plans(2, 1, len(env.possible_agents), 150):
        if env.agents:
            env.step({name: actions[0, env.possible_agents.index(name)] for name in env.agents})
    again, _ = env.reset(seed=9)
    for name in fresh:
        for key in KEYS:
            np.testing.assert_array_equal(again[name][key], fresh[name][key], err_msg=f"{name} {key}")


def test_the_team_under_one_controller_plays_the_same_game():
    settings: dict[str, Any] = {**RISKY, "fidelity": "poses"}
    team, parallel = exploration_v0.team_env("arena", **settings), exploration_v0.parallel_env("arena", **settings)
    one, _ = team.reset(seed=3)
    many, _ = parallel.reset(seed=3)
    for actions in plans(4, 1, len(parallel.possible_agents), 100):
        for i, name in enumerate(parallel.possible_agents):
            for key in KEYS if name in many else ():
                np.testing.assert_array_equal(one[key][i], many[name][key])
        if not parallel.agents:
            break
        one, reward, *_, info = team.step(actions[0])
        rows = {name: actions[0, parallel.possible_agents.index(name)] for name in parallel.agents}
        many, rewards, _, _, infos = parallel.step(rows)
        assert set(rewards.values()) == {reward}
        assert info["reward_terms"] == next(iter(infos.values()))["reward_terms"]


def test_time_left_falls_from_one_to_nothing():
    env = exploration_v0.parallel_env("u_turn", task={"time_limit_s": 4.0})
    observations, _ = env.reset(seed=0)
    left = [self_field(observations["observer_0"], "time_left")]
    while env.agents:
        observations, *_ = env.step(dict(zip(env.agents, hold_all(len(env.agents)), strict=True)))
        left.append(self_field(observations["observer_0"], "time_left"))
    np.testing.assert_allclose(left, np.linspace(1.0, 0.0, 21), atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"split": "test"}, "split: got 'test', expected train or heldout"),
        ({"world_index": -1}, "index: got -1, expected 0 or more"),
    ],
)
def test_bad_reset_options_get_one_line(options, message):
    env = exploration_v0.parallel_env("u_turn")
    with pytest.raises(ConfigError, match=message):
        env.reset(seed=0, options=options)

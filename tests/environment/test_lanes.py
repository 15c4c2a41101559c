"""Teams shared out among threads: the same bits as in one, in whichever number of lanes."""

from __future__ import annotations

import numpy as np
import pytest

from coop_envs import exploration_v0, vector_env
from coop_envs.errors import ConfigError
from coop_envs.geometry.keyed_random import mix, team_key
from coop_envs.vector_env import ExplorationVectorEnv
from coop_envs.world_pool import world_index
from tests.environment.policies import random_actions

TEAMS = 24


def teams_of(threads: int, scenario: str = "random_arena", team: str = "inchworm") -> ExplorationVectorEnv:
    limit = {"task.time_limit_s": 4.0, "num_worlds": 3}
    return exploration_v0.vector_env(TEAMS, scenario, team=team, threads=threads, **limit)


def play(env: ExplorationVectorEnv, decisions: int, seed: int = 1) -> list[np.ndarray]:
    rng, seen = np.random.default_rng(seed), []
    for _ in range(decisions):
        actions = np.stack([random_actions(rng, 3) for _ in range(TEAMS)])
        observations, reward, terminated, truncated, info = env.step(actions)
        seen += [*observations.values(), reward, terminated, truncated, info["reward_terms"], info["started"]]
    return seen


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_and_lanes_do_not_matter(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    one, many = teams_of(1), teams_of(threads)
    assert (len(one.lanes), len(many.lanes)) == (1, threads)
    monkeypatch.setattr(vector_env, "LANE", 4)
    short = teams_of(2)
    assert len(short.lanes) == 6
    short.reset(seed=7)
    one.reset(seed=7)
    many.reset(seed=7)
    for a, b, c in zip(play(one, 45), play(many, 45), play(short, 45), strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, c)


def test_a_state_moves_between_numbers_of_threads() -> None:
    one, many = teams_of(1), teams_of(3)
    one.reset(seed=7)
    play(one, 18)
    many.set_state(one.get_state())
    for a, b in zip(play(one, 30, seed=2), play(many, 30, seed=2), strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(ConfigError, match="state"):
        exploration_v0.vector_env(8, "arena", team="inchworm").set_state(one.get_state())


def test_series_on_the_device_are_those_of_the_host() -> None:
    env = teams_of(2)
    env.reset(seed=40)
    play(env, 50)
    for team in range(TEAMS):
        batch, b = env.locate(team)
        episode = int(np.concatenate([lane.series.episode.numpy() for lane in env.lanes])[team])
        assert episode >= 2
        assert int(batch.state.key.numpy()[b]) == team_key(40 + team, episode)
        assert (
            int(batch.state.world.numpy()[b])
            == world_index(40 + team, episode, 3)
            == mix(team_key(40 + team, episode)) % 3
        )


def test_steps_by_the_device_arrays_alone_do_the_same() -> None:
    plain, bare = teams_of(2), teams_of(2)
    plain.reset(seed=3)
    bare.reset(seed=3)
    tensors, rng = bare.torch(), np.random.default_rng(0)
    for _ in range(30):
        actions = np.stack([random_actions(rng, 3) for _ in range(TEAMS)])
        observations, reward, terminated, truncated, _ = plain.step(actions)
        tensors["actions"].numpy()[:] = actions
        bare.advance()
        for name in observations:
            np.testing.assert_array_equal(tensors[name].numpy(), observations[name], err_msg=name)
        np.testing.assert_array_equal(tensors["reward"].numpy(), reward)
        np.testing.assert_array_equal(tensors["terminated"].numpy() == 1, terminated)
        np.testing.assert_array_equal(tensors["truncated"].numpy() == 1, truncated)


def test_few_teams_get_one_thread() -> None:
    assert len(exploration_v0.vector_env(8, "arena", team="inchworm", threads=4).lanes) == 1
    with pytest.raises(ConfigError, match="threads: got 0"):
        exploration_v0.vector_env(8, "arena", threads=0)


def test_states_of_others_are_refused() -> None:
    env = teams_of(2)
    env.reset(seed=0)
    state = env.get_state()
    others = [
        exploration_v0.vector_env(
            TEAMS, "random_arena", team="inchworm", **{"task.time_limit_s": 4.0, "num_worlds": 1}
        ),
        exploration_v0.vector_env(8, "random_arena", team="inchworm", **{"task.time_limit_s": 4.0, "num_worlds": 3}),
        exploration_v0.vector_env(TEAMS, "random_arena", team="inchworm", num_worlds=3),
    ]
    for other in others:
        with pytest.raises(ConfigError, match="state: got"):
            other.set_state(state)
    with pytest.raises(ConfigError, match="state: got"):
        env.set_state({name: part for name, part in state.items() if name != "origin"})
    with pytest.raises(ConfigError, match="seed: got"):
        env.reset(seed=2**64)

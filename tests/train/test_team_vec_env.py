"""Endings as training must see them: who is bootstrapped from what, and who idles until when."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

from coop_envs.agents.control import action_mask
from coop_envs.errors import ConfigError
from coop_envs.exploration_v0 import vector_env
from tests.train.scripted_teams import ScriptedTeams
from train.team_vec_env import TeamVecEnv
from train.training_error import TrainingError

GO = {"reward": 1.0}


def rows(env: TeamVecEnv) -> TeamVecEnv:
    env.reset()
    return env


def scripted(*scripts: Any, robots: int = 3, docked: Any = (), **settings: Any) -> TeamVecEnv:
    return rows(TeamVecEnv(ScriptedTeams(scripts, robots, docked), np.ones((robots, 8)), **settings))


def step(env: TeamVecEnv) -> tuple[Any, Any, Any, Any]:
    observations, rewards, dones, infos = env.step(np.zeros((env.num_envs, 8), dtype=np.float32))
    return observations, rewards.tolist(), dones.tolist(), infos


def seen(info: dict[str, Any]) -> float:
    return float(info["terminal_observation"]["self"][2])


def test_staggered_losses_go_on_with_the_team_and_then_idle():
    script = [GO, {"reward": -4.0, "lost": [2]}, GO, {"reward": 2.0, "lost": [0]}, {"reward": 9.0, "lost": [1]}]
    env = scripted(script)
    _, rewards, dones, _ = step(env)
    assert (rewards, dones) == ([1, 1, 1], [False] * 3)
    observations, rewards, dones, infos = step(env)
    assert (rewards, dones) == ([-4, -4, -4], [False, False, True])
    assert infos[2]["TimeLimit.truncated"]
    assert seen(infos[2]) == 20  # what robot 0 sees after two decisions
    assert observations["alive"].ravel().tolist() == [1, 1, 0]
    _, rewards, dones, infos = step(env)
    assert (rewards, dones) == ([1, 1, 0], [False] * 3)
    assert infos[2] == {}
    _, rewards, dones, infos = step(env)
    assert (rewards, dones) == ([2, 2, 0], [True, False, False])
    assert seen(infos[0]) == 41  # robot 1: the only one left
    observations, rewards, dones, infos = step(env)
    assert (rewards, dones) == ([0, 9, 0], [False, True, False])
    assert not infos[1]["TimeLimit.truncated"]
    assert infos[0]["episode"]["r"] == 9.0
    assert infos[0]["episode"]["l"] == 5
    assert infos[0]["episode"]["robots_lost"] == 2
    assert infos[0]["episode"]["terms"] == {"information": 9.0, "picket_lost": 0.0}
    assert observations["alive"].ravel().tolist() == [1, 1, 1]  # the next episode's first observation
    assert observations["self"][:, 2].tolist() == [0, 1, 2]


def test_success_is_not_bootstrapped_and_a_timeout_is_by_what_each_saw_last():
    env = scripted([{"reward": 50.0, "lost": [0, 1, 2]}], [{"reward": 1.0, "late": [0, 1, 2]}])
    _, rewards, dones, infos = step(env)
    assert (rewards, dones) == ([50] * 3 + [1] * 3, [True] * 6)
    assert [info["TimeLimit.truncated"] for info in infos] == [False] * 3 + [True] * 3
    assert [seen(info) for info in infos[3:]] == [110, 111, 112]
    assert ["episode" in info for info in infos] == [True, False, False, True, False, False]


def test_a_robot_lost_as_the_time_is_over_has_the_future_of_its_team():
    env = scripted([{"lost": [0], "late": [1, 2]}])
    _, _, dones, infos = step(env)
    assert dones == [True] * 3
    assert [info["TimeLimit.truncated"] for info in infos] == [True] * 3
    assert [seen(info) for info in infos] == [11, 11, 12]


def test_a_lost_robots_heir_is_at_work_not_in_the_dock():
    env = scripted([{"lost": [1]}, GO], docked=[0])
    _, _, _, infos = step(env)
    assert seen(infos[1]) == 12


def test_teams_do_not_touch_each_other():
    env = scripted([{"lost": [0, 1, 2]}], [GO, GO, GO])
    for decision in range(3):
        observations, rewards, dones, _ = step(env)
        assert rewards[3:] == [1, 1, 1]
        assert dones == [True] * 3 + [False] * 3
        assert observations["self"][3:, 2].tolist() == [100 + 10 * (decision + 1) + r for r in range(3)]


def test_held_actions_add_up_rewards_to_the_end_and_no_further():
    env = scripted([GO, {"reward": 5.0, "late": [0, 1, 2]}, GO], [GO, {"lost": [1]}, GO, GO], repeat=3)
    observations, rewards, dones, infos = step(env)
    assert rewards == [6] * 3 + [2] * 3
    assert dones == [True] * 3 + [False, True, False]
    assert seen(infos[0]) == 20
    assert seen(infos[4]) == 130  # what the team goes on from, at the end of the step
    assert infos[0]["episode"]["r"] == 6.0
    assert infos[0]["episode"]["l"] == 1
    assert observations["self"][:3, 2].tolist() == [0, 1, 2]  # a new episode that no held action has reached
    teams = env.teams
    assert isinstance(teams, ScriptedTeams)
    assert len(teams.actions) == 3


LAST, SUCCESS, LATE = {"lost": [2]}, {"lost": [0, 1]}, {"late": [0, 1]}


@pytest.mark.parametrize(
    ("script", "lost"),
    [
        ([LAST, SUCCESS], 1),
        ([LAST, LATE], 1),
        ([GO, {"lost": [2], "late": [0, 1]}], 1),
        ([GO, {"lost": [0, 1, 2]}], 0),  # cannot be told from success
    ],
)
def test_robots_lost_within_the_last_held_action_are_counted_and_success_is_no_loss(script, lost):
    _, _, dones, infos = step(scripted(script, repeat=2))
    assert dones == [True] * 3
    assert infos[0]["episode"]["robots_lost"] == lost


def test_rewards_are_scaled_and_figures_are_not():
    env = scripted([{"reward": 3.0, "late": [0, 1, 2]}], reward_scale=0.5)
    _, rewards, _, infos = step(env)
    assert rewards == [1.5] * 3
    assert infos[0]["episode"]["r"] == 3.0


def test_first_episodes_are_cut_off_evenly_and_bootstrapped():
    env = scripted(*[[GO] * 8 for _ in range(4)], robots=1, spread=4)
    ends = []
    for _ in range(6):
        _, _, dones, infos = step(env)
        ends.append(dones)
        assert all(info["TimeLimit.truncated"] and "episode" not in info for info in infos if info)
    assert np.argwhere(ends).tolist() == [[0, 0], [1, 1], [2, 2], [3, 3]]  # and none a second time


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_reward_that_is_not_finite_is_one_clear_error(bad):
    env = scripted([GO], [{"reward": bad}])
    with pytest.raises(TrainingError, match=r"reward of team 1: got (nan|inf) in step 0"):
        step(env)


def test_a_repeat_of_none_is_refused():
    with pytest.raises(ConfigError, match="repeat"):
        scripted([GO], repeat=0)


def test_a_restored_state_has_the_same_future():
    script = [GO, {"lost": [2]}, GO, {"late": [0, 1]}]
    one, other = scripted(script, script), scripted(script, script)
    for _ in range(2):
        step(one)
    state = copy.deepcopy(one.get_state())
    other.set_state(state)
    for _ in range(6):
        (seen_a, *a, infos_a), (seen_b, *b, infos_b) = step(one), step(other)
        assert a == b
        assert [sorted(info) for info in infos_a] == [sorted(info) for info in infos_b]
        assert all(np.array_equal(seen_a[name], seen_b[name]) for name in seen_a)


def test_the_real_teams_fit_their_space():
    teams = vector_env(2, "arena", team="scouts", task={"time_limit_s": 2.0})
    masks = np.stack([action_mask(member) for member in teams.scenario.team.members])
    env = TeamVecEnv(teams, masks)
    observations: Any = env.reset()
    rng = np.random.default_rng(0)
    for _ in range(30):
        one = {name: array[0] for name, array in observations.items()}
        assert env.observation_space.contains(one)
        observations, rewards, dones, infos = env.step(rng.uniform(-1, 1, (env.num_envs, 8)).astype(np.float32))
        assert rewards.shape == dones.shape == (len(infos),) == (env.num_envs,)
        for row in np.flatnonzero(dones):
            assert env.observation_space.contains(infos[row]["terminal_observation"])
    env.close()

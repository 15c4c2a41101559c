"""Endings as RLlib's own episodes take them: who is bootstrapped, who is not, and who earns what."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from ray.rllib.connectors.learner import AddOneTsToEpisodesAndTruncate
from ray.rllib.core.columns import Columns
from ray.rllib.env.env_context import EnvContext
from ray.rllib.env.multi_agent_episode import MultiAgentEpisode
from ray.rllib.utils.postprocessing.value_predictions import compute_value_targets

from coop_envs.actions import hold_action
from coop_envs.scenario import load_scenario
from tests.environment.policies import random_actions
from tests.train.rllib_games import make_sacrifice
from tests.train.scripted_parallel import Ends, ScriptedTeam
from train.rllib_env import FLAT_SIZE, RllibTeam, flattened, make_team
from train.rllib_training import role_of

NAMES = ("observer_0", "picket_0", "picket_1")
GAMMA, VALUE = 0.9, 10.0
STAGGERED: list[Ends] = [{}, {"picket_0": "lost"}, {}, {"picket_1": "lost"}, {}]
TIMEOUT = [*STAGGERED[:4], {"observer_0": "late"}]
TERMINATION = [*STAGGERED[:4], {"observer_0": "lost"}]
MIXED: list[Ends] = [{}, {"picket_0": "lost", "observer_0": "late", "picket_1": "late"}]
ALL_LATE: list[Ends] = [{}, dict.fromkeys(NAMES, "late")]
ALL_LOST: list[Ends] = [{}, dict.fromkeys(NAMES, "lost")]


def play(env: RllibTeam) -> tuple[MultiAgentEpisode, list[Any]]:
    """One episode, recorded as RLlib records it."""
    episode = MultiAgentEpisode(
        observation_space=env.observation_spaces,  # type: ignore[arg-type]
        action_space=env.action_spaces,  # type: ignore[arg-type]
        agent_to_module_mapping_fn=role_of,
    )
    started: Any = env.reset(seed=0)
    observations, infos = started
    episode.add_env_reset(observations=observations, infos=infos)
    course: list[Any] = []
    while not episode.is_done:
        assert set(env.agents) <= set(observations)
        actions = {name: hold_action() for name in env.agents}
        course.append(env.step(actions))
        observations, rewards, ends, cuts, infos = course[-1]
        episode.add_env_step(observations, actions, rewards, infos, terminateds=ends, truncateds=cuts)
    assert not env.agents
    return episode, course


def value_targets(episode: MultiAgentEpisode) -> dict[str, np.ndarray]:
    """RLlib's value targets of every robot's steps, where its critic values everything at `VALUE`; lambda is 1."""
    batch: dict[str, Any] = {}
    AddOneTsToEpisodesAndTruncate()(rl_module=None, batch=batch, episodes=[episode], shared_data={})  # type: ignore[arg-type]
    targets = {}
    for name, alone in episode.agent_episodes.items():
        key = next(key for key in batch[Columns.TERMINATEDS] if key[1] == name)
        ends, cuts = (np.array(batch[column][key], float) for column in (Columns.TERMINATEDS, Columns.TRUNCATEDS))
        rewards = np.array(alone.get_rewards(), float)
        values = np.full(len(rewards), VALUE)
        targets[name] = compute_value_targets(values, rewards, ends, cuts, GAMMA, 1.0)[:-1]
    return targets


def discounted(rewards: list[float], after: float) -> list[float]:
    targets = []
    for reward in reversed(rewards):
        after = reward + GAMMA * after
        targets.append(after)
    return targets[::-1]


def team(script: list[Ends], posthumous: bool) -> RllibTeam:
    return RllibTeam(ScriptedTeam(NAMES, script), posthumous=posthumous)


@pytest.mark.parametrize(
    ("script", "after"),
    [(TIMEOUT, VALUE), (TERMINATION, 0.0), (MIXED, VALUE), (ALL_LATE, VALUE), (ALL_LOST, 0.0)],
    ids=["timeout", "termination", "mixed", "all late", "all lost"],
)
def test_with_posthumous_credit_everybody_has_the_return_of_the_team(script, after) -> None:
    episode, _ = play(team(script, posthumous=True))
    expected = discounted([t + 1.0 for t in range(len(script))], after)
    for targets in value_targets(episode).values():
        np.testing.assert_allclose(targets, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("script", "after"),
    [
        (TIMEOUT, {"observer_0": VALUE, "picket_0": 0.0, "picket_1": 0.0}),
        (TERMINATION, dict.fromkeys(NAMES, 0.0)),
        (MIXED, {"observer_0": VALUE, "picket_0": 0.0, "picket_1": VALUE}),
        (ALL_LATE, dict.fromkeys(NAMES, VALUE)),
        (ALL_LOST, dict.fromkeys(NAMES, 0.0)),
    ],
    ids=["timeout", "termination", "mixed", "all late", "all lost"],
)
def test_without_it_everybody_ends_with_its_own_ending(script, after) -> None:
    episode, _ = play(team(script, posthumous=False))
    last = {name: next(t for t, ends in enumerate(script) if name in ends) for name in NAMES}
    for name, targets in value_targets(episode).items():
        expected = discounted([t + 1.0 for t in range(last[name] + 1)], after[name])
        np.testing.assert_allclose(targets, expected, rtol=1e-6)


@pytest.mark.parametrize("posthumous", [True, False])
@pytest.mark.parametrize("script", [TIMEOUT, TERMINATION, MIXED, ALL_LATE, ALL_LOST])
def test_the_team_ends_once_and_only_timeouts_truncate(script, posthumous: bool) -> None:
    _, course = play(team(script, posthumous))
    late = any("late" in ends.values() for ends in script)
    for t, (_, _, ends, cuts, _) in enumerate(course):
        over = t == len(script) - 1
        assert set(cuts) == {"__all__"} and cuts["__all__"] == (over and late)
        assert ends["__all__"] == (over and not late)
        own = {name for name, flag in ends.items() if flag and name != "__all__"}
        assert own == (set() if posthumous else {name for name, how in script[t].items() if how == "lost"})


def test_agents_shrink_without_posthumous_credit() -> None:
    env = team(TIMEOUT, posthumous=False)
    env.reset()
    left = []
    while env.agents:
        left.append(len(env.agents))
        env.step({name: hold_action() for name in env.agents})
    assert left == [3, 3, 2, 2, 1]
    assert env.possible_agents == list(NAMES)


def test_a_silent_robot_sees_what_the_first_that_is_left_sees_and_says_so() -> None:
    env = team(TIMEOUT, posthumous=True)
    env.reset()
    for t in range(5):
        seen, rewards, *_ = env.step({name: hold_action() for name in env.agents})
        lost = [name for name in NAMES if any(ends.get(name) == "lost" for ends in TIMEOUT[: t + 1])]
        assert set(rewards.values()) == {t + 1.0}
        for name in NAMES:
            assert seen[name][-1] == (name not in lost)
            if name in lost:
                np.testing.assert_array_equal(seen[name][:-1], seen["observer_0"][:-1])
                assert seen[name][4] == np.float32(0.1 * (t + 1))


def test_a_sacrificed_picket_has_its_teams_return_or_its_own() -> None:
    drive = -hold_action()
    for posthumous, returns in (
        (True, {"observer_0": 4.0, "picket_0": 4.0}),
        (False, {"observer_0": 4.0, "picket_0": -1.0}),
    ):
        env = make_sacrifice({"posthumous": posthumous})
        env.reset()
        total = dict.fromkeys(env.possible_agents, 0.0)
        while env.agents:
            _, rewards, *_ = env.step(dict.fromkeys(env.agents, drive))
            total = {name: total[name] + rewards.get(name, 0.0) for name in total}
        assert total == returns


def test_a_real_team_plays_through_losses_to_its_end() -> None:
    scenario = load_scenario("arena", **{"task.time_limit_s": 30.0, "fidelity": "poses"})
    env = make_team({"scenario": scenario})
    seen, _ = env.reset(seed=3)
    rng, docked = np.random.default_rng(0), [name for name, row in seen.items() if row[15] > 0.5]
    assert env.observation_spaces is not None
    assert docked and all(seen[name][-1] == 0.0 for name in docked) and seen["observer_0"][-1] == 1.0
    ends, cuts = {"__all__": False}, {"__all__": False}
    while env.agents:
        actions = dict(zip(env.agents, random_actions(rng, len(env.agents)), strict=True))
        seen, rewards, ends, cuts, _ = env.step(actions)
        assert list(seen) == env.possible_agents == list(rewards)
        assert all(env.observation_spaces[name].contains(row) for name, row in seen.items())
    assert ends["__all__"] != cuts["__all__"]
    env.close()


def test_no_two_teams_of_a_training_or_of_two_have_the_same_episodes() -> None:
    scenario, seeds = load_scenario("arena", team="inchworm", fidelity="poses"), set()
    for training, runner in itertools.product((0, 1), (1, 2)):
        made = EnvContext({"scenario": scenario, "num_worlds": 1, "seed": training}, worker_index=runner)
        env = make_team(made)
        for team in (0, 1):
            env.reset(seed=training + runner + team)  # as RLlib seeds it
            seeds.add(env.env.get_state()["seed"])  # type: ignore[attr-defined]
        env.close()
    assert len(seeds) == 8


def test_the_flat_observation_keeps_every_entry_and_the_means_of_the_map() -> None:
    rng = np.random.default_rng(0)
    mask = np.array([1, 1, 0, 0, 0, 0, 0], np.int8)
    seen = {
        "self": rng.normal(size=29).astype(np.float32),
        "mates": rng.normal(size=(7, 16)).astype(np.float32),
        "mask": mask,
        "map": rng.integers(0, 256, (3, 16, 16)).astype(np.uint8),
    }
    flat = flattened(seen, acting=True)
    assert flat.shape == (FLAT_SIZE,) and flat[-1] == 1.0
    np.testing.assert_array_equal(flat[:29], seen["self"])
    np.testing.assert_array_equal(flat[29:61], seen["mates"][:2].ravel())
    assert not flat[61:141].any()
    np.testing.assert_allclose(flat[148 + 16 * 1 + 4 * 2 + 3], seen["map"][1, 8:12, 12:16].mean() / 255, rtol=1e-6)

"""The vector forms: each team has what it has alone, through ends and restarts; masks and states keep."""

from __future__ import annotations

import numpy as np
import pytest

from coop_envs import exploration_v0
from tests.environment.policies import random_actions
from tests.wrappers.stacks import DISTURBANCES, VECTOR_FORMS, team, wrapped

KEYS = ("self", "mates", "mask", "map")
STACKS = [(name,) for name in DISTURBANCES] + [
    ("shield", "delay", "loss", "noise"),
    ("noise", "loss", "delay", "shield"),
]


def teams(count: int, stack, **settings):
    env = exploration_v0.vector_env(count, "arena", team="inchworm", **{"task.time_limit_s": 5.0, **settings})
    return wrapped(stack, VECTOR_FORMS, env)


@pytest.mark.parametrize("stack", STACKS, ids="-".join)
def test_a_team_in_a_batch_has_what_it_has_alone(stack) -> None:
    """Bit for bit."""
    batch = teams(3, stack)
    alone = [wrapped(stack, env=team(**{"task.time_limit_s": 5.0})) for _ in range(3)]
    batch.reset(seed=30)
    for b, env in enumerate(alone):
        env.reset(seed=30 + b)
    rng, restarts = np.random.default_rng(2), 0
    for _ in range(40):
        actions = np.stack([random_actions(rng, 3) for _ in range(3)])
        together, reward, terminated, _, _ = batch.step(actions)
        for b, env in enumerate(alone):
            if not env.agents:
                observations, _ = env.reset()
                restarts += 1
            else:
                acts = {name: actions[b, env.possible_agents.index(name)] for name in env.agents}
                observations, rewards, terminations, _, _ = env.step(acts)
                assert all(value == reward[b] for value in rewards.values())
                for name, value in terminations.items():
                    assert value == terminated[b, env.possible_agents.index(name)]
            for name in env.agents:
                for key in KEYS:
                    row = together[key][b, env.possible_agents.index(name)]
                    np.testing.assert_array_equal(observations[name][key], row)
    assert restarts >= 3


@pytest.mark.parametrize("stack", STACKS, ids="-".join)
def test_a_masked_reset_leaves_the_others_alone(stack) -> None:
    env, rng = teams(3, stack), np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(4):
        before, *_ = env.step(np.stack([random_actions(rng, 3) for _ in range(3)]))
    after, _ = env.reset(mask=[False, True, False])
    for key in (*KEYS, "alive"):
        np.testing.assert_array_equal(after[key][[0, 2]], before[key][[0, 2]])
    assert (after["self"][1] != before["self"][1]).any()


@pytest.mark.parametrize("stack", STACKS, ids="-".join)
def test_a_saved_state_goes_on_as_if_nothing_had_happened(stack) -> None:
    env, rng = teams(4, stack), np.random.default_rng(0)
    env.reset(seed=0)
    plan = [np.stack([random_actions(rng, 3) for _ in range(4)]) for _ in range(40)]

    def run(steps: slice) -> list:
        return [env.step(actions)[0] for actions in plan[steps]]

    run(slice(0, 15))
    state = env.get_state()
    first = run(slice(15, 40))
    env.set_state(state)
    for a, b in zip(first, run(slice(15, 40)), strict=True):
        for key in KEYS:
            np.testing.assert_array_equal(a[key], b[key])


def test_the_final_observations_are_disturbed_too() -> None:
    env, rng = teams(2, ("noise",)), np.random.default_rng(0)
    env.reset(seed=0)
    for _ in range(40):
        seen, _, _, _, info = env.step(np.stack([random_actions(rng, 3) for _ in range(2)]))
        if "final_obs" in info:
            np.testing.assert_array_equal(info["final_obs"]["self"], seen["self"])
            return
    pytest.fail("no episode ended")


def test_filled_up_rows_stay_empty() -> None:
    env = teams(2, ("shield", "noise", "loss"), max_robots=5)
    seen, _ = env.reset(seed=0)
    for _ in range(5):
        assert not seen["self"][:, 3:].any() and not seen["mates"][:, 3:].any() and not seen["map"][:, 3:].any()
        seen, *_ = env.step(np.zeros((2, 5, 8), dtype=np.float32))


def test_the_environment_stays_in_reach() -> None:
    env = teams(2, tuple(DISTURBANCES))
    assert env.scenario.name == "arena" and env.num_envs == 2
    assert len(env.reward_terms) == 6
    env.step(np.zeros((2, 3, 8), dtype=np.float32))  # the first step starts all, as without wrappers

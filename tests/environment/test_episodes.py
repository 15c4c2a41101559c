"""How episodes go: losses, reserves, ends, rewards, and what bad input gets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.actions import ACTION_SIZE, hold_action
from coop_envs.errors import ActionError, ConfigError, CoopError
from coop_envs.parallel_env import ExplorationParallelEnv
from coop_envs.simulation.state import Status


def drive(forward: float, yaw: float = 0.0) -> np.ndarray:
    action = np.zeros(ACTION_SIZE, dtype=np.float32)
    action[[0, 1, 2, 7]] = -1.0, forward, yaw, 1.0
    return action


def standing(env: ExplorationParallelEnv, **others: np.ndarray) -> dict[str, np.ndarray]:
    return {name: others.get(name, hold_action()) for name in env.agents}


def into_the_trap(env: ExplorationParallelEnv, name: str, forward: float = 1.0) -> tuple[dict[str, Any], int]:
    """Drive a robot into the trap, then turn in vain until it is declared lost; the last step's returns."""
    for k in range(200):
        acting = list(env.agents)
        wriggle = drive(0.5, 1.0 if k % 10 < 5 else -1.0)
        returned = env.step(standing(env, **{name: drive(forward) if k < 40 else wriggle}))
        if name not in env.agents and name in acting:
            names = ("observations", "rewards", "terminations", "truncations", "infos")
            return dict(zip(names, returned, strict=True)), k
    raise AssertionError("it was never declared lost")


def test_a_lost_picket_terminates_and_calls_a_reserve() -> None:
    env = exploration_v0.parallel_env("arena", team="scouts")
    env.reset(seed=0)
    env.step(standing(env))
    last, _ = into_the_trap(env, "picket_0")
    assert last["terminations"]["picket_0"]
    assert not last["truncations"]["picket_0"]
    assert sum(last["terminations"].values()) == 1
    assert env.batch.state.status.numpy()[0, 1] == Status.TRAPPED
    losses = [env.step(standing(env))[4]["observer_0"]["reward_terms"]["picket_lost"] for _ in range(10)]
    assert env.batch.state.status.numpy()[0, 2] == Status.ACTIVE
    assert env.frame().declared[2] == 1
    assert "picket_0" not in env.agents
    assert losses == [0.0] * 10


def test_a_loss_is_priced_once_and_the_reward_is_the_sum_of_its_terms() -> None:
    env = exploration_v0.parallel_env("arena", team="scouts")
    env.reset(seed=0)
    prices = []
    for k in range(60):
        action = drive(1.0) if k < 40 else drive(0.5, 1.0 if k % 10 < 5 else -1.0)
        if "picket_0" not in env.agents:
            break
        _, rewards, _, _, infos = env.step(standing(env, picket_0=action))
        terms = infos["observer_0"]["reward_terms"]
        assert len(set(rewards.values())) == 1
        np.testing.assert_allclose(rewards["observer_0"], sum(terms.values()), rtol=1e-5, atol=1e-6)
        prices.append(terms["picket_lost"])
    assert sum(prices) == -env.scenario.reward.loss_per_picket
    assert np.count_nonzero(prices) == 1


def test_losing_the_only_camera_ends_it_for_all() -> None:
    behind = {"trap_centre_m": (-0.4, 0.3), "trap_size_m": (0.1, 0.1)}
    env = exploration_v0.parallel_env("arena", team="scouts", environment={"geometry": behind})
    env.reset(seed=0)
    last, _ = into_the_trap(env, "observer_0", forward=-1.0)
    assert all(last["terminations"].values())
    assert env.agents == []
    assert not env.metrics()["observer_survived"]
    assert not env.metrics()["success"]


def test_reaching_the_goal_ends_it_with_success() -> None:
    env = exploration_v0.parallel_env("arena", team="scouts", environment={"geometry": {"goal": (-0.38, 0.3, 0.08)}})
    env.reset(seed=0)
    for _ in range(30):
        _, _, terminations, truncations, infos = env.step(standing(env, observer_0=drive(-1.0)))
        if not env.agents:
            break
    assert all(terminations.values()) and not any(truncations.values())
    assert infos["observer_0"]["reward_terms"]["goal"] == env.scenario.reward.goal
    assert env.metrics()["success"]


def test_a_timeout_truncates() -> None:
    env = exploration_v0.parallel_env("arena", team="inchworm", task={"time_limit_s": 2.0})
    env.reset(seed=0)
    steps = 0
    while env.agents:
        _, _, terminations, truncations, _ = env.step(standing(env))
        steps += 1
    assert all(truncations.values()) and not any(terminations.values())
    assert steps == 10


def test_lost_robots_stay_as_obstacles_unless_somebody_collects_them() -> None:
    for collected in (True, False):
        env = exploration_v0.parallel_env("arena", team="scouts", task={"collect_lost": collected})
        env.reset(seed=0)
        into_the_trap(env, "picket_0")
        env.step(standing(env))
        assert env.frame().collected[1] == collected
        assert bool(env.batch.measurements.heard.numpy()[0, 1]) != collected


def test_the_camera_sees_nothing_in_the_dark() -> None:
    env = exploration_v0.parallel_env("arena", team="inchworm", sensing={"dropout": 0.0})
    env.reset(seed=0)
    dark = {name: hold_action(-1.0) for name in env.agents}
    lit = {name: hold_action(1.0) for name in env.agents}
    env.step(dark)
    assert not env.frame().sees.any()
    env.step(lit)
    assert env.frame().sees[0].tolist() == [False, True, True]


def test_pictures_are_drawn_on_request_only() -> None:
    env = exploration_v0.parallel_env("arena", team="inchworm", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture is not None and picture.dtype == np.uint8 and picture.ndim == 3
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 50
    assert exploration_v0.parallel_env("arena").render() is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"picket_0": np.zeros(3)}, r"action\[picket_0\]\.shape: got \(3,\), expected \(8,\)"),
        ({"picket_0": np.full(8, np.nan)}, r"action\[picket_0\]\.hold: got nan, expected a finite number"),
        ({"picket_0": "north"}, r"action\[picket_0\]: got 'north', expected .* finite numbers"),
        ({"picket_9": np.zeros(8)}, r"actions: got 'picket_9', expected agents among"),
        ({"picket_0": None}, r"action\[picket_0\]: got None, expected"),
    ],
)
def test_bad_actions_get_one_line_and_change_nothing(change: dict[str, Any], message: str) -> None:
    env = exploration_v0.parallel_env("arena", team="inchworm")
    env.reset(seed=0)
    tick = int(env.batch.state.tick.numpy()[0])
    actions: dict[str, Any] = standing(env) | change
    if change.get("picket_0", 0) is None:
        del actions["picket_0"]
    with pytest.raises(ActionError, match=message) as caught:
        env.step(actions)
    assert "\n" not in str(caught.value)
    assert env.batch.state.tick.numpy()[0] == tick


def test_batches_refuse_bad_actions_too() -> None:
    env = exploration_v0.vector_env(2, "arena", team="inchworm")
    env.reset(seed=0)
    with pytest.raises(ActionError, match=r"expected \(2, 3, 8\)"):
        env.step(np.zeros((2, 3)))
    bad = np.zeros((2, 3, 8))
    bad[1, 2, 1] = np.inf
    with pytest.raises(ActionError, match=r"forward_speed: got inf"):
        env.step(bad)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"scenario": "arenna"}, "scenario: got 'arenna'.*did you mean 'arena'"),
        ({"fidelity": "pixels"}, "fidelity: got 'pixels'"),
        ({"physics": "mujoco"}, "physics: got 'mujoco'"),
        ({"render_mode": "human"}, "render_mode: got 'human'"),
        ({"split": "test"}, "split: got 'test', expected train or heldout"),
        ({"num_worlds": 0}, "num_worlds: got 0, expected 1 or more"),
        ({"task": {"time_limit": 3}}, "task.time_limit.*did you mean 'time_limit_s'"),
    ],
)
def test_bad_settings_get_one_line(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        exploration_v0.parallel_env(**settings)
    assert "\n" not in str(caught.value)


def test_nothing_works_before_the_first_reset() -> None:
    env = exploration_v0.parallel_env("arena")
    for call in (env.metrics, env.frame, lambda: env.step({})):
        with pytest.raises(CoopError, match="reset"):
            call()

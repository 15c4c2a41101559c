"""Macro-actions: robots get where they are sent, are asked one by one, and lose no reward on the way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pettingzoo.utils import BaseParallelWrapper

from coop_envs import exploration_v0
from coop_envs.errors import ConfigError
from coop_envs.observations import self_field
from coop_envs.wrappers import MacroActions
from coop_envs.wrappers.macro_driving import GO, SCAN, WAIT, MacroDriver, MacroSettings
from tests.wrappers.stacks import team

HERE = (8, 8)


class Recorder(BaseParallelWrapper):
    """Keeps the plain actions and rewards that pass through."""

    def __init__(self, env) -> None:
        super().__init__(env)
        self.actions, self.rewards = [], []

    def step(self, actions):
        self.actions.append({name: action.copy() for name, action in actions.items()})
        out = self.env.step(actions)
        self.rewards.append(out[1])
        return out


def cell_at(observation, x: float, y: float, cell_m: float = 0.05) -> tuple[int, int]:
    """The cell of a robot's window that holds a point of the team frame."""
    i = math.floor((x - self_field(observation, "map_x")) / cell_m)
    j = math.floor((y - self_field(observation, "map_y")) / cell_m)
    return i, j


def told(kind: int, cell: tuple[int, int] = HERE) -> np.ndarray:
    return np.array([kind, *cell])


def game(**settings) -> tuple[MacroActions, Recorder]:
    recorder = Recorder(team(**{"task.time_limit_s": 60.0, **settings}))
    return MacroActions(recorder), recorder


@pytest.mark.parametrize("offset", [(0.2, 0.1), (0.15, -0.1), (-0.05, 0.15)])
def test_a_picket_gets_where_it_is_sent(offset) -> None:
    env, _ = game()
    seen, _ = env.reset(seed=0)
    me = seen["picket_0"]
    cell = cell_at(me, self_field(me, "x") + offset[0], self_field(me, "y") + offset[1])
    goal = [self_field(me, key) + (k + 0.5) * 0.05 for key, k in zip(("map_x", "map_y"), cell, strict=True)]
    orders, outcome = {"picket_0": told(GO, cell)}, "running"
    while outcome == "running":
        orders |= {name: told(WAIT) for name in env.agents if name != "picket_0"}
        seen, _, _, _, infos = env.step(orders)
        outcome = infos["picket_0"]["macro_outcome"]
    assert outcome == "done" and infos["picket_0"]["asked"]
    there = [self_field(seen["picket_0"], key) for key in ("x", "y")]
    assert math.dist(there, goal) < 0.05
    assert math.dist(there, goal) < 0.5 * math.hypot(*offset)


def test_who_goes_on_is_not_asked_and_returns_add_up() -> None:
    env, recorder = game()
    seen, infos = env.reset(seed=0)
    assert all(info["asked"] for info in infos.values())
    me = seen["picket_0"]
    cell = cell_at(me, self_field(me, "x") + 0.3, self_field(me, "y"))
    orders = {"picket_0": told(GO, cell), "picket_1": told(WAIT), "observer_0": told(WAIT)}
    _, rewards, _, _, infos = env.step(orders)
    assert len(recorder.actions) == 5  # a second of waiting
    assert not infos["picket_0"]["asked"] and infos["observer_0"]["asked"] and infos["picket_1"]["asked"]
    assert infos["picket_0"]["macro_outcome"] == "running" and infos["picket_1"]["macro_outcome"] == "done"
    earned = rewards["picket_0"]
    while infos["picket_0"]["macro_outcome"] == "running":
        asked = [name for name in env.agents if infos[name]["asked"]]
        _, rewards, _, _, infos = env.step({name: told(WAIT) for name in asked})
        earned += rewards["picket_0"]
    assert infos["picket_0"]["macro_decisions"] == len(recorder.actions)
    assert infos["picket_0"]["macro_return"] == pytest.approx(earned)
    assert earned == pytest.approx(sum(rewards["picket_0"] for rewards in recorder.rewards))
    assert sum(infos["picket_0"]["reward_terms"].values()) == pytest.approx(rewards["picket_0"], abs=1e-4)


def test_the_environment_below_plays_the_plain_game() -> None:
    env, recorder = game()
    env.reset(seed=2)
    rng, last = np.random.default_rng(0), {}
    for _ in range(6):
        last, *_ = env.step({name: rng.integers(env.action_space(name).nvec) for name in env.agents})
    plain = team(**{"task.time_limit_s": 60.0})
    plain.reset(seed=2)
    for actions in recorder.actions:
        seen, *_ = plain.step(actions)
    for name, observation in last.items():
        np.testing.assert_array_equal(observation["self"], seen[name]["self"])


def test_an_observer_goes_over_proven_ground_only() -> None:
    env, recorder = game()
    seen, _ = env.reset(seed=0)
    me = seen["observer_0"]
    far = cell_at(me, self_field(me, "x") + 0.3, self_field(me, "y") - 0.15)
    orders = {"observer_0": told(GO, far), "picket_0": told(WAIT), "picket_1": told(WAIT)}
    _, _, _, _, infos = env.step(orders)
    assert infos["observer_0"]["macro_outcome"] == "blocked"
    assert len(recorder.actions) == 1 and recorder.actions[0]["observer_0"][0] > 0.0


def go_ahead(settings: MacroSettings, way_m: float, **game_settings) -> tuple[str, int]:
    """How a picket's way straight ahead ends, and after how many decisions; the others wait."""
    env = MacroActions(team(**{"task.time_limit_s": 60.0, **game_settings}), settings)
    seen, infos = env.reset(seed=0)
    me = seen["picket_0"]
    orders = {"picket_0": told(GO, cell_at(me, self_field(me, "x") + way_m, self_field(me, "y")))}
    while "macro_outcome" not in infos["picket_0"] or infos["picket_0"]["macro_outcome"] == "running":
        orders |= {name: told(WAIT) for name in env.agents if name != "picket_0"}
        seen, _, _, _, infos = env.step(orders)
    return infos["picket_0"]["macro_outcome"], infos["picket_0"]["macro_decisions"]


def test_a_robot_stops_where_it_is_sent_though_a_decision_takes_it_past() -> None:
    quick = {"team.members.picket_0.cruise_speed_m_s": 0.3, "rates.ticks_per_decision": 15}
    assert 0.3 * 0.5 > 2 * 2 * 0.03  # a decision at full speed leads across the place and out again
    for way_m in (0.2, 0.25, 0.3):
        outcome, decisions = go_ahead(MacroSettings(), way_m, **quick)
        assert outcome == "done" and decisions <= 6


def test_a_way_that_takes_too_long_ends_late() -> None:
    assert go_ahead(MacroSettings(go_limit_s=1.0), 0.35) == ("late", 6)


def test_a_robot_that_does_not_move_ends_blocked() -> None:
    base = team()
    seen = base.reset(seed=0)[0]["picket_0"]
    driver = MacroDriver(base.team_description, 1, MacroSettings(blocked_s=2.0, go_limit_s=20.0))
    driver.start(GO, cell_at(seen, self_field(seen, "x") + 0.2, self_field(seen, "y")), seen)
    outcomes = []
    while not outcomes or outcomes[-1] == "running":
        assert driver.act(seen)[0] < 0.0
        outcomes.append(driver.outcome(seen))
    assert outcomes[-1] == "blocked" and abs(len(outcomes) * 0.2 - 2.0) <= 0.2 + 1e-9


def test_a_scan_runs_until_its_raster_is_drawn() -> None:
    base = exploration_v0.parallel_env("rubble", team="surveyors", fidelity="poses", num_worlds=1)
    env = MacroActions(base, MacroSettings(scan_share=0.3))
    env.reset(seed=0)
    lasers = [
        name for name, member in zip(env.possible_agents, env.team_description.members, strict=True) if member.laser
    ]
    others = [name for name in env.possible_agents if name not in lasers]
    scanner, points, infos = lasers[0], 0, {}
    orders = {name: told(WAIT) for name in env.agents} | {scanner: told(SCAN, (15, 8))}
    for _ in range(200):
        seen, _, _, _, infos = env.step(orders)
        points += round(self_field(seen[scanner], "points"))
        if infos[scanner]["asked"]:
            break
        orders = {name: told(WAIT) for name in env.agents}
    assert infos[scanner]["macro_outcome"] == "done"
    assert self_field(seen[scanner], "scan_progress") == 1.0
    for name in others:
        _, _, _, _, infos = env.step({name: told(SCAN) if name == others[0] else told(WAIT) for name in env.agents})
        assert infos[others[0]]["macro_outcome"] == "blocked"


def test_a_robot_that_cannot_move_is_lost_before_it_is_blocked() -> None:
    """The trap of the arena: the picket is sent over it until it stays."""
    env, _ = game(team="scouts", **{"task.time_limit_s": 200.0})
    seen, infos = env.reset(seed=0)
    scout, ended = next(name for name in env.agents if name.startswith("picket") and not docked(seen[name])), {}
    for _ in range(400):
        orders = {name: told(WAIT) for name in env.agents if infos[name]["asked"]}
        if infos[scout]["asked"]:
            me = seen[scout]
            cell = cell_at(me, 0.7, 0.0)
            orders[scout] = told(GO, (min(cell[0], 15), min(max(cell[1], 0), 15)))
        seen, _, ended, _, infos = env.step(orders)
        if ended[scout] or not env.agents:
            break
    assert ended[scout] and scout not in env.agents and "observer_0" in env.agents


def docked(observation) -> bool:
    return self_field(observation, "docked") > 0.5


def test_a_reserve_in_its_dock_is_not_asked_again_before_it_is_called() -> None:
    env, _ = game(team="scouts", **{"task.time_limit_s": 20.0})
    seen, _ = env.reset(seed=0)
    waiting = [name for name in env.agents if docked(seen[name])]
    assert waiting
    while env.agents:
        seen, _, _, truncations, infos = env.step({name: told(WAIT) for name in env.agents})
        assert not any(infos[name]["asked"] for name in waiting if docked(seen[name]))
    assert all(truncations.values())


@pytest.mark.parametrize("action", [None, [0, 8], [3, 0, 0], [0, 16, 0], [-1, 0, 0]])
def test_who_is_asked_must_answer_within_the_space(action) -> None:
    env, _ = game()
    env.reset(seed=0)
    orders = {name: told(WAIT) for name in env.agents} | {"picket_1": action}
    with pytest.raises(ConfigError, match=r"^action\[picket_1\]: got"):
        env.step({name: order for name, order in orders.items() if order is not None})


@pytest.mark.parametrize(
    ("field", "value"),
    [("go_limit_s", 0.0), ("wait_s", -1.0), ("blocked_s", 0.0), ("scan_share", 1.5), ("brightness", 2.0)],
)
def test_settings_are_checked(field: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"^macro\.{field}: got"):
        MacroSettings(**{field: value})  # type: ignore[arg-type]

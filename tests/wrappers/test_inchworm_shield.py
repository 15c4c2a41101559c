"""The shield against the rule itself, worked out on graphs of robots with names."""

from __future__ import annotations

import subprocess
import sys

import networkx as nx
import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.estimation.belief import Declared
from coop_envs.inchworm_rule import permitted
from coop_envs.observations import MATE_FIELDS, SELF_FIELDS
from coop_envs.wrappers import InchwormShield
from tests.environment.policies import random_actions
from tests.wrappers.stacks import team

SELF = {field.name: (k, field.scale) for k, field in enumerate(SELF_FIELDS)}
MATE = {field.name: (k, field.scale) for k, field in enumerate(MATE_FIELDS)}


class Meeting:
    """Robots at random places and tilts, some docked, some lost, who see each other at random."""

    def __init__(self, rng: np.random.Generator, robots: int) -> None:
        n, self.robots = robots, range(robots)
        self.xyz = rng.permutation(np.arange(n))[:, None] * [0.2, 0.0, 0.05] + rng.uniform(-0.05, 0.05, (n, 3))
        self.angles = rng.uniform([-np.pi, -0.4, -0.4], [np.pi, 0.4, 0.4], (n, 3))
        self.stationary, self.wants = rng.random(n) < 0.5, rng.random(n) < 0.6
        self.docked, self.lost = rng.random(n) < 0.15, rng.random(n) < 0.15
        self.lost &= ~self.docked
        self.at_work = ~self.docked & ~self.lost
        self.sees = (rng.random((n, n)) < 0.3) & ~np.eye(n, dtype=bool) & self.at_work[:, None] & ~self.docked[None, :]

    def rotation(self, r: int) -> np.ndarray:
        """Columns x (heading yaw, rising by pitch), y (its end at the height of roll) and their cross product."""
        yaw, pitch, roll = self.angles[r]
        x = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
        level = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
        up = np.cross(x, level)
        y = np.cos(turn := np.arcsin(np.sin(roll) / up[2])) * level + np.sin(turn) * up
        return np.stack([x, y, np.cross(x, y)], axis=1)

    def observations(self) -> dict[str, np.ndarray]:
        n = len(self.robots)
        own, mates = np.zeros((n, len(SELF)), np.float32), np.zeros((n, 7, len(MATE)), np.float32)
        mask = np.zeros((n, 7), np.int8)

        def put(row: np.ndarray, table, **values: float) -> None:
            for name, value in values.items():
                k, scale = table[name]
                row[k] = value / scale

        for r in self.robots:
            x, y, z = self.xyz[r]
            yaw, pitch, roll = self.angles[r]
            put(own[r], SELF, x=x, y=y, z=z, cos_yaw=np.cos(yaw), sin_yaw=np.sin(yaw), pitch=pitch, roll=roll)
            put(own[r], SELF, stationary=self.stationary[r], docked=self.docked[r], role_observer=1.0)
            others = sorted((o for o in self.robots if o != r), key=lambda o: np.linalg.norm(self.xyz[o] - self.xyz[r]))
            for m, o in enumerate(others[:7]):
                mask[r, m] = 1
                x, y, z = self.rotation(r).T @ (self.xyz[o] - self.xyz[r])
                put(mates[r, m], MATE, x=x, y=y, z=z, stationary=self.stationary[o], lost=self.lost[o])
                put(mates[r, m], MATE, docked=self.docked[o], i_see=self.sees[r, o], sees_me=self.sees[o, r])
        return {"self": own, "mates": mates, "mask": mask, "alive": (~self.lost).astype(np.int8)}

    def actions(self) -> np.ndarray:
        actions = np.full((len(self.robots), 8), 0.3, np.float32)
        actions[:, 0] = np.where(self.wants, -1.0, 1.0)
        return actions

    def keeps_the_rule(self, moving: set[int]) -> bool:
        """Whether every mover is linked to a robot that is declared stationary and does not move."""
        graph = nx.Graph()
        graph.add_nodes_from(self.robots)
        # a lost robot is a landmark, not a link, unless it rests
        pairs = [(r, o) for r in self.robots for o in self.robots if self.sees[r, o]]
        graph.add_edges_from((r, o) for r, o in pairs if not self.lost[o] or self.stationary[o])
        fixed = {r for r in self.robots if self.stationary[r] and r not in moving and not self.docked[r]}
        return all(fixed & nx.node_connected_component(graph, r) for r in moving)


@pytest.mark.parametrize("robots", [1, 2, 3, 5, 8])
def test_what_moves_keeps_the_rule_and_no_one_more_could_move(robots: int) -> None:
    rng, moved = np.random.default_rng(robots), 0
    meetings = [Meeting(rng, robots) for _ in range(150)]
    seen = [meeting.observations() for meeting in meetings]
    asked = np.stack([meeting.actions() for meeting in meetings])
    done = permitted({key: np.stack([one[key] for one in seen]) for key in seen[0]}, asked)
    for b, meeting in enumerate(meetings):
        np.testing.assert_array_equal(permitted(seen[b], asked[b]), done[b])
        working = {r for r in meeting.robots if meeting.at_work[r]}
        moving = {r for r in working if done[b, r, 0] <= 0.0}
        assert all(meeting.wants[r] for r in moving)
        assert meeting.keeps_the_rule(moving), b
        for r in working - moving:
            assert not meeting.wants[r] or not meeting.keeps_the_rule(moving | {r}), (b, r)
            if meeting.wants[r]:
                assert done[b, r, 0] == 1.0 and done[b, r, 4] == -1.0
        moved += len(moving)
        untouched = [r for r in meeting.robots if done[b, r, 0] == asked[b, r, 0]]
        np.testing.assert_array_equal(done[b, untouched], asked[b, untouched])
    assert moved > 10 if robots > 1 else moved == 0


@pytest.mark.parametrize(("scenario", "members"), [("arena", "scouts"), ("arena", "inchworm"), ("rubble", "surveyors")])
def test_in_the_simulation_whoever_moves_is_tied_to_one_that_stands(scenario: str, members: str) -> None:
    """Held against who saw whom in the belief, which names robots."""
    env = InchwormShield(exploration_v0.parallel_env(scenario, team=members, fidelity="poses", num_worlds=1))
    env.reset(seed=1)
    rng, moves, held = np.random.default_rng(1), 0, 0
    for _ in range(150):
        belief, names = env.batch.belief, env.possible_agents
        seen, still = belief.seen.numpy()[0] > 0, belief.stationary.numpy()[0] > 0
        there = belief.declared.numpy()[0] != Declared.DOCKED
        graph = nx.from_numpy_array(np.asarray((seen | seen.T) & there[:, None] & there[None, :]))
        before = env.agents
        actions = random_actions(rng, len(before))
        wants = {names.index(name) for name, row in zip(before, actions, strict=True) if row[0] <= 0.0}
        _, _, _, _, infos = env.step(dict(zip(before, actions, strict=True)))
        moving = {r for r in wants if not infos[names[r]]["shielded"] and there[r]}
        for r in moving:
            fixed = [o for o in nx.node_connected_component(graph, r) if still[o] and o not in moving and there[o]]
            assert fixed
        moves, held = moves + len(moving), held + len(wants) - len(moving)
        if not env.agents:
            break
    assert moves >= 5 and held > 20


def test_who_asks_for_nothing_is_left_alone_and_a_team_may_still_travel() -> None:
    """Turn by turn, as the rule intends, everybody's moves pass."""
    clear = dict.fromkeys(("sensing.dropout", "sensing.outlier", "sensing.blob_dropout", "sensing.false_lights"), 0.0)
    env = InchwormShield(team(**{"task.time_limit_s": 60.0, **clear}))
    env.reset(seed=0)
    hold, drive = np.array([1, 0, 0, 0, 0, 0, 0, 1], np.float32), np.array([-1, 0.5, 0, 0, 0, 0, 0, 1], np.float32)
    for mover in ("picket_0", "picket_1"):
        for _ in range(5):
            _, _, _, _, infos = env.step(dict.fromkeys(env.agents, hold))
        for _ in range(5):
            _, _, _, _, infos = env.step({name: drive if name == mover else hold for name in env.agents})
            assert not any(info["shielded"] for info in infos.values())


def test_a_frame_in_which_nobody_is_seen_holds_the_mover_until_the_next() -> None:
    env = InchwormShield(team(**{"task.time_limit_s": 60.0}))
    observations, _ = env.reset(seed=0)
    hold, drive = np.array([1, 0, 0, 0, 0, 0, 0, 1], np.float32), np.array([-1, 0.2, 0, 0, 0, 0, 0, 1], np.float32)
    for _ in range(5):
        observations, *_ = env.step(dict.fromkeys(env.agents, hold))
    lit = []
    for _ in range(30):
        unseen = not (observations["picket_0"]["mates"][:, MATE["sees_me"][0]] > 0).any()
        observations, _, _, _, infos = env.step({name: drive if name == "picket_0" else hold for name in env.agents})
        assert infos["picket_0"]["shielded"] == unseen
        lit.append(not unseen)
    assert 0 < lit.count(False) < 20


def test_the_rule_does_not_need_the_simulation() -> None:
    """So that a robot's host can keep it."""
    program = "import sys, coop_envs.inchworm_rule; print(*[m for m in sys.modules if m.startswith('coop_envs.simul')])"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not run.stdout.split()

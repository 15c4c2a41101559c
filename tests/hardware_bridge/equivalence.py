"""The same policy and seed in simulation and through emulated robots: how far both went and how wrong they were."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs import exploration_v0
from coop_envs.actions import hold_action
from coop_envs.policy import Actions, Observations, Policy, TeamDescription, TeamNeeds
from hardware_bridge.mission import Mission
from hardware_bridge.preflight import LISTEN_S
from hardware_bridge.runner import Tick
from hardware_bridge.session import Order, prepared


class Loops:
    """In turns, everybody drives along a curve and next time back along it, whatever they see, in sight of the others.

    A policy that minds what it sees goes other ways after the least difference, and out of sight errors grow as chance
    has it: then many more runs would be needed to tell anything.
    """

    name = "loops"
    needs = TeamNeeds()

    def reset(self, team: TeamDescription, seed: int) -> None:
        self._names, self._decision = team.names, 0
        self._rng = np.random.default_rng(seed)
        self._turns = self._rng.uniform(-0.3, 0.3, size=(len(team.names), 64))

    def act(self, observations: Observations) -> Actions:
        leg, self._decision = self._decision // 12, self._decision + 1
        visit, mover = divmod(leg, len(self._names))
        way = 1.0 if visit % 2 == 0 else -1.0
        actions: Actions = {}
        for i, name in enumerate(self._names):
            hold = -1.0 if i == mover else 1.0
            turn = way * self._turns[i, visit // 2 % 64]
            actions[name] = np.array([hold, 0.6 * way, turn, 0, 0, 0, 0, 0.6], dtype=np.float32)
        return {name: actions[name] for name in observations}


@dataclass(frozen=True)
class Run:
    """Of one run: mean distance of belief from truth over time and robots, the same at the end, the way gone (m)."""

    path_error_m: float
    drift_m: float
    path_m: float


def emulated(
    folder: Path, team: Any, links: list[Any], scenario: str, seed: int, seconds: float, policy: Policy
) -> Run:
    """A run through emulated robots in lock-step; ``links`` by place in the team."""
    robots = {}
    for member, link in zip(team_members(team), links, strict=True):
        robots[member.name] = {"link": link} | ({"camera": {"kind": "simulator"}} if member.camera else {})
    file = folder / f"team_{seed}.yaml"
    emulation = {"scenario": scenario, "seed": seed, "lockstep": True}
    safety = {"inchworm": False, "barrier": False, "max_accel_m_s2": None, "max_pose_age_s": None, "max_sigma_m": None}
    file.write_text(json.dumps({"team": team, "robots": robots, "emulation": emulation, "safety": safety}))
    order = Order(file, "loops", policy, seed, None, time_limit_s=seconds)
    errors: list[float] = []
    truth: dict[str, Any] = {}

    def watch(mission: Mission, tick: Tick) -> None:
        if tick.outcome.decided and session.emulation is not None:
            truth.update(session.emulation.truth())
            errors.append(mean_error(np.asarray(truth["position"]), mission.belief.position.numpy()[0]))

    with prepared(order, str, watch=watch) as session:
        session.run()
    return Run(float(np.mean(errors)), errors[-1], float(np.sum(truth["path"])))


def simulated(team: Any, scenario: str, seed: int, seconds: float, policy: Policy) -> Run:
    """The same run in the environment, at rest first for as long as the pre-flight listens."""
    env = exploration_v0.parallel_env(scenario, team=team, fidelity="features")
    observations, _ = env.reset(seed=seed, options={"world_index": 0, "split": "heldout"})
    policy.reset(env.team_description, seed)
    batch, errors = env.batch, []
    x, y, z, yaw = (float(v) for v in batch.state.frame.numpy()[0])
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for _ in range(round(LISTEN_S / env.scenario.rates.decision_s)):
        observations, *_ = env.step({name: hold_action() for name in env.agents})
    for _ in range(round(seconds / env.scenario.rates.decision_s) - 1):
        true = (batch.state.position.numpy()[0] - (x, y, z)) @ turn
        errors.append(mean_error(true, batch.belief.position.numpy()[0]))
        observations, *_ = env.step(policy.act({name: observations[name] for name in env.agents}))
    return Run(float(np.mean(errors)), errors[-1], float(batch.state.path.numpy()[0].sum()))


def mean_error(true: NDArray[Any], believed: NDArray[Any]) -> float:
    """Mean distance over the robots, in the plane."""
    return float(np.linalg.norm(true[:, :2] - believed[:, :2], axis=1).mean())


def team_members(team: Any) -> Any:
    from coop_envs.agents.catalog import load_team

    return load_team(team).members

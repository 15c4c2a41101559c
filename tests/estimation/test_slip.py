"""Whether the covariance tells the truth on ground that gives and of robots that are pushed: NEES over many teams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from coop_envs.estimation.settings import Estimation
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.scenario import load_scenario
from experiments.inchworm_driver import u_turn
from experiments.inchworm_streams import Streams
from tests.estimation.test_robustness import nees

BAND = (0.84, 1.25)
EVERY, SETTLED_S = 6, 13.0
"""Evaluations every so many ticks, once each robot has moved: till then the observer is exact by definition."""
GIVES_M_RTS = 5e-4
OBSERVER, PICKET = 0, 1

Disturbance = Callable[[Streams], None]


@dataclass(frozen=True)
class Course:
    """K instants of B teams of N robots: times (K,), NEES over six (K, B, N; NaN once arrived), and who was demoted."""

    time_s: np.ndarray
    nees: np.ndarray
    demoted: np.ndarray

    def shares(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N,) shares of instants, all teams still on their way, whose mean is below, in and above the band."""
        on_way = ~np.isnan(self.nees).any(axis=(1, 2)) & (self.time_s > SETTLED_S)
        mean = self.nees[on_way].mean(axis=1)
        assert len(mean) > 50
        low, high = mean < BAND[0], mean > BAND[1]
        return low.mean(axis=0), 1.0 - low.mean(axis=0) - high.mean(axis=0), high.mean(axis=0)


def follow(disturb: Disturbance | None, teams: int, increments: int = 5, **settings: Any) -> Course:
    """Inchworm increments of the U-turn, robots disturbed between frames."""
    scenario = load_scenario("u_turn", **{"rates.ticks_per_decision": 1})
    plan = replace(u_turn(), stops_m=u_turn().stops_m[: increments + 1])
    streams = Streams(scenario, plan, teams)
    estimation = replace(scenario.estimation, **settings)
    team = TeamFilter(scenario.team, estimation, streams.measurements, streams.command, running=streams.running)
    team.reset(streams.starts)
    times, shares, demoted = [], [], np.zeros(streams.measurements.heard.shape, dtype=int)
    seen_demoted = []
    while streams.step():
        team.step(streams.tick_s)
        demoted |= team.belief.demoted.numpy()
        if streams.ticks % EVERY == 0:
            times.append(streams.time_s)
            shares.append(nees(team.belief, *streams.truth()))
            shares[-1][streams.running.numpy() == 0] = np.nan
            seen_demoted.append(demoted.copy())
            demoted[:] = 0
        if disturb is not None:
            disturb(streams)
    return Course(np.array(times), np.array(shares), np.array(seen_demoted))


def standing(streams: Streams) -> np.ndarray:
    """(B, N) whose wheels stand, on their way."""
    still = np.abs(streams.physics.state.wheels.numpy()).max(axis=-1) == 0.0
    return still & (streams.running.numpy()[:, None] == 1)


def shift(streams: Streams, by_m: np.ndarray) -> None:
    """Move robots (B, N, 2) in truth; nobody is told."""
    streams.physics.state.position.numpy()[..., :2] += by_m.astype(np.float32)


def giving_ground(seed: int = 0) -> Disturbance:
    """Whoever stands creeps along the ground, a random walk."""
    rng = np.random.default_rng(seed)

    def disturb(streams: Streams) -> None:
        still = standing(streams)[..., None]
        sigma_m = GIVES_M_RTS * np.sqrt(streams.tick_s)
        shift(streams, np.where(still, rng.normal(size=(*still.shape[:2], 2)) * sigma_m, 0.0))

    return disturb


class Push:
    """Once in each team, when all have stood a while after some time, a robot is set down elsewhere."""

    def __init__(self, robot: int, teams: int, after_s: float = 13.0) -> None:
        self.robot, self.after_s = robot, after_s
        self.rested_s, self.at_s = np.zeros(teams), np.full(teams, np.nan)
        self.rng = np.random.default_rng(0)

    def __call__(self, streams: Streams) -> None:
        self.rested_s = np.where(standing(streams).all(axis=1), self.rested_s + streams.tick_s, 0.0)
        now = (self.rested_s > 0.8) & (streams.time_s > self.after_s) & np.isnan(self.at_s)
        angle, length_m = self.rng.uniform(0.0, 2 * np.pi, len(now)), self.rng.uniform(0.02, 0.1, len(now))
        by_m = np.zeros((*streams.measurements.heard.shape, 2))
        by_m[now, self.robot] = (np.stack([np.cos(angle), np.sin(angle)], axis=-1) * length_m[:, None])[now]
        shift(streams, by_m)
        self.at_s[now] = streams.time_s


@pytest.mark.slow
@pytest.mark.parametrize("wheels", [False, True])
@pytest.mark.parametrize("gives", [False, True])
def test_never_surer_than_right_and_nearly_always_in_the_band(wheels, gives):
    slip_m_rts = GIVES_M_RTS if gives else Estimation().slip_position_m_rts
    course = follow(giving_ground() if gives else None, 200, wheels=wheels, slip_position_m_rts=slip_m_rts)
    low, within, high = course.shares()
    print(f"wheels {wheels}, ground gives {gives}: below {low}, in the band {within}, above {high}")
    assert np.all(high <= 0.02), high
    if not wheels:
        assert np.all(within >= 0.9), within
    else:  # tracks' slip counts as white at its spectrum's height, more than it does over a move of two seconds
        assert np.all(within >= 0.6), within


@pytest.mark.slow
@pytest.mark.parametrize("robot", [OBSERVER, PICKET])
def test_who_is_pushed_while_all_rest_is_demoted_and_soon_known_again(robot):
    push = Push(robot, 100)
    course = follow(push, 100, increments=3)
    assert np.isfinite(push.at_s).all()
    soon = [(course.time_s > at_s) & (course.time_s < at_s + 1.0) for at_s in push.at_s]
    demoted = np.array([course.demoted[instants, b].any(axis=0) for b, instants in enumerate(soon)])
    # who sees one mate alone cannot tell which of the two was moved
    assert demoted[:, robot].mean() >= 0.9 and demoted.any(axis=1).mean() >= 0.97
    later = np.array([course.nees[np.searchsorted(course.time_s, at_s + 2.0), b] for b, at_s in enumerate(push.at_s)])
    assert np.median(later) < 1.5
    assert np.mean(later.max(axis=-1) > 5.0) <= 0.06

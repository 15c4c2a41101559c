"""A mission through a simulator's process against the environment; and policies that fail."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.policy import TeamNeeds
from hardware_bridge.mission import Mission
from hardware_bridge.tick_inputs import TickInputs
from tests.hardware_bridge.emulated import Team, rubble, serving, settled

SEED, DECISIONS = 3, 20


class Scripted:
    """All drive gently ahead; ``spoil`` has the last word on its answers."""

    name = "scripted"
    needs = TeamNeeds()

    def __init__(self, spoil=lambda decision, actions: actions):
        self._spoil, self._decision = spoil, 0

    def reset(self, team, seed):
        self._decision = 0

    def act(self, observations):
        self._decision += 1
        actions = {name: np.array([-1, 0.4, 0.1, 0, 0, 0, 0, 0.6], dtype=np.float32) for name in observations}
        return self._spoil(self._decision, actions)


def test_beliefs_are_the_environments_but_for_how_noise_falls():
    """Sight and IMU have the same noise; odometry errs by other draws, biases walk in other steps, both as far."""
    env = exploration_v0.parallel_env(rubble(), fidelity="features")
    observations, _ = env.reset(seed=SEED, options={"world_index": 0, "split": "heldout"})
    theirs, policy = [env.batch.belief.position.numpy()[0].copy()], Scripted()
    for _ in range(DECISIONS - 1):
        observations, *_ = env.step(policy.act({name: observations[name] for name in env.agents}))
        theirs.append(env.batch.belief.position.numpy()[0].copy())
    ours = []
    with serving(rubble(), seed=SEED) as server:
        team = Team(server, Scripted())
        watch = lambda tick: tick.outcome.decided and ours.append(team.mission.belief.position.numpy()[0].copy())  # noqa: E731
        team.run(DECISIONS, watch)
        truth = np.asarray(server.world.truth()["position"])
    assert len(ours) == DECISIONS
    apart = np.linalg.norm((np.asarray(ours) - np.asarray(theirs))[:, :, :2], axis=2)
    assert apart[0].max() < 3e-3  # here hats are lit at rest, in the environment they are still dark
    assert apart.max() < 0.02
    assert np.linalg.norm((ours[-1] - truth)[:, :2], axis=1).max() < 0.1
    assert np.linalg.norm(truth[:, :2] - ours[0][:, :2], axis=1).min() > 0.1


def wrong_answers():
    def raises(actions):
        raise RuntimeError("no idea")

    def not_a_number(actions):
        first = next(iter(actions))
        return actions | {first: actions[first] * np.nan}

    yield pytest.param(raises, id="raises")
    yield pytest.param(not_a_number, id="not a number")
    yield pytest.param(lambda actions: dict(list(actions.items())[1:]), id="misses one")
    yield pytest.param(lambda actions: None, id="nothing at all")
    yield pytest.param(lambda actions: {name: a[:3] for name, a in actions.items()}, id="too short")


@pytest.mark.parametrize("spoil", list(wrong_answers()))
def test_a_policy_that_fails_stands_everybody_and_the_mission_goes_on(spoil):
    with serving(rubble()) as server:
        team = Team(server, Scripted(lambda k, actions: spoil(actions) if 4 <= k < 8 else actions))
        assert team.run(11) == "stopped"
    decided = [tick for tick in team.ticks if tick.outcome.decided]
    for k, tick in enumerate(decided, start=1):
        stands = [safe.command.stands for safe in tick.outcome.safe]
        assert stands == [4 <= k < 8] * 3, k
        told = [event for event in tick.events if event.kind == "policy"]
        assert len(told) == (4 <= k < 8)
    rules = {i.rule for tick in team.ticks[1:] for i in tick.outcome.interventions}
    assert rules == {"deadman"}  # 0.4 s without an answer


def test_nobody_moves_before_the_first_decision():
    with serving(rubble()) as server:
        team = Team(server, Scripted())
        team.run(1)
    assert len(team.ticks) == 7
    assert all(safe.command.stands for tick in team.ticks[:6] for safe in tick.outcome.safe)
    assert not any(tick.outcome.interventions for tick in team.ticks[1:])  # before, nobody has reported


def test_the_time_limit_ends_it():
    with serving(rubble()) as server:
        team = Team(server, Scripted(), time_limit_s=1.0)
        assert team.run(100) == "the time limit of 1 s is over"


def test_silent_robots_and_no_frames_stand_everybody():
    with serving(rubble()) as server:
        mission = Mission(settled(server), Scripted(), 0)
    for k in range(20):
        outcome = mission.tick(TickInputs(k / 30))
        mission.note_sent([safe.command for safe in outcome.safe])
        assert all(safe.command.stands for safe in outcome.safe)
    assert {i.rule for i in outcome.interventions} == {"silent robot"}


def test_the_same_inputs_give_the_same_bits():
    with serving(rubble()) as server:
        team = Team(server, Scripted())
        team.run(5)
        again = Mission(team.deployment, Scripted(), 0)
    for tick in team.ticks:
        outcome = again.tick(tick.inputs)
        assert outcome.wanted == tick.outcome.wanted
        assert [s.command for s in outcome.safe] == [s.command for s in tick.outcome.safe]
        again.note_sent(tick.sent)
    for name in ("position", "covariance", "rotation", "gyro_bias"):
        ours, theirs = getattr(again.belief, name).numpy(), getattr(team.mission.belief, name).numpy()
        assert ours.tobytes() == theirs.tobytes(), name
    assert math.isfinite(float(again.belief.position.numpy().sum()))

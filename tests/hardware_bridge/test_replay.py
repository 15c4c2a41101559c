"""The sim-to-real contract: belief and observations are a function of plan, measurements and commands alone."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coop_envs import exploration_v0
from coop_envs.batch import belief_settings
from coop_envs.geometry.arrays import to_numpy
from coop_envs.recording.log_format import LogMetadata
from coop_envs.recording.log_writer import EpisodeWriter
from hardware_bridge.replay import BeliefReplay
from tests.environment.policies import random_actions
from tests.hardware_bridge.episode import COMMANDS, MEASUREMENTS, fingerprint, replayed

ROOT = Path(__file__).parents[2]
EPISODES = [
    ("arena", "scouts", 250),
    ("random_arena", "scouts", 120),
    ("u_turn", "inchworm", 80),
    ("arena", "surveyors", 80),
]

BARRIER: dict[str, Any] = {"environment.geometry.trap_size_m": (0.15, 0.5)}  # few pickets get past it


def scouting(rng: np.random.Generator, agents: list[str]) -> dict[str, np.ndarray]:
    """Pickets mostly go ahead, the observer mostly watches."""
    actions = random_actions(rng, len(agents))
    actions[1:, 0], actions[1:, 1] = -1.0, 0.5 + 0.5 * np.abs(actions[1:, 1])
    actions[1:, 2] *= 0.5
    actions[0, 0] = rng.choice([1.0, 1.0, -1.0])
    return dict(zip(agents, actions, strict=True))


def record(log: Path, scenario: str, team: str, decisions: int):
    """Play an episode at random and log what robots said and heard; its fingerprints and what a host knows of it."""
    env = exploration_v0.parallel_env(scenario, team=team, **BARRIER if scenario == "arena" else {})
    rng = np.random.default_rng(4)
    metadata = LogMetadata(scenario=scenario, seed=7, policy="random", version="test")
    prints: list[dict[str, str]] = []
    with EpisodeWriter(log, metadata) as writer:
        observations, _ = env.reset(seed=7)
        for k in range(decisions):
            batch = env.batch
            writer.write_arrays(MEASUREMENTS, 0.2 * k, to_numpy(batch.measurements))
            writer.write_arrays(COMMANDS, 0.2 * k, to_numpy(batch.command))
            prints.append(fingerprint(batch.belief, batch.map, observations))
            if not env.agents:
                break
            if k % 8 == 0:
                actions = scouting(rng, env.possible_agents)
            observations, *_ = env.step({name: actions[name] for name in env.agents})
    settings = belief_settings(env.scenario, env.batch.pool.map_shape)
    return prints, settings, env.batch.pool.plan(np.zeros(1, dtype=np.int32)), env


def assert_same(ours: list[dict[str, str]], theirs: list[dict[str, str]]) -> None:
    """Every array that the recording knows, decision by decision; agents that were lost are not observed any more."""
    assert len(ours) == len(theirs)
    for k, (a, b) in enumerate(zip(ours, theirs, strict=True)):
        wrong = [name for name in a if a[name] != b[name]]
        assert not wrong, (k, wrong)


@pytest.mark.parametrize(("scenario", "team", "decisions"), EPISODES)
def test_replay_without_the_simulator_gives_the_same_bits(tmp_path, scenario, team, decisions):
    log, known, out = tmp_path / "episode.mcap", tmp_path / "known.pkl", tmp_path / "prints.json"
    recorded, settings, plan, _ = record(log, scenario, team, decisions)
    known.write_bytes(pickle.dumps((settings, plan)))
    command = [sys.executable, "-m", "tests.hardware_bridge.replay_alone", str(log), str(known), str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert done.returncode == 0, done.stderr
    assert_same(recorded, json.loads(out.read_text()))


def test_the_recording_holds_losses_and_reserves(tmp_path):
    """So that the test above covers joining and losing robots too."""
    _, _, _, env = record(tmp_path / "episode.mcap", *EPISODES[0])
    declared = env.batch.belief.declared.numpy()[0]
    assert (declared == 2).sum() >= 2
    assert (declared[2:] == 1).any()


def test_the_simulator_is_really_out_of_reach(tmp_path):
    code = "import sys; from tests.hardware_bridge.replay_alone import NoSimulator;"
    code += "sys.meta_path.insert(0, NoSimulator());"
    for module in (
        "coop_envs.simulation.fast",
        "coop_envs.worlds.world",
        "coop_envs.batch",
        "coop_envs.exploration_v0",
    ):
        done = subprocess.run(
            [sys.executable, "-c", f"{code} import {module}"], cwd=ROOT, capture_output=True, text=True
        )
        assert "is not on a robot's host" in done.stderr, module


def test_another_measurement_gives_another_belief(tmp_path):
    log = tmp_path / "episode.mcap"
    recorded, settings, plan, env = record(log, "u_turn", "inchworm", 20)
    assert replayed(log, settings, plan) == recorded
    measurements, command = to_numpy(env.batch.measurements), to_numpy(env.batch.command)
    first, second = BeliefReplay(settings, plan), BeliefReplay(settings, plan)
    first.step(measurements, command)
    second.step(measurements | {"gyro": np.asarray(measurements["gyro"], dtype=float) + 0.5}, command)
    assert not np.array_equal(first.loop.belief.rotation.numpy()[0, 0], second.loop.belief.rotation.numpy()[0, 0])


def test_run_yields_an_observation_of_every_robot_for_every_decision(tmp_path):
    _, settings, plan, env = record(tmp_path / "episode.mcap", "u_turn", "inchworm", 3)
    decision = (to_numpy(env.batch.measurements), to_numpy(env.batch.command))
    observed = list(BeliefReplay(settings, plan).run([decision] * 4))
    assert len(observed) == 4
    assert list(observed[0]) == env.possible_agents
    assert env.observation_space("observer_0").contains(observed[-1]["observer_0"])


@pytest.mark.parametrize(("name", "wrong"), [("gyro", np.zeros((1, 2, 6, 3))), ("seen", None)])
def test_measurements_of_another_team_are_refused(tmp_path, name, wrong):
    _, settings, plan, env = record(tmp_path / "episode.mcap", "u_turn", "inchworm", 1)
    measurements = to_numpy(env.batch.measurements)
    measurements[name] = wrong
    if wrong is None:
        del measurements[name]
    with pytest.raises((KeyError, ValueError), match=name):
        BeliefReplay(settings, plan).step(measurements, to_numpy(env.batch.command))

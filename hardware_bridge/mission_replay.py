"""A mission once more from its log alone: the same inputs give the same beliefs and commands, bit for bit."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coop_envs.device import prepare
from coop_envs.errors import ConfigError
from coop_envs.policy import load_policy
from hardware_bridge.command import RobotCommand
from hardware_bridge.deployment import load_deployment
from hardware_bridge.mission import DEVICE, Mission
from hardware_bridge.mission_log_format import BELIEF
from hardware_bridge.mission_reader import MissionReader
from hardware_bridge.session import belief_arrays


@dataclass(frozen=True)
class Replayed:
    """How far a replay went, and where it differed first, None if nowhere.

    ``decisions`` counts those whose recorded belief was compared; a log may lack some.
    """

    ticks: int
    decisions: int
    difference: str | None
    note: str | None


def replay_mission(path: str | Path, policy: str | None = None) -> Replayed:
    """Run a mission's log through the runner's core; ``policy`` replaces the one that the log names.

    Raises:
        ConfigError: not a mission's log, or its policy is not to be had.
    """
    prepare(DEVICE)
    reader = MissionReader(path)
    metadata = reader.metadata
    asked = policy or metadata.policy
    deployment = load_deployment(json.loads(metadata.settings))
    mission = Mission(deployment, load_policy(asked) if asked else None, metadata.seed)
    beliefs, interventions = reader.arrays(BELIEF), list(reader.interventions())
    recorded = next(beliefs, None)
    ticks = decisions = at = 0
    for tick in reader.ticks():
        if tick.wanted is None or tick.sent is None:
            break
        now_s = tick.inputs.time_s
        outcome = mission.tick(tick.inputs)
        ours = interventions[at : at + len(outcome.interventions)]
        at += len(outcome.interventions)
        if dict(zip(mission.names, outcome.wanted, strict=True)) != tick.wanted:
            return Replayed(ticks, decisions, f"commands at {now_s:.3f} s", reader.note)
        if tuple(ours) != outcome.interventions:
            if reader.note and tuple(ours) == outcome.interventions[: len(ours)] and at > len(interventions):
                break  # the log was cut within this tick
            return Replayed(ticks, decisions, f"interventions at {now_s:.3f} s", reader.note)
        if recorded is not None and recorded[0] == now_s:  # a disk that is behind leaves beliefs out
            wrong = _different(recorded[1], belief_arrays(mission))
            if wrong:
                return Replayed(ticks, decisions, f"belief.{wrong} at {now_s:.3f} s", reader.note)
            decisions, recorded = decisions + 1, next(beliefs, None)
        mission.note_sent([tick.sent.get(name, RobotCommand()) for name in mission.names])
        ticks += 1
    if ticks == 0:
        raise ConfigError("log", str(path), "a log with at least one tick")
    more = "interventions after the last tick" if at < len(interventions) else None
    return Replayed(ticks, decisions, more, reader.note)


def _different(recorded: dict[str, np.ndarray], ours: dict[str, np.ndarray]) -> str | None:
    for name, array in ours.items():
        if recorded[name].tobytes() != np.ascontiguousarray(array).tobytes():
            return name
    return None

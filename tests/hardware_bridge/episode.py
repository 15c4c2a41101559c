"""A recorded episode: what a robot's host gets to hear, and what simulation made of it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.belief_loop import BeliefSettings
from coop_envs.estimation.belief import Belief
from coop_envs.estimation.estimator import Plan
from coop_envs.geometry.arrays import to_numpy
from coop_envs.mapping.ground_map import GroundMap
from coop_envs.recording.log_reader import EpisodeReader

MEASUREMENTS, COMMANDS = "/measurements", "/commands"


def fingerprint(
    belief: Belief, ground: GroundMap, observations: Mapping[str, Mapping[str, NDArray[Any]]]
) -> dict[str, str]:
    """Digest of every array of belief, map and observations."""
    arrays = to_numpy(belief) | {f"map.{name}": array for name, array in to_numpy(ground).items()}
    used = int(ground.change_count.numpy()[0])
    arrays["map.changes"] = arrays["map.changes"][:, :used]
    for agent, parts in observations.items():
        arrays |= {f"{agent}.{key}": array for key, array in parts.items()}
    return {
        name: hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:16] for name, array in arrays.items()
    }


def replayed(log: Path, settings: BeliefSettings, plan: Plan) -> list[dict[str, str]]:
    """Fingerprints after every decision of a log."""
    from hardware_bridge.replay import BeliefReplay

    reader, replay, prints = EpisodeReader(log), BeliefReplay(settings, plan), []
    for (_, measurements), (_, command) in zip(reader.arrays(MEASUREMENTS), reader.arrays(COMMANDS), strict=True):
        observations = replay.step(measurements, command)
        prints.append(fingerprint(replay.loop.belief, replay.loop.map, observations))
    return prints

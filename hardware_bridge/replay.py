"""Replay of a recorded run: its measurements and commands give, bit for bit, the beliefs and observations it had."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.command import allocate_command
from coop_envs.belief_loop import BeliefLoop, BeliefSettings
from coop_envs.estimation.estimator import Plan
from coop_envs.geometry.arrays import assign
from coop_envs.observations import by_agent, observation_arrays
from coop_envs.sensing.measurements import Measurements, allocate_measurements

Arrays = Mapping[str, NDArray[Any]]
Observations = dict[str, dict[str, NDArray[Any]]]


class BeliefReplay:
    """One team's belief, driven by what its robots reported and were told, from a log or a live link.

    Args:
        settings: the team and the settings of its belief.
        plan: where people set the robots down, one team (B = 1).
        device: where to compute; bit-exact on the device of the recording.
    """

    def __init__(self, settings: BeliefSettings, plan: Plan, device: str = "cpu") -> None:
        members, ticks = settings.team.members, settings.rates.ticks_per_decision
        self.measurements: Measurements = allocate_measurements(1, len(members), ticks, device)
        self.command = allocate_command(1, len(members), ticks, device)
        running = wp.ones(1, dtype=int, device=device)
        self.loop = BeliefLoop(settings, self.measurements, self.command, running, device)
        self.loop.reset(np.ones(1, dtype=np.int32), plan)
        self._places = {member.name: i for i, member in enumerate(members)}

    def step(self, measurements: Arrays, command: Arrays) -> Observations:
        """Take in one decision, arrays by the names of `Measurements` and `Command`; every robot's observation.

        Raises:
            ValueError: an array of another shape.
            KeyError: an array is missing.
        """
        assign(self.measurements, measurements)
        assign(self.command, command)
        self.loop.step()
        return by_agent({key: a[0] for key, a in observation_arrays(self.loop.observations).items()}, self._places)

    def run(self, decisions: Iterable[tuple[Arrays, Arrays]]) -> Iterator[Observations]:
        """Observations after each recorded decision, given as (measurements, command)."""
        for measurements, command in decisions:
            yield self.step(measurements, command)

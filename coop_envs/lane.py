"""`Lane`: teams that one thread steps, each playing its own series of episodes; ends and starts stay on the device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.agents.control import HOLD
from coop_envs.batch import Exchange, TeamBatch
from coop_envs.geometry.arrays import allocate, assign, to_numpy
from coop_envs.geometry.keyed_random import episode_key, mix64
from coop_envs.packed_pool import PackedPool
from coop_envs.scenario import Scenario
from coop_envs.scoring import Score
from coop_envs.simulation.reset import Starting

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

Snapshot = dict[str, dict[str, NDArray[Any]]]


@wp.struct
class Series:
    """Each team's seed and the number of its present episode, -1 before the first. (B,)"""

    seed: wp.array[wp.uint64]
    episode: wp.array[wp.int64]


@wp.kernel
def call_up(called: wp.array[int], series: Series, worlds: int, starting: Starting, actions: wp.array3d[float]):
    """Begin the next episode of the called teams: its key, its world, and a first decision at rest."""
    b = wp.tid()
    starting.chosen[b] = called[b]
    if called[b] == 0:
        return
    series.episode[b] = series.episode[b] + wp.int64(1)
    key = episode_key(series.seed[b], wp.uint64(series.episode[b]))
    starting.key[b] = key
    starting.world[b] = int(mix64(key) % wp.uint64(worlds))
    for r in range(actions.shape[1]):
        for k in range(actions.shape[2]):
            actions[b, r, k] = 0.0
        actions[b, r, HOLD] = 1.0


@wp.kernel
def forgive_start(starting: Starting, score: Score):
    """What a first decision at rest costs is nobody's doing: it gives no reward."""
    b = wp.tid()
    if starting.chosen[b] == 1:
        score.reward[b] = 0.0
        for k in range(score.terms.shape[1]):
            score.terms[b, k] = 0.0


class Lane:
    """Some of a vector environment's teams: those in ``rows`` of its exchange, of which it gets its own part."""

    def __init__(self, scenario: Scenario, packed: PackedPool, rows: slice, exchange: Exchange) -> None:
        self.rows, self.exchange, self.teams = rows, exchange, exchange.actions.shape[0]
        self.batch = TeamBatch(scenario, packed, self.teams, exchange)
        device, score = packed.device, exchange.score
        self.series: Series = allocate(Series, (self.teams,), device)
        self._mask = wp.zeros(self.teams, dtype=int, device=device)
        told = [self.series, len(packed.pool.worlds), self.batch.starting, exchange.actions]
        self._call_ended = self._record(call_up, [score.done, *told])
        self._call_masked = self._record(call_up, [self._mask, *told])
        self._forgive_start = self._record(forgive_start, [self.batch.starting, score])
        self._ended = score.done.numpy() if device == "cpu" else None
        score.done.fill_(1)

    def _record(self, kernel: wp.Kernel, inputs: list[object]) -> wp.Launch:
        return wp.launch(kernel, self.teams, inputs=inputs, device=self.batch.device, record_cmd=True)

    def begin_series(self, chosen: NDArray[np.bool_], seeds: NDArray[np.uint64]) -> None:
        """Give the chosen teams (B,) new seeds (B,); their next episode is their first."""
        self.series.seed.assign(np.where(chosen, seeds, self.series.seed.numpy()))
        self.series.episode.assign(np.where(chosen, np.int64(-1), self.series.episode.numpy()))

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Begin the next episode of the teams where ``mask`` (B,) is true; the others wait."""
        if not mask.any():
            return
        self._mask.assign(mask.astype(np.int32))
        self.batch.running.assign(mask.astype(np.int32))
        self._call_masked.launch()
        self.batch.start()
        self.batch.step()
        self._forgive_start.launch()
        self.batch.running.fill_(1)

    def step(self) -> None:
        """One decision of every team; the first of a new episode for those of which nobody was left."""
        self._call_ended.launch()
        if self._ended is None or self._ended.any():
            self.batch.start()
        self.batch.step()
        self._forgive_start.launch()

    def snapshot(self) -> Snapshot:
        """A copy of all that changes, by part and name."""
        return self.batch.snapshot() | {"series": to_numpy(self.series)}

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a `snapshot` of this lane or of one of as many teams of the same scenario and worlds.

        Raises:
            ConfigError: the snapshot is of another batch.
        """
        self.batch.restore(snapshot)
        assign(self.series, snapshot["series"])


def joined(parts: Sequence[Snapshot]) -> Snapshot:
    """The snapshots of several lanes as one."""
    first = parts[0]
    return {
        part: {name: np.concatenate([other[part][name] for other in parts]) for name in arrays}
        for part, arrays in first.items()
    }


def rows_of(snapshot: Mapping[str, Mapping[str, NDArray[Any]]], rows: slice) -> Snapshot:
    """Some teams' part of a snapshot."""
    return {part: {name: array[rows] for name, array in arrays.items()} for part, arrays in snapshot.items()}

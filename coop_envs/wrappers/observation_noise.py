"""Gaussian noise on the entries of observations, and cells of the map told wrongly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from coop_envs.errors import require
from coop_envs.observations import MATE_FIELDS, SELF_FIELDS, Field
from coop_envs.validation import known
from coop_envs.wrappers.disturbance import Arrays, Disturbance, Moment, stream_of
from coop_envs.wrappers.team_wrapper import AnyParallelEnv, DisturbedTeam
from coop_envs.wrappers.vector_wrapper import DisturbedTeams

KIND = 3
GROUND_AND_OBSTACLE = 2  # the layers whose cells may be told wrongly; the third draws robots


@dataclass(frozen=True)
class NoiseSettings:
    """Standard deviations by name of the entries of ``self`` and ``mates``, each in the entry's unit.

    ``map_flip`` is the chance of a cell of ground or obstacle to be told as its contrary, 255 - p for p.
    """

    own: Mapping[str, float] = field(default_factory=dict)
    mates: Mapping[str, float] = field(default_factory=dict)
    map_flip: float = 0.0

    def __post_init__(self) -> None:
        for part, entries, fields in (("own", self.own, SELF_FIELDS), ("mates", self.mates, MATE_FIELDS)):
            for name, sigma in entries.items():
                known(name, [entry.name for entry in fields], f"noise.{part}", "an entry of the observation")
                require(0.0 <= sigma < np.inf, f"noise.{part}.{name}", sigma, "0 or more, in the entry's unit")
        require(0.0 <= self.map_flip <= 1.0, "noise.map_flip", self.map_flip, "0 to 1")


class Noise(Disturbance):
    """Adds noise that is new in every decision, robot and entry; entries without noise keep their bits."""

    def __init__(self, teams: int, settings: NoiseSettings, stream: int = 0) -> None:
        super().__init__(teams)
        self._own, self._mates = _scaled(settings.own, SELF_FIELDS), _scaled(settings.mates, MATE_FIELDS)
        self._flip = settings.map_flip
        self._streams = [stream_of(KIND, stream, part) for part in range(3)]

    def observations(self, observations: Arrays) -> Arrays:
        seen = dict(observations)
        present = np.asarray(
            observations["self"][..., :2].any(axis=-1)
        )  # everyone has a role; rows that only fill up have none
        if self._own[0].size:
            seen["self"] = _noisy(observations["self"], present, *self._own, self.moment, self._streams[0])
        if self._mates[0].size:
            mates = np.asarray(observations["mask"] > 0)
            seen["mates"] = _noisy(observations["mates"], mates, *self._mates, self.moment, self._streams[1])
        if self._flip > 0.0:
            seen["map"] = self._flipped(observations["map"], present)
        return seen

    def _flipped(self, window: NDArray[np.uint8], present: NDArray[np.bool_]) -> NDArray[np.uint8]:
        layers = window[:, :, :GROUND_AND_OBSTACLE]
        wrong = self.moment.uniform(self._streams[2], layers.shape[1:]) < self._flip
        flipped = window.copy()
        flipped[:, :, :GROUND_AND_OBSTACLE] = np.where(wrong & present[:, :, None, None, None], 255 - layers, layers)
        return flipped


def _scaled(sigmas: Mapping[str, float], fields: tuple[Field, ...]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Places of the noisy entries, and their standard deviations on the observation's scale."""
    scaled = np.array([sigmas.get(entry.name, 0.0) / entry.scale for entry in fields])
    places = np.flatnonzero(scaled)
    return places, scaled[places]


def _noisy(
    rows: NDArray[np.float32],
    real: NDArray[np.bool_],
    places: NDArray[np.intp],
    sigmas: NDArray[np.float64],
    moment: Moment,
    stream: int,
) -> NDArray[np.float32]:
    """Rows (B, ..., K) with noise at some places of those that are ``real`` (B, ...)."""
    noise = sigmas * moment.normal(stream, (*rows.shape[1:-1], len(places)))
    noisy = rows.copy()
    noisy[..., places] += np.where(real[..., None], noise, 0.0).astype(np.float32)
    return noisy


class ObservationNoise(DisturbedTeam):
    """One team with noisy observations; see `NoiseSettings`."""

    def __init__(self, env: AnyParallelEnv, settings: NoiseSettings, stream: int = 0) -> None:
        super().__init__(env, Noise(1, settings, stream))


class VectorObservationNoise(DisturbedTeams):
    """Teams with noisy observations; see `NoiseSettings`."""

    def __init__(self, env: VectorEnv[Any, Any, Any], settings: NoiseSettings, stream: int = 0) -> None:
        super().__init__(env, Noise(env.num_envs, settings, stream))

"""The filters that are compared, each at work on a stream: the thesis's and ours, by cameras, wheels and pickets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from coop_envs.estimation.settings import Estimation
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.geometry.arrays import field_types
from coop_envs.sensing.measurements import Measurements
from experiments.inchworm_driver import OBSERVER
from experiments.inchworm_streams import Streams
from experiments.thesis_filter import ThesisFilter, ThesisSettings

Array = NDArray[np.float64]


class Contender(Protocol):
    """A filter at work on a stream."""

    def step(self) -> None:
        """Take in the stream's tick."""
        ...

    def pose(self) -> tuple[Array, Array]:
        """Positions (B, N, 3) and rotations (B, N, 3, 3) in the team frames."""
        ...


Entry = Callable[[Streams], Contender]


class _Thesis:
    def __init__(self, streams: Streams, settings: ThesisSettings, listen: NDArray[np.bool_] | None) -> None:
        self.streams, self.listen = streams, listen
        self.filter = ThesisFilter(streams.scenario.team, streams.starts, settings)

    def step(self) -> None:
        streams = self.streams
        told = np.abs(streams.command.wheels.numpy()).max(axis=-1) > 0
        moving = told & (streams.running.numpy()[:, None] > 0)
        self.filter.step(streams.measurements, moving, streams.tick_s, self.listen)

    def pose(self) -> tuple[Array, Array]:
        return self.filter.position, self.filter.rotation


class _Ours:
    """Our filter; pickets that ``listen`` leaves out are as if no camera saw them."""

    def __init__(self, streams: Streams, settings: Estimation, listen: NDArray[np.bool_] | None) -> None:
        self.streams, self.listen = streams, listen
        self.measured = streams.measurements if listen is None else _with_own_sight(streams.measurements)
        team, command = streams.scenario.team, streams.command
        self.filter = TeamFilter(team, settings, self.measured, command, running=streams.running)
        self.filter.reset(streams.starts)

    def step(self) -> None:
        if self.listen is not None:
            self.measured.seen.assign(self.streams.measurements.seen.numpy() * self.listen)
        self.filter.step(self.streams.tick_s)

    def pose(self) -> tuple[Array, Array]:
        belief = self.filter.belief
        return belief.position.numpy(), belief.rotation.numpy()


def _with_own_sight(measured: Measurements) -> Measurements:
    """The same arrays but for ``seen``."""
    made: Any = Measurements()
    for name in field_types(Measurements):
        setattr(made, name, getattr(measured, name))
    made.seen = wp.clone(measured.seen)
    return made


def thesis(pickets: int | None = None, motion_model: bool = True) -> Entry:
    """The thesis's filter, with its first so many pickets, or on the camera alone."""
    settings = ThesisSettings(motion_model=motion_model)
    return lambda streams: _Thesis(streams, settings, _first(streams, pickets))


def ours(wheels: bool, pickets: int | None = None) -> Entry:
    """Our filter with or without wheels, with its first so many pickets; none: dead reckoning."""

    def build(streams: Streams) -> Contender:
        camera = streams.scenario.team.members[OBSERVER].camera
        shake_rad = camera.shake_rad if camera else 0.0
        settings = replace(streams.scenario.estimation, wheels=wheels, camera_shake_rad=shake_rad)
        return _Ours(streams, settings, _first(streams, pickets))

    return build


def _first(streams: Streams, pickets: int | None) -> NDArray[np.bool_] | None:
    members = len(streams.scenario.team.members)
    return None if pickets is None else np.arange(members) <= pickets


CAMERA, ONE, TWO = "camera only, two pickets", "thesis's filter, one picket", "thesis's filter, two pickets"
OURS, WHEELS, OURS_ONE, BLIND_ = "ours, IMU", "ours, IMU and wheels", "ours, IMU, one picket", "IMU and wheels alone"
ENTRIES: dict[str, Entry] = {
    CAMERA: thesis(motion_model=False),
    ONE: thesis(1),
    TWO: thesis(),
    OURS_ONE: ours(wheels=False, pickets=1),
    OURS: ours(wheels=False),
    WHEELS: ours(wheels=True),
    BLIND_: ours(wheels=True, pickets=0),
}

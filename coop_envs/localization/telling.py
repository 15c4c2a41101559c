"""What the team filter is told of a window: views of its measurements and of what its robots are taken to be told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.command import Command
from coop_envs.localization.hearing import Heard
from coop_envs.localization.logs.events import PoseSighting
from coop_envs.sensing.measurements import Measurements

DRIVES_RAD_S = 1.0
"""What the filter is told that the wheels of a robot were told that moves; any speed above 0 says the same."""
STANDS_RAD_S = 0.02
"""Slower wheels stand."""


class Told:
    """Measurements and commands of one team of N robots; ``listens_to_wheels`` (N,) says whose wheels tell anything."""

    def __init__(self, measurements: Measurements, command: Command, listens_to_wheels: NDArray[np.int32]) -> None:
        names = ("gyro", "accel", "wheels", "heard", "seen", "p_camera_body", "R_camera_body", "covariance")
        self._arrays: dict[str, NDArray[Any]] = {name: getattr(measurements, name).numpy()[0] for name in names}
        self._commanded = command.wheels.numpy()[0]
        self._listens_to_wheels = listens_to_wheels
        measurements.battery.fill_(1.0)

    def motion(self, robot: int, present: bool, heard: Heard, listens_to_wheels: bool) -> None:
        """Tell of a robot's IMU and wheels; one that does not stand by its own sensors is taken to be driven."""
        told, wheels = self._arrays, heard.wheels
        told["gyro"][robot], told["accel"][robot] = heard.means.gyro, heard.means.accel
        told["heard"][robot] = int(present and heard.means.heard)
        self._commanded[robot] = 0.0 if heard.still else DRIVES_RAD_S
        speeds = np.zeros(2) if wheels is None else np.array([wheels.left_rad_s, wheels.right_rad_s])
        told["wheels"][robot] = 0.0 if np.abs(speeds).max() < STANDS_RAD_S else speeds
        self._listens_to_wheels[robot] = int(wheels is not None and listens_to_wheels)

    def nothing_heard(self, robot: int) -> None:
        """Take back what was told of a robot's motion."""
        self._arrays["heard"][robot] = 0

    def sightings(self, sightings: Sequence[tuple[int, int, PoseSighting]]) -> None:
        """Tell what camera i saw of robot j, and that nothing else was seen."""
        told = self._arrays
        told["seen"][:] = 0
        for i, j, sighting in sightings:
            told["seen"][i, j] = 1
            told["p_camera_body"][i, j], told["R_camera_body"][i, j] = sighting.position, sighting.rotation
            told["covariance"][i, j] = sighting.covariance

"""Settings of localizing a log."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from coop_envs.errors import require
from coop_envs.estimation.settings import Estimation
from coop_envs.validation import STRICT

Clocks = Literal["auto", "stamps", "arrivals", "turns"]
"""Whose word on times is taken.

``stamps``: all clocks agree. ``arrivals``: each robot's clock runs as it likes; times of arrival align it. ``turns``:
clocks are constantly apart; turns that gyros feel and cameras see tell by how much. ``auto``: arrivals if there are,
and they do not show that the clocks agree; else turns where they tell of an offset.
"""


@dataclass(frozen=True)
class Localization:
    """How a log is localized.

    Windows of the filter end at camera frames and are at most ``longest_s`` long. Events that are older than
    ``horizon_s`` when they come are dropped; the filter waits ``patience_s`` for late ones. Missing IMU samples are
    bridged over ``bridge_s``. A robot whose pose is less certain than ``lost_m`` or ``lost_rad`` leaves the filter, and
    joins again where it is next seen. ``estimation`` sets the filter.
    """

    __pydantic_config__ = STRICT
    longest_s: float = 0.1
    horizon_s: float = 2.0
    patience_s: float = 0.1
    bridge_s: float = 0.2
    lost_m: float = 1.0
    lost_rad: float = 0.6
    clocks: Clocks = "auto"
    estimation: Estimation = field(default_factory=Estimation)

    def __post_init__(self) -> None:
        for name in ("longest_s", "horizon_s", "bridge_s", "lost_m", "lost_rad"):
            require(getattr(self, name) > 0, name, getattr(self, name), "more than 0")
        require(self.longest_s <= 1.0, "longest_s", self.longest_s, "at most 1 s")
        require(self.patience_s >= 0, "patience_s", self.patience_s, "0 s or more")
        require(self.bridge_s <= self.horizon_s, "bridge_s", self.bridge_s, "at most horizon_s")

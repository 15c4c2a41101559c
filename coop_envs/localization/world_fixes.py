"""Fixes from outside: the first that suffice place the team in the world, later ones correct single robots."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coop_envs.estimation.fixes import FixFuser
from coop_envs.estimation.team_filter import TeamFilter
from coop_envs.localization.logs.events import Fix
from coop_envs.localization.placing import BodyFix, Unplaced, place
from coop_envs.localization.result import Happening, Kind

LEVEL_RAD = 0.01
"""How well z of the world points up: the filter takes gravity to act along it."""


@dataclass(frozen=True)
class Anchor:
    """Whether the belief is held in the world, and the fixes that do not suffice for that yet."""

    placed: bool = False
    waiting: tuple[Fix, ...] = ()


class FixTaker:
    """Takes fixes into the belief of one team; robots by their names in the log."""

    def __init__(self, team_filter: TeamFilter, index: Mapping[str, int]) -> None:
        self._filter, self._index = team_filter, index
        self._fuser = FixFuser(team_filter.belief, team_filter.rows)

    def take(
        self, anchor: Anchor, fixes: Sequence[Fix], resting: NDArray[np.int32], now_s: float
    ) -> tuple[Anchor, list[Happening]]:
        """Fuse fixes that hold now; those of robots that have rested since still do. ``resting`` (N,)."""
        if not anchor.placed:
            valid = [fix for fix in anchor.waiting if resting[self._index[fix.robot]]]
            return self._place(dataclasses.replace(anchor, waiting=tuple(_newest([*valid, *fixes]))), fixes, now_s)
        refused = [fix for fix in fixes if not self._fuse(fix)]
        return anchor, [Happening(now_s, Kind.OUTLIER, fix.robot, "its fix") for fix in refused]

    def _place(self, anchor: Anchor, fresh: Sequence[Fix], now_s: float) -> tuple[Anchor, list[Happening]]:
        if not fresh:
            return anchor, []
        bodies = [BodyFix(self._index[f.robot], f.position, f.rotation, f.covariance) for f in anchor.waiting]
        if isinstance(place(self._filter, bodies, LEVEL_RAD), Unplaced):
            return anchor, []
        by = sorted({fix.robot for fix in anchor.waiting})
        return Anchor(placed=True), [Happening(now_s, Kind.PLACED, by[0], f"by fixes of {', '.join(by)}")]

    def _fuse(self, fix: Fix) -> bool:
        return self._fuser.fuse(self._index[fix.robot], fix.position, fix.rotation, fix.covariance)


def _newest(fixes: Sequence[Fix]) -> list[Fix]:
    """The last fix of each robot."""
    return list({fix.robot: fix for fix in fixes}.values())

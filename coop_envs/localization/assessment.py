"""How far a result is from the truth, where a log knows it: drift at the end, NEES on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from coop_envs.localization.logs.events import Trajectory
from coop_envs.localization.result import Result
from coop_envs.localization.trajectories import covered, drift, in_team_frame, nees

STEP_M = 0.01
"""True paths are measured in steps of so much, for the noise of what measured them is no way."""
SETTLED_S = 1.0
"""NEES counts from so long after a robot joined: tilts are vague before, and the first robot's heading exact."""


@dataclass(frozen=True)
class Assessment:
    """One robot's drift at the end and its NEES over its path, divided by the degrees of freedom: 1 is right."""

    position_drift_m: float
    heading_drift_deg: float
    path_m: float
    drift_percent_of_path: float
    nees_mean: float
    nees_median: float
    nees_worst: float


def true_paths(result: Result, truth: Mapping[str, Trajectory], first: str) -> dict[str, Trajectory]:
    """The truth in the result's frame; nothing where it does not say where the team's frame is.

    ``first`` is the robot whose start is that frame.
    """
    if result.frame == "world" or not truth:
        return dict(truth)
    if first not in truth or first not in result.paths:
        return {}
    at = float(result.paths[first].time_s[0])
    if not covered(truth[first], np.array([at]))[0]:
        at = float(truth[first].time_s[0])
    return in_team_frame(truth, first, at)


def assess(result: Result, truth: Mapping[str, Trajectory]) -> dict[str, Assessment]:
    """Each robot whose true path, in the result's frame, is known for some of the time."""
    out: dict[str, Assessment] = {}
    for name, path in result.paths.items():
        if name not in truth or not covered(truth[name], path.time_s).any():
            continue
        end = drift(path, truth[name], STEP_M)
        degrees = 3 if result.planar else 6
        known = covered(truth[name], path.time_s)
        settled = known & (path.time_s >= path.time_s[0] + SETTLED_S)
        counted = settled if settled.any() else known
        values = nees(path, path.covariance, truth[name], result.planar)[counted] / degrees
        out[name] = Assessment(
            end.position_m,
            float(np.degrees(end.heading_rad)),
            end.path_m,
            end.percent_of_path,
            float(values.mean()),
            float(np.median(values)),
            float(values.max()),
        )
    return out

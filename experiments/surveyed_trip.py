"""The authors' trip in the environment: scan, robot 0 drives, scan, robot 1 drives, scan; real points, real energy.

Robots, cameras, laser and controller are the environment's, at fidelity ``features``; poses and speeds the authors'.
The scene is thesis fig. 6.6's corner, drawn out so that the whole trip fits in: a floor, walls ahead and on the right.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from baselines.inchworm_poses import scan_sequence
from coop_envs.errors import require
from coop_envs.scenario import Scenario, load_scenario
from experiments.shots import FloatArray, Shots
from experiments.survey import Survey, Sweep

AUTHORS_LASER = {"raster_half_rad": (0.23, 0.40), "step_counts": 5}


@dataclass(frozen=True)
class SurveyedTrip:
    """The trip's settings.

    ``sweep`` is robot 0's raster, robot 1's is its mirror image. ``laser`` replaces entries of the robots' lasers.
    """

    sweep: Sweep = field(default_factory=Sweep)
    laser: tuple[tuple[str, object], ...] = ()
    scans: int = 3
    speed_m_s: float = 0.1
    yaw_rate_rad_s: float = 0.5
    wall_ahead_m: float = 4.0
    left_m: float = 4.0
    levels: int = 12
    seed: int = 0
    teams: int = 1

    def __post_init__(self) -> None:
        require(1 <= self.scans <= 3, "trip.scans", self.scans, "1 to 3: the third stands before the wall")


FULL_RASTER = SurveyedTrip()
AUTHORS_RASTER = SurveyedTrip(Sweep(1.0, 0.175, 0.0), tuple(AUTHORS_LASER.items()))
"""187 points, 0.05 rad apart, over the authors' angles and one column more, for ours lie evenly about their centre."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """One phase of the first team's trip: its decisions' ends, both robots together.

    time_s, bits
        (n + 1,) from the phase's start to its end.
    energy_j
        (n + 1, 4) of idling, motion, markers, scanner.
    shots
        per decision, n.
    """

    name: str
    time_s: FloatArray
    energy_j: FloatArray
    bits: FloatArray
    shots: tuple[Shots, ...]

    @property
    def duration_s(self) -> float:
        return float(self.time_s[-1] - self.time_s[0])


def trip_scenario(trip: SurveyedTrip) -> Scenario:
    """The long corner with two surveyors."""
    lasers = {f"team.members.{name}.laser": dict(trip.laser) for name in ("observer_0", "picket_0")}
    geometry = {"wall_ahead_m": trip.wall_ahead_m, "left_m": trip.left_m}
    changes = {"environment": {"geometry": geometry}, "map": {"levels": trip.levels}, **lasers}
    return load_scenario("corner", fidelity="features", **changes)


def follow(trip: SurveyedTrip) -> Survey:
    """Make the trip; the robot that drives is seen by the other, which stands."""
    survey = Survey(trip_scenario(trip), trip.seed, trip.teams)
    survey.flash("poses")
    for k, scan in enumerate(scan_sequence(trip.scans)):
        if k:
            name, mover = f"move t{3 * k - 2}-{3 * k - 1}", (k + 1) % 2
            for robot in (mover, 1 - mover):
                survey.drive(name, robot, scan.robots[robot], trip.speed_m_s, trip.yaw_rate_rad_s)
            survey.flash(name)
        survey.scan(f"scan {scan.label}", k % 2, trip.sweep if k % 2 == 0 else trip.sweep.mirrored())
    return survey


def stretches(survey: Survey) -> tuple[Stretch, ...]:
    """The first team's phases, in order, from the first scan on."""
    log = survey.log
    time_s = np.array([decision.time_s for decision in log])
    energy = np.array([decision.energy_j[0].sum(axis=0) for decision in log])
    bits = np.array([decision.bits[0] for decision in log])
    found = []
    for name in dict.fromkeys(decision.phase for decision in log):
        mine = [k for k, decision in enumerate(log) if decision.phase == name]
        if mine[0] == 0:
            continue
        span = slice(mine[0] - 1, mine[-1] + 1)
        shots = tuple(log[k].shots.chosen(log[k].shots.team == 0) for k in mine)
        found.append(Stretch(name, time_s[span], energy[span], bits[span], shots))
    return tuple(found)

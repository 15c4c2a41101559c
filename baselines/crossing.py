"""The observer's drive along a safe path while all others hold still as landmarks.

It drives slowly, slower where its own position is uncertain and a landmark in view can mend that (without one, time
only adds to the doubt); beyond ``LOOK_SIGMA_M`` it stops and turns to a standing landmark until its belief is sharp
again; beyond ``STOP_SIGMA_M`` it waits for help, for a while, and beyond ``LOST_SIGMA_M`` it does not drive at all.

Source: thesis 2.2.5 (navigation with the observer); chapter 5 (the inchworm rule).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from baselines.atlas import Atlas, Point, Survey
from baselines.driving import STILL, Drive, PathFollower, StallWatch, drive_to, turn_to
from baselines.prospect import Prospect, find_prospect
from baselines.team_view import Landmark, RobotView, TeamView
from coop_envs.mapping.planning import Clearance, Disc, Footprint, SafeRoutes
from coop_envs.policy import TeamDescription

SPEED_M_S, TURN_RAD_S = 0.10, 1.0
LOOKAHEAD_M = 0.03
CALM_SIGMA_M, LOOK_SIGMA_M, STOP_SIGMA_M, LOST_SIGMA_M = 0.004, 0.009, 0.015, 0.025
LOOK_AGAIN_M = 0.08  # way driven between two looks back
LOOK_S, WAIT_S, UNSURE_S = 2.0, 3.0, 6.0
STRAYED_M = 0.03  # off the path by more, the observer stops and plans anew
CHECK_EVERY = 5  # decisions between two looks at whether the way ahead still is safe
NEAR_SAMPLES, TOLERANCE_M = 5, 0.005  # of the way ahead: what is under the robot already, and rounding of cells
GOAL_NEAR_M, GOAL_AIM_M = 0.06, 0.04  # how near to the goal's centre will do, and is hoped for
MARGIN_M = 0.3  # of unknown ground around what is known in which ways are looked for
GAP_M = 0.02  # between two bodies


class ObserverPlanner:
    """Safe routes of the observer over the atlas.

    The ground in the ring round the start, which the observer's own body keeps pickets from, is trusted: the operator
    set the team down there. Lost robots, and standing ones if asked, are kept clear of.
    """

    def __init__(self, team: TeamDescription) -> None:
        leader = team.members[0].robot
        mates_radius_m = max((member.robot.body_radius_m for member in team.members[1:]), default=0.0)
        self._cautious = self.footprint = Footprint(leader.contact_radius_m, leader.body_radius_m)
        self.apart_m = leader.body_radius_m + mates_radius_m + GAP_M
        self.goal_near_m = max(GOAL_NEAR_M, 0.71 * team.cell_m)
        self._collects_lost = team.collects_lost
        self._set_down: Disc = (0.0, 0.0, self.apart_m)

    def dare(self, daring: bool) -> None:
        """Pass hazards as near as any unproven ground from now on, or keep well away from them."""
        margin_m = self._cautious.margin_m if daring else self._cautious.hazard_margin_m
        self.footprint = replace(self._cautious, hazard_margin_m=margin_m)

    def routes(self, view: TeamView, atlas: Atlas, among_scouts: bool) -> SafeRoutes:
        """All routes from where the observer stands; ``among_scouts`` keeps clear of live scouts, too."""
        survey = self._trusting(view, atlas)
        scouts = [scout.xy for scout in view.scouts] if among_scouts else []
        return SafeRoutes(survey.grid, view.leader.xy, self.footprint, self._bodies(survey, scouts))

    def clearance(self, view: TeamView, atlas: Atlas) -> Clearance:
        """Clearance of the observer as things are now, a little more lenient with other robots than routes are."""
        survey = self._trusting(view, atlas)
        bodies = self._bodies(survey, [scout.xy for scout in view.scouts])
        return Clearance(survey.grid, self.footprint, tuple((x, y, radius - GAP_M) for x, y, radius in bodies))

    def prospect(self, view: TeamView, atlas: Atlas) -> Prospect | None:
        """What the way to the goal still needs; None without a goal, or if nothing is left to hope for."""
        if view.goal is None:
            return None
        survey = self._trusting(view, atlas)
        goal = (*view.goal, GOAL_AIM_M)
        return find_prospect(survey, view.leader.xy, goal, self.footprint, self._bodies(survey, []))

    def _trusting(self, view: TeamView, atlas: Atlas) -> Survey:
        """What is known, and the observer and its goal, with room around; the ground at the start is trusted."""
        ends = [view.leader.xy] if view.goal is None else [view.leader.xy, view.goal]
        survey = atlas.survey_around(np.vstack([atlas.grid.known(), ends]), MARGIN_M)
        return replace(survey, grid=survey.grid.trusting(self._set_down))

    def _bodies(self, survey: Survey, scouts: list[Point]) -> tuple[Disc, ...]:
        lost = [] if self._collects_lost else survey.losses
        return tuple((x, y, self.apart_m) for x, y in (*lost, *scouts))


class Crossing:
    """One drive of the observer along a path; ``arrived`` and ``blocked`` say how it ended."""

    def __init__(self, path_m: NDArray[np.float64], planner: ObserverPlanner, team: TeamDescription) -> None:
        self.arrived = self.blocked = False
        self._planner, self._decision_s = planner, team.decision_s
        self._speed_m_s = min(SPEED_M_S, team.members[0].cruise_speed_m_s)
        self._turn_rad_s = min(TURN_RAD_S, team.members[0].cruise_yaw_rate_rad_s)
        self._follower = PathFollower(path_m, LOOKAHEAD_M)
        self._stall = StallWatch(self._speed_m_s, self._turn_rad_s, team.decision_s)
        self._look = LookBack(team, self._turn_rad_s)
        self._decisions = self._unsure = 0
        self._started = False

    def drive(self, view: TeamView, atlas: Atlas) -> Drive:
        """The observer's drive for this decision."""
        self._decisions += 1
        self._started = self._started or self._others_stand(view)
        if not self._started:
            return STILL
        drive = self._look.drive(view) or self._follow(view, atlas)
        self._stall.note(view.leader, drive)
        return drive

    def _others_stand(self, view: TeamView) -> bool:
        return all(scout.stationary for scout in view.scouts) or self._decisions * self._decision_s > WAIT_S

    def _follow(self, view: TeamView, atlas: Atlas) -> Drive:
        leader = view.leader
        target = self._follower.target(leader.xy)
        self.arrived = len(self._follower.remaining) <= 2
        self.blocked = not self.arrived and (self._stall.stalled(leader) or not self._still_safe(view, atlas))
        if self.arrived or self.blocked or not self._dares(leader):
            return STILL
        doubt = (leader.sigma_m - CALM_SIGMA_M) / (STOP_SIGMA_M - CALM_SIGMA_M)
        pace = min(1.0, max(0.3, 1.0 - doubt)) if any(mark.in_view for mark in view.landmarks) else 1.0
        return drive_to(leader, target, self._speed_m_s * pace, self._turn_rad_s)

    def _dares(self, leader: RobotView) -> bool:
        """Whether the robot is sure enough of where it is, or has waited in vain to become so and is not quite lost."""
        self._unsure = 0 if leader.sigma_m <= STOP_SIGMA_M else self._unsure + 1
        waited = self._unsure * self._decision_s > UNSURE_S
        return self._unsure == 0 or (waited and leader.sigma_m < LOST_SIGMA_M)

    def _still_safe(self, view: TeamView, atlas: Atlas) -> bool:
        """Whether the robot is on its way and, looked at every few decisions, the way ahead still is safe."""
        ahead = self._follower.remaining
        if view.leader.distance_to((float(ahead[0, 0]), float(ahead[0, 1]))) > STRAYED_M:
            return False
        if self._decisions % CHECK_EVERY:
            return True
        clearance = self._planner.clearance(view, atlas)
        return len(ahead) <= NEAR_SAMPLES or float(clearance(ahead[NEAR_SAMPLES:]).min()) > -TOLERANCE_M


class LookBack:
    """Turning aside to a standing landmark when the observer has grown unsure of where it is."""

    def __init__(self, team: TeamDescription, turn_rad_s: float) -> None:
        self._patience = round(LOOK_S / team.decision_s)
        self._collects_lost = team.collects_lost
        self._turn_rad_s = turn_rad_s
        self._left = self._looks = 0
        self._last: tuple[float, float] | None = None

    def drive(self, view: TeamView) -> Drive | None:
        """The drive that looks, or None when there is no need or nothing to look at."""
        marks = sorted((mark for mark in view.landmarks if self._helps(mark)), key=_distance_from(view))
        if not self._left and self._needed(view, marks):
            self._left, self._last = self._patience, view.leader.xy
            self._looks += 1
        if not self._left or not marks or view.leader.sigma_m < CALM_SIGMA_M:
            self._left = 0
            return None
        bearing = view.leader.bearing_to(marks[(self._looks - 1) % len(marks)].xy)
        seen = any(mark.in_view for mark in marks)
        if seen or abs(bearing) < 0.1:
            self._left -= 1
            return STILL
        return turn_to(bearing, self._turn_rad_s)

    def _helps(self, mark: Landmark) -> bool:
        gone = mark.docked or (mark.lost and self._collects_lost)
        return mark.stationary and not gone and mark.sigma_m < LOOK_SIGMA_M

    def _needed(self, view: TeamView, marks: list[Landmark]) -> bool:
        if view.leader.sigma_m < LOOK_SIGMA_M or any(mark.in_view for mark in marks):
            return False
        just_looked = self._last is not None and view.leader.distance_to(self._last) < LOOK_AGAIN_M
        return view.leader.sigma_m > STOP_SIGMA_M or not just_looked


def _distance_from(view: TeamView) -> Callable[[Landmark], float]:
    return lambda mark: view.leader.distance_to(mark.xy)

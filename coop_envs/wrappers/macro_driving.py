"""One robot's macro-action, from the observation of each decision to the next plain action, until it ends."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from coop_envs.actions import hold_action
from coop_envs.agents.specification import Role
from coop_envs.agents.team import Member
from coop_envs.errors import require
from coop_envs.mapping.planning import BeliefGrid, Disc, Footprint, safe_path
from coop_envs.observations import mate_field, self_field
from coop_envs.policy import TeamDescription

Observation = dict[str, NDArray[Any]]
Action = NDArray[np.float32]
Outcome = Literal["running", "done", "blocked", "late"]

GO, SCAN, WAIT = 0, 1, 2
ARRIVED_M = 0.03
TURN_FIRST_RAD = 0.5
TURN_GAIN_1_S = 2.0
MOVED_M, MOVED_RAD = 0.02, 0.2
GAP_M = 0.02


@dataclass(frozen=True)
class MacroSettings:
    """Time limits of macro-actions, how wide scans are, and which roles may go over ground that is not proven.

    A robot that is told to go and neither moves nor turns for ``blocked_s`` ends blocked; keep that above the time
    after which the belief declares it stuck, or no robot is ever given up.
    """

    go_limit_s: float = 20.0
    scan_limit_s: float = 120.0
    wait_s: float = 1.0
    blocked_s: float = 7.0
    scan_share: float = 1.0
    brightness: float = 1.0
    venturing: tuple[Role, ...] = ("picket",)

    def __post_init__(self) -> None:
        for name in ("go_limit_s", "scan_limit_s", "wait_s", "blocked_s"):
            require(getattr(self, name) > 0, f"macro.{name}", getattr(self, name), "more than 0 s")
        require(0 < self.scan_share <= 1, "macro.scan_share", self.scan_share, "above 0, at most 1")
        require(-1 <= self.brightness <= 1, "macro.brightness", self.brightness, "-1 to 1")


class MacroDriver:
    """Carries out macro-actions of one robot: `start` one, then `act` until `outcome` is not running.

    ``cell`` is a cell (i, j) of the robot's own map window: where to go, or where to aim the middle of a scan. A robot
    in the dock waits until it is called.
    """

    def __init__(self, team: TeamDescription, place: int, settings: MacroSettings) -> None:
        self.member: Member = team.members[place]
        self._cell_m, self._decision_s, self._settings = team.cell_m, team.decision_s, settings
        self._body_m = max(member.robot.body_radius_m for member in team.members)
        self._kind, self._docked, self._elapsed_s = WAIT, False, 0.0
        self._path: list[tuple[float, float]] = []
        self._azimuth, self._still_s, self._from = 0.0, 0.0, (0.0, 0.0, 0.0)

    def start(self, kind: int, cell: tuple[int, int], seen: Observation) -> None:
        """Begin a macro-action from the present observation."""
        self._kind, self._elapsed_s, self._still_s = kind, 0.0, 0.0
        self._docked = self_field(seen, "docked") > 0.5
        self._from = _pose(seen)
        x = self_field(seen, "map_x") + (cell[0] + 0.5) * self._cell_m
        y = self_field(seen, "map_y") + (cell[1] + 0.5) * self._cell_m
        self._azimuth = _bearing(self._from, (x, y))
        self._path = self._way(seen, (x, y)) if kind == GO and not self._docked else []

    def act(self, seen: Observation) -> Action:
        """The plain action (8,) of the next decision."""
        action = hold_action(self._settings.brightness)
        if self._kind == GO and self._path and not self._docked:
            self._drive(action, _pose(seen))
        elif self._kind == SCAN and self.member.laser is not None and not self._docked:
            reach_rad = self.member.laser.max_deflection_rad
            action[4:7] = self._settings.scan_share, np.clip(self._azimuth / reach_rad, -1.0, 1.0), 0.0
        return action

    def outcome(self, seen: Observation) -> Outcome:
        """How the macro-action stands after a decision that was made with `act`."""
        self._elapsed_s += self._decision_s
        if self._docked:
            return "running" if self_field(seen, "docked") > 0.5 else "done"
        if self._kind == GO:
            return self._gone(_pose(seen))
        if self._kind == SCAN:
            return self._scanned(seen)
        return "done" if self._elapsed_s > self._settings.wait_s - 0.5 * self._decision_s else "running"

    def _gone(self, pose: tuple[float, float, float]) -> Outcome:
        if not self._path:
            return "blocked"
        if math.dist(pose[:2], self._path[-1]) < ARRIVED_M:
            return "done"
        moved = math.dist(pose[:2], self._from[:2]) > MOVED_M or abs(_wrapped(pose[2] - self._from[2])) > MOVED_RAD
        self._still_s = 0.0 if moved else self._still_s + self._decision_s
        self._from = pose if moved else self._from
        if self._still_s > self._settings.blocked_s:
            return "blocked"
        return "late" if self._elapsed_s > self._settings.go_limit_s else "running"

    def _scanned(self, seen: Observation) -> Outcome:
        if self.member.laser is None:
            return "blocked"
        if self_field(seen, "scan_progress") >= 1.0:
            return "done"
        return "late" if self._elapsed_s > self._settings.scan_limit_s else "running"

    def _way(self, seen: Observation, goal: tuple[float, float]) -> list[tuple[float, float]]:
        """Waypoints of a safe path, or none."""
        x, y, _ = self._from
        origin = (self_field(seen, "map_x"), self_field(seen, "map_y"))
        grid = BeliefGrid(seen["map"][0], seen["map"][1], origin, self._cell_m)
        if self.member.role in self._settings.venturing:
            grid = grid.trusting((x, y, math.inf))
        robot = self.member.robot
        footprint = Footprint(robot.contact_radius_m, robot.body_radius_m)
        path = safe_path(grid, (x, y), goal, self._cell_m, footprint, self._mates(seen))
        return [] if path is None else [(float(p[0]), float(p[1])) for p in path[1:]]

    def _mates(self, seen: Observation) -> tuple[Disc, ...]:
        """Discs that the robot's centre keeps out of: mates outside the dock."""
        x, y, yaw = self._from
        c, s = math.cos(yaw), math.sin(yaw)
        radius = self.member.robot.body_radius_m + self._body_m + GAP_M
        rows = zip(mate_field(seen, "x").tolist(), mate_field(seen, "y").tolist(), strict=True)
        there = (seen["mask"] > 0) & (mate_field(seen, "docked") < 0.5)
        return tuple(
            (x + c * ahead - s * left, y + s * ahead + c * left, radius)
            for (ahead, left), here in zip(rows, there.tolist(), strict=True)
            if here
        )

    def _drive(self, action: Action, pose: tuple[float, float, float]) -> None:
        """Turn towards the next waypoint, then drive there, correcting the heading on the way."""
        while len(self._path) > 1 and math.dist(pose[:2], self._path[0]) < ARRIVED_M:
            self._path.pop(0)
        bearing = _bearing(pose, self._path[0])
        action[0] = -1.0
        action[2] = np.clip(TURN_GAIN_1_S * bearing / self.member.cruise_yaw_rate_rad_s, -1.0, 1.0)
        if abs(bearing) < TURN_FIRST_RAD:
            left_m = math.dist(pose[:2], self._path[0])
            brake = left_m / (self.member.cruise_speed_m_s * self._decision_s) if len(self._path) == 1 else 1.0
            action[1] = min(1.0, brake) * math.cos(bearing)


def _pose(seen: Observation) -> tuple[float, float, float]:
    yaw = math.atan2(self_field(seen, "sin_yaw"), self_field(seen, "cos_yaw"))
    return self_field(seen, "x"), self_field(seen, "y"), yaw


def _bearing(pose: tuple[float, float, float], xy: tuple[float, float]) -> float:
    """Angle from the heading to a point, left positive."""
    return _wrapped(math.atan2(xy[1] - pose[1], xy[0] - pose[0]) - pose[2])


def _wrapped(angle: float) -> float:
    return math.remainder(angle, math.tau)

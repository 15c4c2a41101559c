"""A small kinematic stand-in for the environment: unicycles, walls, one trap, a perfect map of what bodies proved."""

from __future__ import annotations

import math

import numpy as np

from coop_envs.agents.catalog import load_team
from coop_envs.observations import MATE_FIELDS, SELF_FIELDS
from coop_envs.policy import Actions, Observations, TeamDescription

DECISION_S, SUBSTEPS, CELL_M, WINDOW = 0.2, 4, 0.05, 16
STUCK_S = 3.0
_SELF_SCALE = np.array([field.scale for field in SELF_FIELDS])
_MATE_SCALE = np.array([field.scale for field in MATE_FIELDS])


def describe(team: str = "scouts", goal_known: bool = True, time_limit_s: float = 600.0) -> TeamDescription:
    members = load_team(team).members
    names = tuple(member.name for member in members)
    return TeamDescription(names, members, CELL_M, DECISION_S, goal_known, time_limit_s, collects_lost=True)


class FakeArena:
    """The arena of chapter 2 in the team frame: the observer starts at the origin, x forward.

    Robots are discs that slide along the fence and each other; whoever's contact disc touches the trap stays there and
    is declared lost after ``STUCK_S`` of commands and taken away. Belief is the truth; only the observer's sigma is
    modelled: it grows with the way driven and falls while a standing mate is in view.
    """

    def __init__(
        self, team: TeamDescription, goal: tuple[float, float] | None = (0.87, 0.0), trap: bool = True
    ) -> None:
        self.team, self.goal = team, goal
        self.trap = (0.55, 0.775, -0.075, 0.075) if trap else None
        n = len(team.names)
        self.pose = np.zeros((n, 3))
        self.docked = np.array([m.reserve for m in team.members])
        started = np.flatnonzero(~self.docked)[1:]
        self.pose[started] = [(0.2, 0.12 * (k - (len(started) - 1) / 2), 0.0) for k in range(len(started))]
        self.pose[self.docked] = (0.19, 0.0, 0.0)
        self.lost, self.trapped = np.zeros(n, bool), np.zeros(n, bool)
        self.tried_s, self.rest_s = np.zeros(n), np.full(n, 1.0)
        self.sigma = np.full(n, 0.003)
        self.time_s = 0.0
        self.ground = np.full((60, 40), 128, np.uint8)
        self.obstacle = np.full((60, 40), 128, np.uint8)
        self.corner = np.array([-1.0, -1.0])
        self.observer_harmed = self.reached = False
        self._prove()

    def step(self, actions: Actions) -> Observations:
        for i, name in enumerate(self.team.names):
            if name in actions and not self.docked[i]:
                self._drive(i, np.asarray(actions[name], float))
        self.time_s += DECISION_S
        self._prove()
        self._declare()
        self._update_sigma()
        if self.goal is not None:
            self.reached = bool(np.hypot(*(self.pose[0, :2] - self.goal)) < 0.08)
        return self.observe()

    def observe(self) -> Observations:
        return {name: self._observe(i) for i, name in enumerate(self.team.names) if not self.lost[i]}

    def _drive(self, i: int, action: np.ndarray) -> None:
        member = self.team.members[i]
        speed, turn = action[1] * member.cruise_speed_m_s, action[2] * member.cruise_yaw_rate_rad_s
        moves = action[0] <= 0 and (abs(speed) > 0.01 or abs(turn) > 0.05)
        self.rest_s[i] = 0.0 if moves else self.rest_s[i] + DECISION_S
        if moves and self.trapped[i]:
            self.tried_s[i] += DECISION_S
        if not moves or self.trapped[i]:
            return
        for _ in range(SUBSTEPS):
            x, y, yaw = self.pose[i]
            dt = DECISION_S / SUBSTEPS
            step = np.array([x + speed * dt * math.cos(yaw), y + speed * dt * math.sin(yaw)])
            self.pose[i, 2] = yaw + turn * dt
            for way in (step, np.array([step[0], y]), np.array([x, step[1]])):
                if self._free(i, way):
                    self.sigma[i] += 0.03 * float(np.hypot(*(way - self.pose[i, :2])))
                    self.pose[i, :2] = way
                    break
            if self._touches_trap(i):
                self.trapped[i] = True
                self.observer_harmed |= i == 0
                return

    def _free(self, i: int, xy: np.ndarray) -> bool:
        x, y = xy
        radius = self.team.members[i].robot.body_radius_m
        if not (-0.2 + radius <= x <= 1.0 - radius and -0.3 + radius <= y <= 0.3 - radius):
            return False
        for j, member in enumerate(self.team.members):
            if j != i and not self.docked[j] and not self.lost[j]:
                now, after = (np.hypot(*(p - self.pose[j, :2])) for p in (self.pose[i, :2], xy))
                if after < radius + member.robot.body_radius_m and after < now:
                    return False
        return True

    def _touches_trap(self, i: int) -> bool:
        if self.trap is None:
            return False
        x0, x1, y0, y1 = self.trap
        x, y, _ = self.pose[i]
        away = math.hypot(max(x0 - x, 0.0, x - x1), max(y0 - y, 0.0, y - y1))
        return away < self.team.members[i].robot.contact_radius_m

    def _disc(self, i: int, radius: float) -> np.ndarray:
        x = self.corner[0] + (np.arange(self.ground.shape[0]) + 0.5) * CELL_M - self.pose[i, 0]
        y = self.corner[1] + (np.arange(self.ground.shape[1]) + 0.5) * CELL_M - self.pose[i, 1]
        return x[:, None] ** 2 + y[None] ** 2 <= radius**2

    def _prove(self) -> None:
        for i, member in enumerate(self.team.members):
            if not (self.docked[i] or self.trapped[i] or self.lost[i]):
                self.ground[self._disc(i, member.robot.contact_radius_m - 0.006)] = 248
                self.obstacle[self._disc(i, member.robot.body_radius_m - 0.006)] = 8

    def _declare(self) -> None:
        for i in np.flatnonzero((self.tried_s >= STUCK_S) & ~self.lost):
            self.lost[i] = True
            self.ground[self._disc(int(i), 0.07)] = 0
            waiting = np.flatnonzero(self.docked & ~self.lost)
            if len(waiting):
                self.docked[waiting[0]] = False

    def _update_sigma(self) -> None:
        standing = [
            j for j in range(1, len(self.pose)) if not self.docked[j] and (self.lost[j] or self.rest_s[j] > 0.3)
        ]
        if any(self.sees(j) for j in standing):
            self.sigma[0] = 0.003 + 0.5 * (self.sigma[0] - 0.003)

    def sees(self, j: int) -> bool:
        dx, dy = self.pose[j, :2] - self.pose[0, :2]
        bearing = (math.atan2(dy, dx) - self.pose[0, 2] + math.pi) % (2 * math.pi) - math.pi
        return not (self.docked[j] or self.lost[j]) and abs(bearing) < 0.43 and math.hypot(dx, dy) > 0.1

    def _observe(self, i: int) -> dict[str, np.ndarray]:
        x, y, yaw = self.pose[i]
        c, s = math.cos(yaw), math.sin(yaw)
        corner = np.floor(self.pose[i, :2] / CELL_M).astype(int) - WINDOW // 2
        goal = np.zeros(2) if self.goal is None else np.array([[c, s], [-s, c]]) @ (np.array(self.goal) - (x, y))
        member = self.team.members[i]
        own = {
            "role_observer": member.role == "observer", "role_picket": member.role == "picket", "x": x, "y": y,
            "cos_yaw": c, "sin_yaw": s, "log_sigma_position": math.log(self.sigma[i]),
            "stationary": self.rest_s[i] > 0.3, "battery": 1.0, "docked": self.docked[i],
            "has_camera": member.camera is not None, "goal_known": self.goal is not None, "goal_x": goal[0],
            "goal_y": goal[1], "time_left": 1.0 - self.time_s / self.team.time_limit_s,
            "reserves_left": int((self.docked & ~self.lost).sum()),
            "map_x": corner[0] * CELL_M, "map_y": corner[1] * CELL_M,
        }  # fmt: skip
        mates, mask = self._mates(i)
        values = np.array([float(own.get(field.name, 0.0)) for field in SELF_FIELDS])
        return {
            "self": (values / _SELF_SCALE).astype(np.float32),
            "mates": mates,
            "mask": mask,
            "map": self._window(corner),
        }

    def _mates(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        x, y, yaw = self.pose[i]
        c, s = math.cos(yaw), math.sin(yaw)
        distance = np.hypot(*(self.pose[:, :2] - (x, y)).T)
        order = [int(j) for j in np.lexsort((distance, self.lost, self.docked)) if j != i][:7]
        mates, mask = np.zeros((7, len(MATE_FIELDS)), np.float32), np.zeros(7, np.int8)
        for row, j in enumerate(order):
            dx, dy = self.pose[j, :2] - (x, y)
            entry = {
                "role_observer": j == 0, "role_picket": j > 0, "x": c * dx + s * dy, "y": c * dy - s * dx,
                "stationary": self.rest_s[j] > 0.3 or self.lost[j], "lost": self.lost[j], "docked": self.docked[j],
                "sees_me": j == 0 and self.sees(i), "i_see": i == 0 and self.sees(j), "distance": distance[j],
            }  # fmt: skip
            mates[row] = np.array([float(entry.get(field.name, 0.0)) for field in MATE_FIELDS]) / _MATE_SCALE
            mask[row] = 1
        return mates, mask

    def _window(self, corner: np.ndarray) -> np.ndarray:
        layers = np.stack([self.ground, self.obstacle, np.zeros_like(self.ground)])
        padded = np.pad(layers, ((0, 0), (WINDOW, WINDOW), (WINDOW, WINDOW)), constant_values=128)
        i, j = corner - np.round(self.corner / CELL_M).astype(int) + WINDOW
        return padded[:, i : i + WINDOW, j : j + WINDOW].copy()

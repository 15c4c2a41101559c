"""What a picket learns when something keeps it from where it wants to go."""

from __future__ import annotations

import math

from baselines.atlas import Atlas, Point
from baselines.team_view import RobotView, TeamView

ROBOT_M = 0.12  # what stops a picket this near to a robot's centre is the robot


def note_bump(scout: RobotView, aim: Point, body_radius_m: float, view: TeamView, atlas: Atlas) -> None:
    """Mark what keeps a picket from its aim in the atlas, unless it is another robot."""
    away = (body_radius_m + 0.5 * atlas.cell_m) / max(scout.distance_to(aim), 1e-3)
    x, y = scout.x + away * (aim[0] - scout.x), scout.y + away * (aim[1] - scout.y)
    lost = [mark for mark in view.landmarks if mark.lost]
    others = [view.leader, *lost, *(other for other in view.scouts if other is not scout)]
    if all(math.hypot(x - other.x, y - other.y) > ROBOT_M for other in others):
        atlas.bump(scout.xy, (x, y))

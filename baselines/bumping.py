"""What a robot learns when something keeps it from where it wants to go."""

from __future__ import annotations

import math
from collections.abc import Sequence

from baselines.atlas import Atlas, Point
from baselines.team_view import Landmark, RobotView

ROBOT_M = 0.12  # what stops a picket this near to a robot's centre is the robot


def note_bump(
    scout: RobotView, aim: Point, body_radius_m: float, others: Sequence[RobotView | Landmark], atlas: Atlas
) -> None:
    """Mark what keeps a robot from its aim in the atlas, unless it is another robot."""
    away = (body_radius_m + 0.5 * atlas.cell_m) / max(scout.distance_to(aim), 1e-3)
    x, y = scout.x + away * (aim[0] - scout.x), scout.y + away * (aim[1] - scout.y)
    if all(other is scout or math.hypot(x - other.x, y - other.y) > ROBOT_M for other in others):
        atlas.bump(scout.xy, (x, y))

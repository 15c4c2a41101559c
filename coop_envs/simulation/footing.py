"""How a disc stands on uneven ground: plane, walls, edges.

The disc rests on the plane through the ground under its rim and centre. A rise to the rim above the robot's step limit
and steeper than it can stand on, or missing ground, is a wall. A robot falls where its centre has passed an edge deeper
than its drop limit; cracks that its rim spans on both sides it bridges. Posts thinner than the gaps between the rim
points (half the radius) may pass between them.
"""

from __future__ import annotations

import warp as wp

from coop_envs.geometry.terrain import Terrain, ground_height, is_level
from coop_envs.simulation.parameters import RobotModel

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

RIM_POINTS = wp.constant(12)
RIM_COS, RIM_SIN = wp.constant(0.8660254037844387), wp.constant(0.5)  # of 30 degrees
ABYSS = wp.constant(-100.0)  # lower than any ground, even where it slopes towards a node without any
SINKING = wp.constant(0.25)  # of the drop limit: who has come down this much may be passing an edge
ONE_SIDE, BOTH_SIDES = wp.constant(1), wp.constant(2)


@wp.func
def foot_point(position: wp.vec3, R: wp.mat33, body_height: float) -> wp.vec3:
    """The point on the ground under the body's origin, along its own z axis."""
    return position - wp.vec3(R[0, 2], R[1, 2], R[2, 2]) * body_height


@wp.struct
class Footing:
    """What a disc stands on: height and unit normal of the fitted plane, the sum of directions that are blocked.

    ``missing`` is 1 where its centre has no ground to stand on, ``falls`` where it tips over an edge.
    """

    height: float
    normal: wp.vec3
    wall: wp.vec2
    missing: int
    falls: int


@wp.func
def footing(terrain: Terrain, w: int, model: RobotModel, at: wp.vec2, below: float, normal: wp.vec3) -> Footing:
    """Footing at a point for a robot that has stood at height ``below`` on a plane with this normal so far."""
    foot = Footing()
    centre = ground_height(terrain, w, at[0], at[1])
    if centre < ABYSS or centre - below > model.step_rise:
        foot.missing = 1
        foot.height = below
        foot.normal = wp.vec3(0.0, 0.0, 1.0)
        return foot
    if below - centre <= model.drop_depth and is_level(terrain, w, at[0], at[1], model.body_radius):
        foot.height = centre
        foot.normal = wp.vec3(0.0, 0.0, 1.0)
        return foot
    sinking = below - centre > SINKING * model.drop_depth
    level = centre
    if below - centre > model.drop_depth:
        level = below
    total = level
    count = float(1.0)
    edges = int(0)
    tilt = wp.vec2(0.0, 0.0)
    ray = wp.vec2(1.0, 0.0)
    for _k in range(RIM_POINTS):
        rim = ray * model.body_radius
        h = ground_height(terrain, w, at[0] + rim[0], at[1] + rim[1])
        plane = below - (normal[0] * rim[0] + normal[1] * rim[1]) / normal[2]
        if sinking and h - centre > model.drop_depth:
            edges = edges | nearby_edges(terrain, w, model, at, ray, centre)
        if h < ABYSS or rises(terrain, w, model, at + rim, ray, h, wp.max(centre, below)):
            foot.wall = foot.wall + ray
        elif plane - h <= model.drop_depth:
            total = total + h
            count = count + 1.0
            tilt = tilt + ray * (h - level)
        ray = wp.vec2(RIM_COS * ray[0] - RIM_SIN * ray[1], RIM_SIN * ray[0] + RIM_COS * ray[1])
    foot.height = wp.max(total / count, level)
    if edges == ONE_SIDE:
        foot.falls = 1
        foot.height = centre
    slope = tilt * (2.0 / (float(RIM_POINTS) * model.body_radius))
    foot.normal = wp.normalize(wp.vec3(-slope[0], -slope[1], 1.0))
    return foot


@wp.func
def rises(terrain: Terrain, w: int, model: RobotModel, rim: wp.vec2, ray: wp.vec2, h: float, level: float) -> bool:
    """Whether the ground rises to a rim point (height h) as a wall: too high, within too short a way."""
    if h - level <= model.step_rise:
        return False
    if (h - level) * model.step_reach > model.step_rise * model.body_radius:
        return True
    inner = rim - ray * model.step_reach
    return h - ground_height(terrain, w, inner[0], inner[1]) > model.step_rise


@wp.func
def nearby_edges(terrain: Terrain, w: int, model: RobotModel, at: wp.vec2, ray: wp.vec2, centre: float) -> int:
    """Whether edges too deep for the robot lie close by along ``ray``: none (0), on one side, or on both."""
    reach = ray * model.drop_reach
    if ground_height(terrain, w, at[0] + reach[0], at[1] + reach[1]) - centre <= model.drop_depth:
        return 0
    if ground_height(terrain, w, at[0] - reach[0], at[1] - reach[1]) - centre <= model.drop_depth:
        return ONE_SIDE
    return BOTH_SIDES

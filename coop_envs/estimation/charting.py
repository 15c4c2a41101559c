"""From beliefs to the map: where robots went, and what their scan rays passed and hit."""

from __future__ import annotations

import warp as wp

from coop_envs.estimation.belief import LOST, WORKING, Belief, MemberModel
from coop_envs.estimation.declaring import position_sigma
from coop_envs.estimation.ranging import Points
from coop_envs.mapping.ground_map import SILENT, STUCK, Footprint, GroundMap, MapModel, draw_footprint
from coop_envs.mapping.volume import judge_changes, mark_point, sweep_ray
from coop_envs.sensing.triangulation import OK

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

PROVING_S = wp.constant(1.0)


@wp.kernel
def chart(
    belief: Belief,
    ground: GroundMap,
    members: wp.array[MemberModel],
    model: MapModel,
    running: wp.array[int],
):
    """Enter every robot of the running teams into their maps."""
    b = wp.tid()
    ground.change_count[b] = 0
    if running[b] == 0:
        return
    for r in range(members.shape[0]):
        foot = Footprint()
        p = belief.position[b, r]
        foot.x = float(p[0])
        foot.y = float(p[1])
        foot.z = float(p[2]) - members[r].body_height
        foot.height = members[r].height
        foot.sigma = position_sigma(belief, b, r)
        foot.contact_radius = members[r].contact_radius
        foot.body_radius = members[r].body_radius
        working = belief.declared[b, r] == WORKING and belief.silent_s[b, r] == 0.0
        foot.proves = int(working and belief.tried_s[b, r] < PROVING_S)
        if belief.declared[b, r] == LOST and belief.marked[b, r] == 1:
            foot.marks = STUCK
            if belief.silent_s[b, r] > 0.0:
                foot.marks = SILENT
        draw_footprint(ground, model, b, r, foot)


@wp.kernel
def chart_rays(
    belief: Belief, ground: GroundMap, members: wp.array[MemberModel], points: Points, model: MapModel,
    running: wp.array[int],
):  # fmt: skip
    """Enter the running teams' scan rays into their maps, and judge what stands in the way."""
    b = wp.tid()
    if running[b] == 0:
        return
    for t in range(points.answer.shape[1]):
        if points.answer[b, t] == OK:
            point = points.position[b, t]
            for k in range(2):
                i = points.cameras[b, t][k]
                eye = belief.position[b, i] + belief.rotation[b, i] * members[i].p_body_camera
                sweep_ray(ground, model, b, wp.vec3(eye), point)
            mark_point(ground, model, b, point)
    judge_changes(ground, model, b)

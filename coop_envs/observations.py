"""What a policy sees: a function of belief and map alone, the same in simulation and on robots.

Each agent gets ``self`` (29,), ``mates`` (7, 16) with ``mask`` (7,), and ``map`` (3, 16, 16), an
ego-centred window of the team's map that is not turned with the robot, so that windows fit together. Entries are
divided by the scales in `SELF_FIELDS` and `MATE_FIELDS`; ``value = entry * scale`` in the unit given there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from gymnasium import spaces
from numpy.typing import NDArray

from coop_envs.agents.command import Command
from coop_envs.estimation.belief import LOST, WAITING, Belief, MemberModel
from coop_envs.estimation.declaring import position_sigma
from coop_envs.estimation.ranging import Points
from coop_envs.geometry.arrays import allocate
from coop_envs.geometry.so3 import heading
from coop_envs.mapping.ground_map import LAYERS, UNKNOWN, GroundMap, MapModel

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

MATES = 7
WINDOW = 16
MAP_LAYERS = ("ground", "obstacle", "robots")


@dataclass(frozen=True)
class Field:
    """One entry of an observation: value in ``unit`` = entry x ``scale``."""

    name: str
    unit: str
    scale: float
    meaning: str


SELF_FIELDS = (
    Field("role_observer", "1", 1.0, "1 for an observer"),
    Field("role_picket", "1", 1.0, "1 for a picket"),
    Field("x", "m", 2.0, "position in the team frame"),
    Field("y", "m", 2.0, "position in the team frame"),
    Field("z", "m", 0.5, "position in the team frame"),
    Field("cos_yaw", "1", 1.0, "heading in the team frame"),
    Field("sin_yaw", "1", 1.0, "heading in the team frame"),
    Field("pitch", "rad", 0.5, "nose up"),
    Field("roll", "rad", 0.5, "left side up"),
    Field("forward_speed", "m/s", 0.5, "along the body"),
    Field("yaw_rate", "rad/s", 2.0, "by the gyro, mean over the decision"),
    Field("log_sigma_position", "ln m", 5.0, "standard deviation of the position"),
    Field("log_sigma_heading", "ln rad", 5.0, "standard deviation of the heading"),
    Field("stationary", "1", 1.0, "1 while it stands still by the filter's verdict"),
    Field("battery", "1", 1.0, "remaining fraction"),
    Field("docked", "1", 1.0, "1 for a reserve in its dock: its actions are ignored"),
    Field("stuck_suspicion", "1", 1.0, "0 while its motion is noticed, 1 when it is about to be declared lost"),
    Field("has_camera", "1", 1.0, "1 with a camera"),
    Field("mates_in_view", "1", 7.0, "how many hats its camera sees"),
    Field("goal_known", "1", 1.0, "1 where the task has a goal"),
    Field("goal_x", "m", 2.0, "goal ahead, own axes"),
    Field("goal_y", "m", 2.0, "goal to the left, own axes"),
    Field("time_left", "1", 1.0, "fraction of the time limit"),
    Field("reserves_left", "1", 8.0, "robots still in the dock"),
    Field("map_x", "m", 2.0, "lower corner of the map window in the team frame"),
    Field("map_y", "m", 2.0, "lower corner of the map window in the team frame"),
    Field("has_laser", "1", 1.0, "1 with a laser that scans"),
    Field("scan_progress", "1", 1.0, "share of the raster that is done: 1 in the decision that ends it, 0 without one"),
    Field("points", "1", 6.0, "points that the team's scans measured in this decision"),
)
MATE_FIELDS = (
    Field("role_observer", "1", 1.0, "1 for an observer"),
    Field("role_picket", "1", 1.0, "1 for a picket"),
    Field("x", "m", 2.0, "ahead, in the axes of the agent that observes"),
    Field("y", "m", 2.0, "to the left, in the axes of the agent that observes"),
    Field("z", "m", 0.5, "above, in the axes of the agent that observes"),
    Field("cos_yaw", "1", 1.0, "heading relative to the agent that observes"),
    Field("sin_yaw", "1", 1.0, "heading relative to the agent that observes"),
    Field("log_sigma_position", "ln m", 5.0, "standard deviation of its position in the team frame"),
    Field("log_sigma_heading", "ln rad", 5.0, "standard deviation of its heading in the team frame"),
    Field("stationary", "1", 1.0, "1 while it stands still by the filter's verdict"),
    Field("lost", "1", 1.0, "1 once declared lost; a stuck robot is a landmark as long as its hat is lit"),
    Field("docked", "1", 1.0, "1 for a reserve in its dock"),
    Field("sees_me", "1", 1.0, "1 if its camera gave my pose in this decision"),
    Field("i_see", "1", 1.0, "1 if my camera gave its pose in this decision"),
    Field("distance", "m", 2.0, "between the two"),
    Field("speed", "m/s", 0.5, "of its body"),
)
SELF_SIZE, MATE_SIZE = len(SELF_FIELDS), len(MATE_FIELDS)
_SELF_INDEX = {field.name: k for k, field in enumerate(SELF_FIELDS)}
_MATE_INDEX = {field.name: k for k, field in enumerate(MATE_FIELDS)}


def self_field(observation: dict[str, NDArray[Any]], name: str) -> float:
    """An entry of ``self`` in its unit."""
    k = _SELF_INDEX[name]
    return float(observation["self"][k]) * SELF_FIELDS[k].scale


def mate_field(observation: dict[str, NDArray[Any]], name: str) -> NDArray[np.float32]:
    """An entry of all ``mates`` (7,) in its unit."""
    k = _MATE_INDEX[name]
    return observation["mates"][:, k] * np.float32(MATE_FIELDS[k].scale)


def observation_space() -> spaces.Dict:
    """The space of one agent's observation, the same for all."""
    far = np.finfo(np.float32).max
    return spaces.Dict(
        {
            "self": spaces.Box(-far, far, (SELF_SIZE,), np.float32),
            "mates": spaces.Box(-far, far, (MATES, MATE_SIZE), np.float32),
            "mask": spaces.Box(0, 1, (MATES,), np.int8),
            "map": spaces.Box(0, 255, (len(MAP_LAYERS), WINDOW, WINDOW), np.uint8),
        }
    )


def describe() -> dict[str, Any]:
    """Names, units and scales of every entry, in order, as plain data."""

    def rows(fields: tuple[Field, ...]) -> list[dict[str, Any]]:
        return [{"name": f.name, "unit": f.unit, "scale": f.scale, "meaning": f.meaning} for f in fields]

    layers = {"ground": "P(ground carries robots) x 255", "obstacle": "P(something stands here) x 255"}
    layers["robots"] = "255 a robot at work, 160 a lost one, 0 none"
    return {"self": rows(SELF_FIELDS), "mates": rows(MATE_FIELDS), "mask": "1 where a mate is", "map": layers}


@wp.struct
class Observations:
    """Arrays over B teams and N robots, as the policy gets them.

    ``self`` is called ``own`` here, and the rows of a map window follow each other in one axis: Warp has four at most.
    """

    own: wp.array3d[float]
    mates: wp.array4d[float]
    mask: wp.array3d[wp.int8]
    map: wp.array4d[wp.uint8]


def allocate_observations(teams: int, robots: int, device: str) -> Observations:
    """Observations of nothing yet."""
    shape = (teams, robots)
    sizes = {"own": (*shape, SELF_SIZE), "mates": (*shape, MATES, MATE_SIZE), "mask": (*shape, MATES)}
    return allocate(Observations, shape, device, **sizes, map=(*shape, len(MAP_LAYERS), WINDOW * WINDOW))


def observation_arrays(out: Observations) -> dict[str, NDArray[Any]]:
    """The arrays (B, N, ...) under the names and in the shapes that policies know; on the CPU they share memory."""
    window = out.map.numpy()
    window = window.reshape(*window.shape[:3], WINDOW, WINDOW)
    return {"self": out.own.numpy(), "mates": out.mates.numpy(), "mask": out.mask.numpy(), "map": window}


def by_agent(arrays: Mapping[str, NDArray[Any]], places: Mapping[str, int]) -> dict[str, dict[str, NDArray[Any]]]:
    """Copies of one team's arrays (N, ...) by the names of its robots."""
    copies = {key: array.copy() for key, array in arrays.items()}
    return {name: {key: array[i] for key, array in copies.items()} for name, i in places.items()}


@wp.struct
class ViewModel:
    """Time limit, decision length and the time after which a robot is called stuck (s)."""

    time_limit: float
    decision: float
    stuck: float


@wp.func
def heading_sigma(belief: Belief, b: int, r: int) -> float:
    """Standard deviation of a robot's heading (rad)."""
    return wp.sqrt(wp.max(float(belief.pose_covariance[b, r][2, 2]), 0.0))


@wp.func
def log_sigma(sigma: float) -> float:
    """Natural logarithm of a standard deviation, from 1e-6 up, over its scale."""
    return wp.log(wp.max(sigma, 1.0e-6)) / 5.0


@wp.func
def window_corner(ground: GroundMap, model: MapModel, b: int, x: float, y: float) -> wp.vec2i:
    """First block of the window around (x, y)."""
    c = ground.corner[b]
    side = model.cell * float(model.stride)
    return wp.vec2i(int(wp.floor((x - c[0]) / side)) - 8, int(wp.floor((y - c[1]) / side)) - 8)


@wp.func
def copy_window(ground: GroundMap, model: MapModel, out: Observations, b: int, r: int, corner: wp.vec2i):
    """Fill the ground and obstacle layers of one agent's map window from its first block on; clear the robots'."""
    rows = (model.nx + model.stride - 1) // model.stride
    across = (model.ny + model.stride - 1) // model.stride
    for i in range(WINDOW):
        for layer in range(LAYERS):
            row = corner[0] + i
            for j in range(WINDOW):
                column = corner[1] + j
                value = wp.uint8(UNKNOWN)
                if row >= 0 and row < rows and column >= 0 and column < across:
                    value = ground.shown[b, layer, row * across + column]
                out.map[b, r, layer, WINDOW * i + j] = value
        for j in range(WINDOW):
            out.map[b, r, LAYERS, WINDOW * i + j] = wp.uint8(0)


@wp.func
def draw_robots(
    belief: Belief, model: MapModel, members: wp.array[MemberModel], out: Observations, b: int, r: int, corner: wp.vec2
):  # fmt: skip
    """Draw the robots into the map window of one agent; ``corner`` is the window's, in the team frame."""
    side = model.cell * float(model.stride)
    for o in range(members.shape[0]):
        if belief.declared[b, o] != WAITING:
            p = belief.position[b, o]
            x = float(p[0]) - corner[0]
            y = float(p[1]) - corner[1]
            reach = wp.max(members[o].body_radius, 0.5 * side)
            value = wp.uint8(255)
            if belief.declared[b, o] == LOST:
                value = wp.uint8(160)
            i1 = wp.clamp(int(wp.floor((x + reach) / side)), -1, WINDOW - 1)
            j1 = wp.clamp(int(wp.floor((y + reach) / side)), -1, WINDOW - 1)
            for i in range(wp.max(int(wp.floor((x - reach) / side)), 0), i1 + 1):
                for j in range(wp.max(int(wp.floor((y - reach) / side)), 0), j1 + 1):
                    dx = (float(i) + 0.5) * side - x
                    dy = (float(j) + 0.5) * side - y
                    if dx * dx + dy * dy <= reach * reach:
                        out.map[b, r, LAYERS, WINDOW * i + j] = value


@wp.func
def draw_self(
    belief: Belief, view: ViewModel, members: wp.array[MemberModel], out: Observations, rate: float, progress: float,
    points: int, b: int, r: int, corner: wp.vec2,
):  # fmt: skip
    """Fill what one agent knows of itself, in the order of `SELF_FIELDS`."""
    n = members.shape[0]
    p = belief.position[b, r]
    R = belief.rotation[b, r]
    yaw = heading(R)
    c = float(wp.cos(yaw))
    s = float(wp.sin(yaw))
    v = wp.transpose(R) * belief.velocity[b, r]
    seen = float(0.0)
    waiting = float(0.0)
    for o in range(n):
        seen = seen + float(belief.seen[b, r, o])
        if belief.declared[b, o] == WAITING:
            waiting = waiting + 1.0
    goal = belief.goal[b]
    gx = goal[0] - float(p[0])
    gy = goal[1] - float(p[1])
    own = out.own
    own[b, r, 0] = float(1 - members[r].picket)
    own[b, r, 1] = float(members[r].picket)
    own[b, r, 2] = float(p[0]) / 2.0
    own[b, r, 3] = float(p[1]) / 2.0
    own[b, r, 4] = float(p[2]) / 0.5
    own[b, r, 5] = c
    own[b, r, 6] = s
    own[b, r, 7] = wp.asin(wp.clamp(float(R[2, 0]), -1.0, 1.0)) / 0.5
    own[b, r, 8] = wp.asin(wp.clamp(float(R[2, 1]), -1.0, 1.0)) / 0.5
    own[b, r, 9] = float(v[0]) / 0.5
    own[b, r, 10] = rate / 2.0
    own[b, r, 11] = log_sigma(position_sigma(belief, b, r))
    own[b, r, 12] = log_sigma(heading_sigma(belief, b, r))
    own[b, r, 13] = float(belief.stationary[b, r])
    own[b, r, 14] = belief.battery[b, r]
    own[b, r, 15] = float(belief.declared[b, r] == WAITING)
    own[b, r, 16] = wp.min(belief.tried_s[b, r] / view.stuck, 1.0)
    own[b, r, 17] = float(members[r].camera)
    own[b, r, 18] = seen / 7.0
    own[b, r, 19] = goal[3]
    own[b, r, 20] = goal[3] * (c * gx + s * gy) / 2.0
    own[b, r, 21] = goal[3] * (c * gy - s * gx) / 2.0
    own[b, r, 22] = 1.0 - float(belief.clock[b] - 1) * view.decision / view.time_limit
    own[b, r, 23] = waiting / 8.0
    own[b, r, 24] = corner[0] / 2.0
    own[b, r, 25] = corner[1] / 2.0
    own[b, r, 26] = float(members[r].laser)
    own[b, r, 27] = progress
    own[b, r, 28] = float(points) / 6.0


@wp.func
def draw_mate(belief: Belief, members: wp.array[MemberModel], out: Observations, b: int, r: int, m: int, o: int):
    """Fill row m of agent r's mates with robot o, in the order of `MATE_FIELDS`."""
    R = belief.rotation[b, r]
    d = wp.transpose(R) * (belief.position[b, o] - belief.position[b, r])
    yaw = heading(belief.rotation[b, o]) - heading(R)
    mates = out.mates
    mates[b, r, m, 0] = float(1 - members[o].picket)
    mates[b, r, m, 1] = float(members[o].picket)
    mates[b, r, m, 2] = float(d[0]) / 2.0
    mates[b, r, m, 3] = float(d[1]) / 2.0
    mates[b, r, m, 4] = float(d[2]) / 0.5
    mates[b, r, m, 5] = float(wp.cos(yaw))
    mates[b, r, m, 6] = float(wp.sin(yaw))
    mates[b, r, m, 7] = log_sigma(position_sigma(belief, b, o))
    mates[b, r, m, 8] = log_sigma(heading_sigma(belief, b, o))
    mates[b, r, m, 9] = float(belief.stationary[b, o])
    mates[b, r, m, 10] = float(belief.declared[b, o] == LOST)
    mates[b, r, m, 11] = float(belief.declared[b, o] == WAITING)
    mates[b, r, m, 12] = float(belief.seen[b, o, r])
    mates[b, r, m, 13] = float(belief.seen[b, r, o])
    mates[b, r, m, 14] = float(wp.length(d)) / 2.0
    mates[b, r, m, 15] = float(wp.length(belief.velocity[b, o])) / 0.5


@wp.func
def mate_rank(belief: Belief, b: int, r: int, o: int) -> float:
    """Distance by which mates are ordered; lost robots come after those at work, robots in the dock last."""
    d = float(wp.length(belief.position[b, o] - belief.position[b, r]))
    if belief.declared[b, o] == WAITING:
        return 1.0e6 + float(o)
    if belief.declared[b, o] == LOST:
        return 1.0e5 + d
    return d


@wp.kernel
def observe(
    belief: Belief, ground: GroundMap, model: MapModel, view: ViewModel, members: wp.array[MemberModel],
    gyro: wp.array3d[wp.vec3], command: Command, points: Points, out: Observations, running: wp.array[int],
):  # fmt: skip
    """Observations of every agent of the running teams; one thread each."""
    b, r = wp.tid()
    if running[b] == 0:
        return
    p = belief.position[b, r]
    block = window_corner(ground, model, b, float(p[0]), float(p[1]))
    corner = ground.corner[b] + wp.vec2(float(block[0]), float(block[1])) * (model.cell * float(model.stride))
    rate = float(0.0)
    if belief.declared[b, r] != WAITING:
        for t in range(gyro.shape[2]):
            rate = rate + (gyro[b, r, t][2] - float(belief.gyro_bias[b, r][2])) / float(gyro.shape[2])
    draw_self(belief, view, members, out, rate, command.scan_progress[b, r], points.count[b], b, r, corner)
    copy_window(ground, model, out, b, r, block)
    draw_robots(belief, model, members, out, b, r, corner)
    rank = float(-1.0)
    last = int(-1)
    for m in range(MATES):
        best = float(1.0e30)
        chosen = int(-1)
        for o in range(members.shape[0]):
            if o != r:
                d = mate_rank(belief, b, r, o)
                if (d > rank or (d == rank and o > last)) and d < best:
                    best = d
                    chosen = o
        out.mask[b, r, m] = wp.int8(chosen >= 0)
        if chosen >= 0:
            draw_mate(belief, members, out, b, r, m, chosen)
            rank = best
            last = chosen
        else:
            for k in range(MATE_SIZE):
                out.mates[b, r, m, k] = 0.0

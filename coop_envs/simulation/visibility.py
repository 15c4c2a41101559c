"""What light from a hat reaches a camera: terrain, other robots and the carrier's own body stand in its way."""

from __future__ import annotations

import warp as wp

from coop_envs.agents.command import Command
from coop_envs.geometry.terrain import blocked
from coop_envs.sensing.leds import LedModel, led_signal
from coop_envs.simulation.dynamics import Ground, present
from coop_envs.simulation.parameters import RobotModel
from coop_envs.simulation.state import DEPLETED, State

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

DIFFUSER_M = wp.constant(0.005)


@wp.func
def powered(state: State, b: int, r: int) -> bool:
    """Whether a robot in the world has power for its camera and hat."""
    return present(state, b, r) and state.status[b, r] != DEPLETED


@wp.func
def hidden_by_robot(state: State, robots: wp.array[RobotModel], b: int, i: int, j: int, a: wp.vec3, c: wp.vec3) -> bool:
    """Whether a third robot's body, an upright cylinder, stands between camera a and LED c."""
    d = wp.vec2(c[0] - a[0], c[1] - a[1])
    length2 = wp.dot(d, d)
    if length2 < 1.0e-9:
        return False
    for k in range(robots.shape[0]):
        if k != i and k != j and present(state, b, k):
            p = state.position[b, k]
            to = wp.vec2(p[0] - a[0], p[1] - a[1])
            s = wp.dot(to, d) / length2
            chord2 = robots[k].body_radius * robots[k].body_radius / length2 - wp.dot(to, to) / length2 + s * s
            if chord2 > 0.0 and s + wp.sqrt(chord2) > 0.0 and s - wp.sqrt(chord2) < 1.0:
                enter = wp.max(s - wp.sqrt(chord2), 0.0)
                leave = wp.min(s + wp.sqrt(chord2), 1.0)
                bottom = p[2] - robots[k].body_height
                first = a[2] + enter * (c[2] - a[2])
                last = a[2] + leave * (c[2] - a[2])
                if wp.min(first, last) < bottom + robots[k].height and wp.max(first, last) > bottom:
                    return True
    return False


@wp.func
def hidden_by_carrier(model: RobotModel, eye: wp.vec3, led: wp.vec3) -> bool:
    """Whether the carrier's own body, a cylinder about its z axis, stands between a camera and an LED (body frame).

    An LED above the body is hidden only by its edge, one beside it by all of it; one within its outline sits on its
    skin, so that the cylinder which hides it ends there.
    """
    top = model.height - model.body_height
    d = wp.vec2(eye[0] - led[0], eye[1] - led[1])
    length2 = wp.dot(d, d)
    reach2 = led[0] * led[0] + led[1] * led[1]
    radius2 = model.body_radius * model.body_radius
    if led[2] < top:
        radius2 = wp.min(radius2, reach2)
    s = -(led[0] * d[0] + led[1] * d[1]) / length2
    chord2 = (radius2 - reach2) / length2 + s * s
    if length2 < 1.0e-9 or chord2 <= 0.0:
        return False
    enter = wp.max(s - wp.sqrt(chord2), 0.0)
    leave = wp.min(s + wp.sqrt(chord2), 1.0)
    rise = eye[2] - led[2]
    return leave > enter + 1.0e-5 and led[2] + wp.min(enter * rise, leave * rise) < top


@wp.func
def light_from(
    state: State, command: Command, robots: wp.array[RobotModel], model: LedModel, ground: Ground,
    b: int, i: int, j: int, eye: wp.vec3, led: wp.vec3,
) -> float:  # fmt: skip
    """Signal that camera i, at ``eye`` in the world, gets of the LED at ``led`` in the body of robot j; 0 if none."""
    R = state.rotation[b, j]
    lamp = state.position[b, j] + R * led
    signal = led_signal(model, command.brightness[b, j], eye - lamp, wp.vec3(R[0, 2], R[1, 2], R[2, 2]))
    if signal < model.detection_signal:
        return 0.0
    if hidden_by_carrier(robots[j], wp.transpose(R) * (eye - state.position[b, j]), led):
        return 0.0
    if hidden_by_robot(state, robots, b, i, j, eye, lamp):
        return 0.0
    if blocked(ground.terrain, state.world[b], eye, lamp, DIFFUSER_M):
        return 0.0
    return signal

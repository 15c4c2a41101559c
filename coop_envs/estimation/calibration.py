"""How calibration errors move the pose that a camera gives of a hat, to first order; they are states of the filter.

States of a camera's slot: focal length (relative), principal point (px, 2), its place in the body (m, body axes, 3) and
its turn there (rad, camera axes, 3). Of a hat's slots: five LEDs each, the place of every one in the body (m, 3). The
truth is what is believed plus the state.

A pose solver that minimises squared pixels answers an image that is off by ``d uv`` with a pose that is off by
``(J^T J)^-1 J^T d uv`` over the LEDs that it used. Not in the thesis, whose filter takes cameras and hats as known.
"""
# pyright: reportUnknownVariableType=false
# To the type checker, entries of Warp's matrices have no type.

from __future__ import annotations

import warp as wp

from coop_envs.agents.team import Team
from coop_envs.estimation.belief import LEDS_PER_SLOT, Belief, MemberModel
from coop_envs.estimation.rows import EFFECTS, Rows
from coop_envs.sensing.camera import CameraModel, camera_model
from coop_envs.sensing.hats import Hats, pack_hats
from coop_envs.sensing.poses import LedRows, cholesky6, information_of, inverse_from_cholesky6, led_rows, mat66d, vec6d

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FOCAL, CENTRE, PLACE, TURN = (wp.constant(k) for k in (0, 1, 3, 6))
CAMERA_EFFECT, HAT_EFFECT = wp.constant(0), wp.constant(1)


@wp.struct
class Optics:
    """The cameras (N,) and hats of a team as calibrated."""

    cameras: wp.array[CameraModel]
    hats: Hats


def pack_optics(team: Team, device: str) -> Optics:
    """The cameras and hats of a team."""
    optics = Optics()
    optics.cameras = wp.array([camera_model(m.camera) for m in team.members], dtype=CameraModel, device=device)
    optics.hats = pack_hats([m.hat.leds if m.hat else () for m in team.members], device)
    return optics


@wp.struct
class CalibrationPrior:
    """Standard deviations of calibration states; lengths m, angles rad."""

    focal: wp.float64
    centre_px: wp.float64
    place: wp.float64
    turn: wp.float64
    hat: wp.float64


@wp.func
def set_entry(rows: Rows, b: int, column: int, effect: vec6d):
    """Enter how the pose moves with one state."""
    for m in range(6):
        rows.effect_entries[b, m, column] = effect[m]


@wp.struct
class Seen:
    """A hat j before camera i, its pose in camera axes, the LEDs that gave it, and (J^T J)^-1 of them.

    ``hat_slot`` is the slot from which its LEDs are placed as estimated, or -1: as calibrated, where the measured pose
    fits them.
    """

    i: int
    j: int
    hat_slot: int
    R: wp.mat33d
    p: wp.vec3d
    leds: int
    spread: mat66d


@wp.func
def shows(seen: Seen, k: int) -> bool:
    """Whether a pose rests on LED k; on all of them if nobody tells."""
    return seen.leds == 0 or ((seen.leds >> k) & 1) == 1


@wp.func
def row_of(belief: Belief, optics: Optics, seen: Seen, b: int, k: int) -> LedRows:
    """Where LED k is in the image, and how it moves with the pose."""
    led = wp.vec3d(optics.hats.position[seen.j, k])
    if seen.hat_slot >= 0:
        off = belief.calibration[b, seen.hat_slot + k // LEDS_PER_SLOT]
        first = 3 * (k % LEDS_PER_SLOT)
        led = led + wp.vec3d(off[first], off[first + 1], off[first + 2])
    return led_rows(optics.cameras[seen.i], seen.R * led, seen.p)


@wp.func
def pose_spread(belief: Belief, optics: Optics, seen: Seen, b: int) -> mat66d:
    """(J^T J)^-1 of a hat's pose; zero where its LEDs do not determine it."""
    information = mat66d()
    for k in range(optics.hats.leds[seen.j]):
        if shows(seen, k):
            information = information + information_of(row_of(belief, optics, seen, b, k), wp.float64(1.0))
    low = cholesky6(information)
    if not low[0, 0] > wp.float64(0.0):
        return mat66d()
    return inverse_from_cholesky6(low)


@wp.func
def hat_effects(belief: Belief, rows: Rows, optics: Optics, seen: Seen, b: int):
    """How the pose moves with each LED's place."""
    for k in range(optics.hats.leds[seen.j]):
        led = row_of(belief, optics, seen, b, k)
        along_u = wp.transpose(seen.R) * wp.vec3d(led.u[3], led.u[4], led.u[5])
        along_v = wp.transpose(seen.R) * wp.vec3d(led.v[3], led.v[4], led.v[5])
        for axis in range(3):
            moved = vec6d()
            if shows(seen, k):
                moved = seen.spread * (led.u * along_u[axis] + led.v * along_v[axis])
            set_entry(rows, b, 15 * HAT_EFFECT + 3 * k + axis, moved)


@wp.func
def camera_effects(belief: Belief, rows: Rows, optics: Optics, member: MemberModel, seen: Seen, b: int):
    """How the pose moves with the lens and with the camera's place in the body."""
    centre = wp.vec2d(optics.cameras[seen.i].centre)
    focal = vec6d()
    across = vec6d()
    down = vec6d()
    for k in range(optics.hats.leds[seen.j]):
        if shows(seen, k):
            led = row_of(belief, optics, seen, b, k)
            off = led.uv - centre
            focal = focal + led.u * off[0] + led.v * off[1]
            across = across + led.u
            down = down + led.v
    set_entry(rows, b, FOCAL, seen.spread * focal)
    set_entry(rows, b, CENTRE, seen.spread * across)
    set_entry(rows, b, CENTRE + 1, seen.spread * down)
    zero = wp.float64(0.0)
    for axis in range(3):
        unit = wp.vec3d()
        unit[axis] = wp.float64(1.0)
        shift = -(wp.transpose(member.R_body_camera) * unit)
        swing = wp.cross(seen.p, unit)
        set_entry(rows, b, PLACE + axis, vec6d(zero, zero, zero, shift[0], shift[1], shift[2]))
        set_entry(rows, b, TURN + axis, vec6d(-unit[0], -unit[1], -unit[2], swing[0], swing[1], swing[2]))


@wp.func
def find_effects(
    belief: Belief, rows: Rows, optics: Optics, member: MemberModel, other: MemberModel, b: int, seen: Seen
):
    """Enter into ``rows.effect`` how a pose moves with calibration states."""
    seen.spread = pose_spread(belief, optics, seen, b)
    if member.camera_slot >= 0:
        camera_effects(belief, rows, optics, member, seen, b)
    if other.hat_slot >= 0:
        hat_effects(belief, rows, optics, seen, b)


@wp.func
def effect_slot(optics: Optics, member: MemberModel, other: MemberModel, j: int, c: int) -> int:
    """The filter's slot that effect c of a sighting acts on, or -1."""
    if c == CAMERA_EFFECT:
        return member.camera_slot
    if other.hat_slot >= 0 and (c - HAT_EFFECT) * LEDS_PER_SLOT < optics.hats.leds[j]:
        return other.hat_slot + c - HAT_EFFECT
    return -1


@wp.func
def add_effects(rows: Rows, optics: Optics, member: MemberModel, other: MemberModel, b: int, j: int, s: int):
    """Add to the projected rows what comes through calibration states, the entries of slot s."""
    for c in range(EFFECTS):
        slot = effect_slot(optics, member, other, j, c)
        if slot >= 0:
            for m in range(6):
                total = rows.projected[b, m, s]
                for k in range(15):
                    total = total + rows.covariance[b, 15 * slot + k, s] * rows.effect_entries[b, m, 15 * c + k]
                rows.projected[b, m, s] = total


@wp.func
def effect_innovation(rows: Rows, optics: Optics, member: MemberModel, other: MemberModel, b: int, j: int) -> mat66d:
    """What calibration states add to H P H^T, from projected rows that are complete."""
    total = mat66d()
    for c in range(EFFECTS):
        slot = effect_slot(optics, member, other, j, c)
        if slot >= 0:
            for m in range(6):
                for k in range(6):
                    total[m, k] = total[m, k] + wp.dot(rows.projected[b, m, slot], rows.effect[b, k, c])
    return total


@wp.func
def effect_of_kept(
    rows: Rows, optics: Optics, member: MemberModel, other: MemberModel, b: int, j: int, p: int
) -> vec6d:
    """What calibration states add to H n of a kept row n."""
    total = vec6d()
    for c in range(EFFECTS):
        slot = effect_slot(optics, member, other, j, c)
        if slot >= 0:
            for m in range(6):
                total[m] = total[m] + wp.dot(rows.effect[b, m, c], rows.kept[b, p, slot])
    return total


@wp.func
def effect_shift(
    belief: Belief, rows: Rows, optics: Optics, member: MemberModel, other: MemberModel, b: int, j: int
) -> vec6d:
    """How far the calibration states, as estimated, move the pose."""
    shift = vec6d()
    for c in range(EFFECTS):
        slot = effect_slot(optics, member, other, j, c)
        if slot >= 0:
            for m in range(6):
                shift[m] = shift[m] + wp.dot(rows.effect[b, m, c], belief.calibration[b, slot])
    return shift


@wp.func
def begin_calibration(belief: Belief, member: MemberModel, prior: CalibrationPrior, hats: Hats, b: int, r: int):
    """Put what is known of a robot's calibration into the filter."""
    if member.camera_slot >= 0:
        row = 15 * member.camera_slot
        for k in range(3):
            set_sigma(belief, b, row + PLACE + k, prior.place)
            set_sigma(belief, b, row + TURN + k, prior.turn)
        set_sigma(belief, b, row + FOCAL, prior.focal)
        set_sigma(belief, b, row + CENTRE, prior.centre_px)
        set_sigma(belief, b, row + CENTRE + 1, prior.centre_px)
    if member.hat_slot >= 0:
        for k in range(3 * hats.leds[r]):
            set_sigma(belief, b, 15 * member.hat_slot + k, prior.hat)


@wp.func
def set_sigma(belief: Belief, b: int, row: int, sigma: wp.float64):
    """Put a variance on the diagonal."""
    belief.covariance[b, row, row] = sigma * sigma

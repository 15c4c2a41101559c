"""The inchworm rule: a robot may move only while a robot that stands still ties it to the ground.

A robot may move if, afterwards, it and every other mover is linked by current sightings, directly or through others, to
a robot that is declared stationary and stays so; others hold. Where all the stationary robots that are linked want to
move, the first of them in the team's order holds for the rest. All is read from the observations of the robots, so the
same function serves on robots; `coop_envs.wrappers.InchwormShield` enforces it in simulation.

Nobody may move who sees nobody and is seen by nobody: not while a frame misses a hat, nor during a scan, which darkens
all hats, nor ever again once the last link between the robots that are left is broken.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.agents.control import ACTION_NAMES
from coop_envs.observations import MATE_FIELDS, SELF_FIELDS

Arrays = dict[str, NDArray[Any]]
Actions = NDArray[np.float32]
Flags = NDArray[np.bool_]

HOLD, SCAN_REQUEST = ACTION_NAMES.index("hold"), ACTION_NAMES.index("scan_request")
SELF = {entry.name: k for k, entry in enumerate(SELF_FIELDS)}
MATE = {entry.name: k for k, entry in enumerate(MATE_FIELDS)}
SELF_SCALE = np.array([entry.scale for entry in SELF_FIELDS], dtype=np.float32)
MATE_SCALE = np.array([entry.scale for entry in MATE_FIELDS], dtype=np.float32)
SAME_M = 0.04
"""Two places closer than this are one robot's: bodies keep the centres of two farther apart."""


def permitted(observations: Arrays, actions: Actions) -> Actions:
    """The actions (..., N, 8) with a hold in place of each move that the rule forbids.

    ``observations`` of all robots of the teams: ``self`` (..., N, 29), ``mates`` (..., N, 7, 16), ``mask`` (..., N, 7),
    ``alive`` (..., N). Rows of robots that are not alive count for nothing.
    """
    forbidden = wants_to_move(observations, actions) & ~may_move(observations, actions)
    allowed = actions.copy()
    allowed[..., HOLD] = np.where(forbidden, 1.0, actions[..., HOLD])
    allowed[..., SCAN_REQUEST] = np.where(forbidden, -1.0, actions[..., SCAN_REQUEST])
    return allowed


def wants_to_move(observations: Arrays, actions: Actions) -> Flags:
    """Who (..., N) is at work and asks for motion."""
    return _at_work(observations) & (actions[..., HOLD] <= 0.0)


def may_move(observations: Arrays, actions: Actions) -> Flags:
    """Who (..., N) of those who ask for motion is granted it."""
    wants = wants_to_move(observations, actions)
    stationary = _at_work(observations) & (observations["self"][..., SELF["stationary"]] > 0.5)
    together, on_lost = links(observations)
    anchored = _any_of(together, (stationary & ~wants) | on_lost)
    willing = stationary & wants & ~anchored
    earlier = np.tril(np.ones((wants.shape[-1],) * 2, dtype=bool), -1)
    keeps = willing & ~_any_of(together & earlier, willing)
    return wants & ~keeps & (anchored | _any_of(together, keeps))


def links(observations: Arrays) -> tuple[Flags, Flags]:
    """Whom sightings of this decision link (..., N, N), directly or through others; who sees a lost landmark (..., N).

    A landmark is a stationary mate that cannot move. Mates have no names in observations: they are told by their place.
    """
    own, mates = observations["self"] * SELF_SCALE, observations["mates"] * MATE_SCALE
    at_work = _at_work(observations)
    row = (observations["mask"] > 0) & at_work[..., None]
    seen = row & ((mates[..., MATE["i_see"]] > 0.5) | (mates[..., MATE["sees_me"]] > 0.5))
    lost = mates[..., MATE["lost"]] > 0.5
    landmark = seen & lost & (mates[..., MATE["stationary"]] > 0.5)
    who = _identities(own, mates) & (seen & ~lost)[..., None] & at_work[..., None, None, :]
    link = _some(who, -2)
    n = link.shape[-1]
    link = link | np.swapaxes(link, -1, -2) | np.eye(n, dtype=bool)
    for _ in range(max(1, int(n - 1).bit_length())):
        link = _some(link[..., :, :, None] & link[..., None, :, :], -2)
    return link, _some(landmark, -1)


def _at_work(observations: Arrays) -> Flags:
    return (observations["alive"] > 0) & (observations["self"][..., SELF["docked"]] < 0.5)


def _some(flags: Flags, axis: int) -> Flags:
    return np.asarray(flags.any(axis=axis))


def _any_of(together: Flags, robots: Flags) -> Flags:
    """Who (..., N) is linked to one of some robots (..., N)."""
    return _some(together & robots[..., None, :], -1)


def _identities(own: NDArray[np.float32], mates: NDArray[np.float32]) -> Flags:
    """Which robot (..., N, 7, N) each row of mates is: the nearest to the place that the row tells, if it is there."""
    place = own[..., [SELF["x"], SELF["y"], SELF["z"]]]
    offset = mates[..., [MATE["x"], MATE["y"], MATE["z"]]]
    told = place[..., None, :] + np.einsum("...ij,...mj->...mi", _rotations(own), offset)
    distance = np.linalg.norm(told[..., None, :] - place[..., None, None, :, :], axis=-1)
    n = place.shape[-2]
    distance = np.where(np.eye(n, dtype=bool)[:, None, :], np.inf, distance)
    return (distance <= distance.min(axis=-1, keepdims=True)) & (distance < SAME_M)


def _rotations(own: NDArray[np.float32]) -> NDArray[np.float32]:
    """R_team_body (..., N, 3, 3) from heading and the heights of the body's x and y axes."""
    rise, lean = np.sin(own[..., SELF["pitch"]]), np.sin(own[..., SELF["roll"]])
    level = np.sqrt(np.maximum(1.0 - rise**2, 1e-6))
    across = -lean * rise / level
    aside = np.sqrt(np.maximum(1.0 - across**2 - lean**2, 0.0))
    c, s = own[..., SELF["cos_yaw"]], own[..., SELF["sin_yaw"]]
    x = np.stack([c * level, s * level, rise], axis=-1)
    y = np.stack([c * across - s * aside, s * across + c * aside, lean], axis=-1)
    return np.stack([x, y, np.cross(x, y)], axis=-1).astype(np.float32)

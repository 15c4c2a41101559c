"""How teams in the plane that do not know each other's frames find together: robots that join, teams that are placed.

Each sighting between them, and each fix, tells of one point in both frames. Points that agree on one turn and shift
give where one frame lies in the other; the frame then enters the filter as unknown, and the sightings follow as
ordinary updates, so that nothing is counted twice. Odometry carries older sightings to the present: errors from the
left stay what they are while a robot drives, but for the noise that odometry adds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.driving import STILL, Reckoned
from coop_envs.localization.planar.filter import PlanarFilter, PlanarFix
from coop_envs.localization.planar.se2 import Array
from coop_envs.localization.planar.sightings import KNOWN, Sightings, linearised, point_of

OPEN = np.diag([3.0, 100.0, 100.0]) ** 2
"""Covariance (yaw, x, y) of a frame of which nothing is known."""
APART = 5.0
"""So many sigmas two points must be apart to tell of a turn."""
AGREE = 3.0
ENOUGH = 4.0
FIX_WEIGHT = 2.0
"""A team is placed by four sightings that agree, or by two fixes."""


@dataclass(frozen=True, slots=True, eq=False)
class Meeting:
    """A sighting across frames, or (``subject`` None) a fix: ``measured`` is range and bearing, or x and y.

    ``sigma`` (2,) belongs to a sighting, ``covariance`` (2, 2) to a fix, ``place`` to a subject that is a known place.
    ``seer_then``, ``subject_then`` are what dead reckoning had when it happened.
    """

    time_s: float
    seer: str
    subject: str | None
    measured: Array
    sigma: Array
    covariance: Array
    place: Array | None
    seer_then: Reckoned
    subject_then: Reckoned

    @property
    def names(self) -> tuple[str, ...]:
        """Whom it concerns, known places aside."""
        return (self.seer,) if self.subject is None or self.place is not None else (self.seer, self.subject)


Now = dict[str, Reckoned]


def since(name: str, then: Reckoned, now: Now) -> Array:
    """The pose (3,) at an earlier time from the present one."""
    return se2.composed(se2.inverse(now.get(name, STILL).pose), then.pose)


def drifted(team: PlanarFilter, name: str, then: Reckoned, now: Now) -> Array:
    """Covariance (3, 3) of what odometry missed since, as an error from the left in the team's frame."""
    present = now.get(name, STILL)
    k = team.index[name]
    axes = se2.adjoint(se2.composed(team.pose[k], se2.inverse(present.pose)))
    return axes @ (present.spread - then.spread) @ axes.T


def points(host: PlanarFilter, guest: PlanarFilter, meeting: Meeting, now: Now) -> tuple[Array, Array, float]:
    """The point that a meeting tells of in the host's and in the guest's frame, and how exactly (m)."""
    own, other = (host, guest) if meeting.seer in host.index else (guest, host)
    variance = _known(own, meeting.seer, meeting.seer_then, now)
    pose = se2.composed(own.pose[own.index[meeting.seer]], since(meeting.seer, meeting.seer_then, now))
    if meeting.subject is None:
        seen, met = pose[:2], meeting.measured
        variance += np.trace(meeting.covariance)
    else:
        reach, spread = point_of(meeting.measured[None], meeting.sigma[None])
        variance += np.trace(spread[0])
        seen, met = se2.acted(pose, reach[0]), meeting.place
        if met is None:
            then = since(meeting.subject, meeting.subject_then, now)
            met = se2.acted(other.pose[other.index[meeting.subject]], then[:2])
            variance += _known(other, meeting.subject, meeting.subject_then, now)
    sigma = float(np.sqrt(variance))
    return (seen, met, sigma) if own is host else (met, seen, sigma)


def _known(team: PlanarFilter, name: str, then: Reckoned, now: Now) -> float:
    """Variance of a place in its team's frame at an earlier time (m^2)."""
    drift = now.get(name, STILL).spread - then.spread
    return float(np.trace(team.covariance_of(name)[1:, 1:]) + max(np.trace(drift[1:, 1:]), 0.0))


def agreed(host: Array, guest: Array, sigma: Array, weight: Array) -> tuple[Array, NDArray[np.bool_]] | None:
    """The pose (3,) of the guest's frame in the host's on which most of K points (K, 2) agree, and which do; or None.

    ``sigma`` (K,) in m; the ``weight`` (K,) of those that agree must be `ENOUGH`, and more than that of the others. No
    two points whose weight is below `FIX_WEIGHT` may decide: without them the rest must still tell of the turn.
    """
    best, best_weight = None, 0.0
    for k, j in combinations(range(len(host)), 2):
        over_there, here = guest[j] - guest[k], host[j] - host[k]
        apart, exact = np.linalg.norm(over_there), np.hypot(sigma[k], sigma[j])
        if apart < APART * exact or abs(apart - np.linalg.norm(here)) > AGREE * exact:
            continue
        yaw = np.arctan2(here[1], here[0]) - np.arctan2(over_there[1], over_there[0])
        pose = _about(0.5 * (host[k] + host[j]), 0.5 * (guest[k] + guest[j]), yaw)
        swung = exact / apart * np.linalg.norm(guest - 0.5 * (guest[k] + guest[j]), axis=1)
        agree = np.linalg.norm(host - se2.acted(pose, guest), axis=1) < AGREE * (sigma + swung)
        if weight[agree].sum() > best_weight and _many_tell(guest[agree], sigma[agree], weight[agree]):
            best, best_weight = agree, weight[agree].sum()
    if best is None or best_weight < ENOUGH or best_weight <= 0.5 * weight.sum():
        return None
    return fitted(host[best], guest[best], 1.0 / sigma[best] ** 2), best


def _many_tell(guest: Array, sigma: Array, weight: Array) -> bool:
    """Whether any two of points (K, 2) could be wrong and the others still tell of a turn; fixes are believed."""
    apart = np.linalg.norm(guest[:, None] - guest[None], axis=2) > APART * np.hypot(sigma[:, None], sigma[None])
    of_each = apart.sum(0)
    left = apart.sum() - 2 * (of_each[:, None] + of_each - apart)
    doubtful = (weight[:, None] < FIX_WEIGHT) & (weight < FIX_WEIGHT) & ~np.eye(len(weight), dtype=bool)
    return bool(np.all(left[doubtful] > 0))


def _about(here: Array, there: Array, yaw: float) -> Array:
    """The pose that turns by yaw and carries one point onto another."""
    return np.array([*(here - se2.rotation(np.array(yaw)) @ there), se2.wrapped(np.array(yaw))])


def fitted(host: Array, guest: Array, weight: Array) -> Array:
    """The pose (3,) that carries points (K, 2) onto others with the least weighted squared distance, in closed form."""
    share = weight / weight.sum()
    here, there = share @ host, share @ guest
    a, b = guest - there, (host - here) * share[:, None]
    yaw = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    return _about(here, there, float(yaw))


def fuse_meetings(team: PlanarFilter, meetings: list[Meeting], now: Now) -> None:
    """Update a team that holds all whom some meetings concern, but for sightings that do not fit what comes out.

    An open frame lets all of them through the filter's gate; so the worst is left out until the rest fit.
    """
    before, left = team.snapshot(), list(meetings)
    while True:
        _fuse(team, left, now)
        seen = [meeting for meeting in left if meeting.subject is not None]
        if len(seen) <= 2:
            return
        misfit = _misfit(team, seen, now)
        if misfit.max() <= team.gates[2]:
            return
        left.remove(seen[int(np.argmax(misfit))])
        team.restore(before)


def _misfit(team: PlanarFilter, meetings: list[Meeting], now: Now) -> Array:
    """Squared residuals (K,) of sightings after they were fused, over their own covariance."""
    made = as_sightings(team, meetings, now)
    residual = linearised(team.pose, made).residual
    return np.einsum("ki,ki->k", residual, np.linalg.solve(made.noise(), residual[:, :, None])[:, :, 0])


def _fuse(team: PlanarFilter, meetings: list[Meeting], now: Now) -> None:
    seen = [meeting for meeting in meetings if meeting.subject is not None]
    if seen:
        team.update(as_sightings(team, seen, now))
    for meeting in meetings:
        if meeting.subject is None:
            then = since(meeting.seer, meeting.seer_then, now)
            extra = drifted(team, meeting.seer, meeting.seer_then, now)
            team.fix(meeting.seer, PlanarFix(meeting.measured, None, meeting.covariance, then, extra))


def as_sightings(team: PlanarFilter, meetings: list[Meeting], now: Now) -> Sightings:
    """Meetings as sightings of a team that holds all whom they concern.

    What odometry missed since is common to many of them, so that it must not average out: it counts as often as there
    are meetings.
    """
    subjects = [KNOWN if m.place is not None else team.index[str(m.subject)] for m in meetings]
    made = Sightings(
        seer=np.array([team.index[m.seer] for m in meetings]),
        subject=np.array(subjects),
        place=np.array([np.zeros(2) if m.place is None else m.place for m in meetings]),
        measured=np.array([m.measured for m in meetings]),
        sigma=np.array([m.sigma for m in meetings]),
        seer_then=np.array([since(m.seer, m.seer_then, now) for m in meetings]),
        subject_then=np.array([since(str(m.subject), m.subject_then, now)[:2] for m in meetings]),
        extra=np.zeros((len(meetings), 2, 2)),
    )
    jacobian = linearised(team.pose, made).jacobian
    for k, m in enumerate(meetings):
        drift = sum((drifted(team, n, t, now) for n, t in zip(m.names, (m.seer_then, m.subject_then), strict=False)))
        made.extra[k] = len(meetings) * jacobian[k] @ drift @ jacobian[k].T
    return made

"""Which faults there are, in which teams, and what is demanded of a host when they come.

- policy (not a number, exception, wrong shape, robot left out, hangs, answers late) and pose (all cameras blind):
  every robot's set-points are zero within 0.5 s, and stay so.
- link of one robot (silent, garbage, frozen, late, unplugged, process killed): the host tells it zero within 0.5 s, and
  the others never stop. Its own set-points are zero within 0.5 s where it still hears, and where it hears late, within
  0.5 s and the delay. A deaf Zumy goes on as it was last told, since its firmware has no watchdog: nothing that a host
  does can help. When it hears again it obeys, and on being plugged in again it is told zero first. A VelociRoACH stops
  as its timed run ends; since it stamps nothing, that its answers are late shows only as they begin to be.
- what does no harm (a robot's clock jumps; the roscore is lost, which only introduces robots to their host): nobody
  stops.

Where the bridge itself is killed or stopped nothing can be sent: a VelociRoACH stops, a Zumy goes on as last told.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

ALLOWED_S, DELAY_S = 0.5, 0.6
TEAM_KINDS = ("nan", "exception", "shape", "left out", "hang", "slow", "blind")
LINK_KINDS = {
    "zumy_serial": ("silent", "garbage", "freeze", "late", "clock_jump", "unplug", "kill"),
    "velociroach_xbee": ("silent", "garbage", "freeze", "late", "unplug", "kill"),
    "zumy_ros1": ("silent", "garbage", "freeze", "late", "kill"),
    "simulator": ("silent", "garbage", "freeze"),
}
HARMLESS = ("clock_jump", "roscore")
DEAF = ("freeze", "unplug", "kill")
LEAVES = ("unplug", "kill")
ENDS_EMULATION = ("kill", "roscore")
SAFETY = {"inchworm": False, "barrier": False, "max_sigma_m": None, "battery_floor": None}
SEES = {"kind": "simulator"}
ROACH_TEAM = {
    "name": "mixed",
    "members": [
        {"role": "observer", "robot": "zumy", "cameras": ["ch6"], "hat": "zumy"},
        {"role": "picket", "robot": "velociroach_radio", "hat": "hat0"},
        {"role": "picket", "robot": "zumy", "cameras": ["ch6"], "hat": "hat1"},
    ],
}
ROACH = {"kind": "velociroach_xbee", "firmware": ["emulated roach"], "hat_brightness": 0.5}
SERIAL, UDP = {"kind": "zumy_serial"}, {"kind": "simulator"}


def team_of(name: str, master: str = "") -> dict[str, Any]:
    """What stands in the team file: two serial Zumys and one over UDP; a VelociRoACH between Zumys; two over ROS."""
    ros = [{"kind": "zumy_ros1", "master": master, "namespace": f"/zumy{k}"} for k in (1, 2)]
    links = {"zumys": [SERIAL, SERIAL, UDP], "roach": [SERIAL, ROACH, UDP], "ros": [ros[0], SERIAL, ros[1]]}[name]
    robots: dict[str, Any] = {}
    for robot, link in zip(("observer_0", "picket_0", "picket_1"), links, strict=True):
        robots[robot] = {"link": link} | ({} if link is ROACH else {"camera": SEES})
    team = ROACH_TEAM if name == "roach" else "surveyors"
    emulation = {"scenario": "arena", "seed": 1}
    return {"team": team, "robots": robots, "emulation": emulation, "safety": SAFETY, "time_limit_s": 3600.0}


@dataclass(frozen=True)
class Fault:
    """One fault; ``robot`` is None where it concerns everybody."""

    kind: str
    robot: str | None = None


def deck(team: str, seed: int, count: int) -> list[Fault]:
    """The faults of a campaign: over the seeds every fault of every robot comes equally often; the worst come last."""
    robots = {name: LINK_KINDS[wiring["link"]["kind"]] for name, wiring in team_of(team)["robots"].items()}
    links = [Fault(kind, name) for name, kinds in robots.items() for kind in kinds]
    both = [[Fault(kind) for kind in TEAM_KINDS], links + [Fault("roscore")] * (team == "ros")]
    shares = [round(0.4 * count), count - round(0.4 * count)]
    drawn: list[Fault] = []
    for faults, share in zip(both, shares, strict=True):
        random.Random(team).shuffle(faults)
        before = [sum(other.kind == fault.kind for other in faults[:k]) for k, fault in enumerate(faults)]
        faults = [fault for _, fault in sorted(zip(before, faults, strict=True), key=lambda pair: pair[0])]
        drawn += [faults[(seed * share + k) % len(faults)] for k in range(share)]
    random.Random(seed).shuffle(drawn)
    order = {**dict.fromkeys(LEAVES, 1), **dict.fromkeys(ENDS_EMULATION, 2)}
    return sorted(drawn, key=lambda fault: order.get(fault.kind, 0))


@dataclass(frozen=True)
class Verdict:
    """How a fault went: the worst time to zero of whoever had to stop (s); what went wrong, empty if nothing."""

    team: str
    kind: str
    robot: str | None
    worst_s: float | None
    wrong: tuple[str, ...]

"""Inchworm scan: robots that see common ground scan it, then one moves to the edge of what is scanned, by turns.

On open ground the thesis's next poses, in any direction of travel, are among the candidates; before obstacles others
win. Which it is, the ground to be mapped in the time decides.

Source: thesis section 6.2.1 and Fig 6.1.
"""

from __future__ import annotations

import math

import numpy as np

from baselines.common_view import GROUND_RANGE_M
from baselines.frontier import NearestFrontier
from baselines.inchworm_poses import scan_sequence
from baselines.next_view import AGAIN, OBSERVER, Move, best_pair, options_of, outlook_of, unmeasured
from baselines.rasters import Tries, Watcher
from baselines.surveying import Surveying
from baselines.ways import Ways
from coop_envs.mapping.planning import Points
from coop_envs.policy import Actions, Observations, TeamDescription, TeamNeeds

DIRECTIONS = 8


class InchwormScan:
    """The thesis's mapping motion, for any team with two cameras and a laser, in any world.

    ``view_rad`` replaces the cameras' field of view, for cameras whose images are not flat (4 pi / 3 in the thesis).
    """

    name = "inchworm_scan"
    needs = TeamNeeds(cameras=2, hats=2, lasers=1)

    def __init__(self, view_rad: float | None = None) -> None:
        self._view_rad = view_rad

    def reset(self, team: TeamDescription, seed: int) -> None:
        self._surveying = Surveying(team, NextBestPair(), seed, self._view_rad)

    def act(self, observations: Observations) -> Actions:
        return self._surveying.act(observations)


class NextBestPair:
    """Moves the robot that, with a mate, then sees most new ground for its time.

    Where nothing is worth it, the nearest frontier may lead to where something is.
    """

    def __init__(self) -> None:
        self._fallback = NearestFrontier(pickets_first=True)

    def choose(self, ways: Ways, tries: Tries, last: str | None) -> Move | None:
        """The best of all movers, places, partners and headings."""
        ground = unmeasured(ways.survey, ways.watchers, tries)
        best: Move | None = None
        for mover in ways.watchers:
            mates = [watcher for watcher in ways.watchers if watcher is not mover]
            options = options_of(ways.routes(mover), mover, np.vstack([next_stands(mate) for mate in mates]))
            outlook = outlook_of(mover, options, ground, ways.survey.grid)
            favour = (AGAIN if mover.robot.name == last else 1.0) * (OBSERVER if mover.member.role == "observer" else 1)
            for partner in mates:
                if not (mover.member.laser or partner.member.laser):
                    continue
                choice = best_pair(mover, options, outlook, partner, ground, ways.survey.grid)
                if choice is not None and (best is None or favour * choice.rate > best.worth):
                    node = options.nodes[choice.stand]
                    best = Move(
                        mover.robot.name, None if node is None else ways.routes(mover).path_to(node), choice.heading,
                        partner.robot.name, choice.partner_heading, favour * choice.rate, choice.aim,
                    )  # fmt: skip
        return best or self._fallback.choose(ways, tries, last)


def next_stands(mate: Watcher) -> Points:
    """Where (n, 2) the thesis's robot would stand next to a mate that stays, travelling in any direction."""
    (_, stays), (moved, _) = (scan.robots for scan in scan_sequence(2, GROUND_RANGE_M))
    ahead, aside = moved.x_m - stays.x_m, moved.y_m - stays.y_m
    turns = 2.0 * math.pi / DIRECTIONS * np.arange(DIRECTIONS)
    c, s = np.cos(turns), np.sin(turns)
    offsets = [np.stack([c * ahead - s * side, s * ahead + c * side], axis=-1) for side in (aside, -aside)]
    return np.array(mate.robot.xy) + np.concatenate(offsets)

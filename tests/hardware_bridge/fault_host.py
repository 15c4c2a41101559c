"""A host to break: a mission on the wall clock whose policy keeps everybody driving and fails when told to."""

from __future__ import annotations

import json
import math
import sys
import threading
import time
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from coop_envs.device import prepare
from coop_envs.policy import Actions, Observations, TeamDescription, TeamNeeds
from hardware_bridge.clocks import WallClock
from hardware_bridge.deployment import Deployment, load_deployment
from hardware_bridge.emulation import SimulatedOperator
from hardware_bridge.link import RobotLink
from hardware_bridge.mission import DEVICE, Mission
from hardware_bridge.preflight import connect_all
from hardware_bridge.runner import Crew, Runner, Tick
from hardware_bridge.safety import stopped_commands
from hardware_bridge.safety.watchdog import Watchdog, WatchdogTrip
from hardware_bridge.session import WATCHDOG_S
from hardware_bridge.wiring import make_crew

COASTS_S = 5.0


class Circles:
    """Everybody drives in a circle of its own, until told to ``rest`` or to break in a ``way``."""

    name = "circles"
    needs = TeamNeeds()

    def __init__(self) -> None:
        self.way: str | None = None
        self.rest = False
        self.hangs_since: float | None = None

    def reset(self, team: TeamDescription, seed: int) -> None:
        self._names = team.names

    def act(self, observations: Observations) -> Actions:
        drive = np.array([-1.0, 0.5, 0.8, 0, 0, 0, 0, 0.5], dtype=np.float32)
        drive[0] = 1.0 if self.rest else -1.0
        actions = {name: drive.copy() for name in observations}
        first = next(iter(actions))
        match self.way:
            case "nan":
                actions[first][1] = math.nan
            case "exception":
                raise RuntimeError("out of ideas")
            case "shape":
                actions[first] = drive[:3]
            case "left out":
                del actions[first]
            case "hang":
                self._wait(2.0)
            case "slow":
                self._wait(0.45)
        return actions

    def _wait(self, seconds: float) -> None:
        self.hangs_since = self.hangs_since or time.monotonic()
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.way is not None:
            time.sleep(0.01)


@dataclass(frozen=True)
class Told:
    """Whom the host told to stand at ``at`` (monotonic)."""

    at: float
    stands: tuple[bool, ...]


class Host:
    """A mission on the wall clock in a thread, as `session.prepared` makes one, for an emulation that stays."""

    def __init__(self, deployment: Deployment, address: tuple[str, int]) -> None:
        self.policy, self.told, self.trips = Circles(), list[Told](), dict[str, list[float]]()
        self._ending = threading.Event()
        self._mission = Mission(deployment, self.policy, 0)
        clock = WallClock()
        links, cameras = make_crew(deployment, address, clock.now_s)
        self.names = list(links)
        connect_all(links, cameras, str)
        self._crew = Crew(dict(links), dict(cameras))
        self._rest(links.values())
        self._operator = SimulatedOperator(address)
        watchdog = Watchdog(links, WATCHDOG_S, self._trip)
        self.runner = Runner(
            self._mission, self._crew, clock, self._operator, watchdog, watch=self._seen, stopped=self._ending.is_set
        )
        self.ended: str | None = None
        self._thread = threading.Thread(target=self._run)

    def _rest(self, links: Collection[RobotLink]) -> None:
        """Wait until all stand: one that was left running coasts."""
        end = time.monotonic() + COASTS_S
        stand = False
        while not stand and time.monotonic() < end:
            for link, still in zip(links, stopped_commands(len(links)), strict=True):
                link.send(still)
            time.sleep(0.2)
            newest = [samples[-1] for link in links if (samples := link.read())]
            stand = len(newest) == len(links) and all(max(map(abs, s.wheels_rad_s)) < 0.1 for s in newest)

    def start(self) -> None:
        """Set out."""
        self._thread.start()

    @property
    def whole(self) -> bool:
        """Whether it runs and nobody has left."""
        return self._thread.is_alive() and set(self._crew.links) == set(self.names)

    def close(self) -> None:
        self.policy.way = None
        self._ending.set()
        self._thread.join()
        self._operator.close()

    def _run(self) -> None:
        try:
            self.ended = self.runner.run()
        except BaseException as error:
            self.ended = f"{type(error).__name__}: {error}"
            raise

    def _trip(self, trip: WatchdogTrip) -> None:
        self.trips.setdefault(trip.robot, []).append(time.monotonic())

    def _seen(self, tick: Tick) -> None:
        stands = tuple(safe.command.stands for safe in tick.outcome.safe)
        self.told.append(Told(time.monotonic(), stands))


def main(settings: str, host: str, port: str) -> None:
    """Drive everybody until somebody ends the process: ``python -m ... SETTINGS HOST PORT``."""
    prepare(DEVICE)
    Host(load_deployment(json.loads(settings)), (host, int(port))).start()


if __name__ == "__main__":
    main(*sys.argv[1:])

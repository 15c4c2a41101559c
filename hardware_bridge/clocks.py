"""The host's clock of a mission: the wall's, or a simulator's in lock-step."""

from __future__ import annotations

import time
from typing import Protocol

from hardware_bridge.simulator_client import SimulatorClient

SETTLE_S = 0.1
ADVANCE_S = 10.0


class MissionClock(Protocol):
    """Seconds since the mission's clock was made, and waiting for the next tick.

    ``patience_s`` is how long, on the wall's clock, a tick waits for the report of each robot that is due.
    """

    patience_s: float

    def now_s(self) -> float:
        """The time now."""
        ...

    def wait_until(self, time_s: float) -> None:
        """Return when it is ``time_s`` or later."""
        ...


class WallClock:
    """Real time."""

    patience_s = 0.0

    def __init__(self) -> None:
        self._origin_s = time.monotonic()

    def now_s(self) -> float:
        """Seconds since the clock was made."""
        return time.monotonic() - self._origin_s

    def wait_until(self, time_s: float) -> None:
        """Sleep."""
        time.sleep(max(time_s - self.now_s(), 0.0))


class LockstepClock:
    """A simulator's time, which passes only while somebody waits for it.

    Raises:
        LinkError: when waiting, if the simulator does not answer.
    """

    patience_s = SETTLE_S

    def __init__(self, simulator: SimulatorClient, tick_s: float) -> None:
        self._simulator, self._tick_s = simulator, tick_s
        self._tick = 0

    def now_s(self) -> float:
        """The simulator's time at the end of the tick that was last asked for."""
        return self._tick * self._tick_s

    def wait_until(self, time_s: float) -> None:
        """Let the simulator run up to the tick at ``time_s``."""
        tick = round(time_s / self._tick_s)
        if tick > self._tick:
            self._tick = tick  # reports of this tick may arrive before the answer
            reached = -1
            while reached < tick:  # where the machine is busy the last question's second answer may come first
                answer = self._simulator.ask({"kind": "advance", "tick": tick}, "advanced", ADVANCE_S)
                reached = int(answer["tick"])

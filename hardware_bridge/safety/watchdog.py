"""The watchdog: stops every robot when the runner falls silent, from threads of its own.

One thread a robot, so that a link that blocks delays no other; nothing is locked, so that a frozen runner holds up none
of them. It uses real time, whatever clock the mission runs on. It cannot help when the whole process stands still
(stopped by a signal, or in foreign code that keeps the interpreter's lock): then only a robot's own timeout stops it.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from coop_envs.errors import require

REPEAT_S = 0.1
"""Between one stop and the next, while the silence lasts."""


class Stoppable(Protocol):
    """What the watchdog needs of a `RobotLink`."""

    def stop(self) -> None:
        """Tell the robot to stand, now; never raises."""
        ...


@dataclass(frozen=True)
class WatchdogTrip:
    """A robot was stopped because the runner had been silent for ``silent_s``; the call returned after ``took_s``."""

    robot: str
    silent_s: float
    took_s: float


class Watchdog:
    """Watches from the first `feed` until `close`.

    After ``timeout_s`` of silence it calls ``stop`` on every link, and again every 0.1 s until it is fed or paused. The
    first stop of each robot in a silence goes to ``log``, which is called from the watchdog's threads.

    Raises:
        ConfigError: a timeout that is not above 0.
    """

    def __init__(
        self, links: Mapping[str, Stoppable], timeout_s: float = 0.25, log: Callable[[WatchdogTrip], None] | None = None
    ) -> None:
        require(timeout_s > 0, "watchdog.timeout_s", timeout_s, "more than 0 s")
        self._timeout_s, self._log = timeout_s, log
        self._fed_s: float | None = None
        self._closed = threading.Event()
        self._threads = [
            threading.Thread(target=self._watch, args=(name, link), name=f"watchdog {name}", daemon=True)
            for name, link in links.items()
        ]
        for thread in self._threads:
            thread.start()

    def feed(self) -> None:
        """The runner is alive: it has sent every robot its command of this tick."""
        self._fed_s = time.monotonic()

    def pause(self) -> None:
        """Expect nothing until the next `feed`."""
        self._fed_s = None

    def close(self) -> None:
        """Watch no more; never raises. The links are left as they are."""
        self._closed.set()
        for thread in self._threads:
            thread.join(timeout=REPEAT_S)

    def __enter__(self) -> Watchdog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _watch(self, name: str, link: Stoppable) -> None:
        """One robot's thread."""
        tripped_at: float | None = None
        wait_s = 0.0
        while not self._closed.wait(wait_s):
            fed_s = self._fed_s
            if fed_s is None:
                wait_s = 0.5 * self._timeout_s
                continue
            now_s = time.monotonic()
            if now_s - fed_s < self._timeout_s:
                wait_s = self._timeout_s - (now_s - fed_s)
                continue
            with contextlib.suppress(Exception):
                link.stop()
            if tripped_at != fed_s:
                tripped_at = fed_s
                self._tell(WatchdogTrip(name, now_s - fed_s, time.monotonic() - now_s))
            wait_s = REPEAT_S

    def _tell(self, trip: WatchdogTrip) -> None:
        with contextlib.suppress(Exception):
            if self._log is not None:
                self._log(trip)

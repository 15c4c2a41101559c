"""The watchdog on real sockets: zeros come in time, whatever the runner and the other links do."""

from __future__ import annotations

import itertools
import socket
import subprocess
import sys
import threading
import time

import pytest

from coop_envs.errors import ConfigError
from hardware_bridge.safety import Watchdog

SLACK_S = 0.2
"""For a machine that has other things to do; on an idle one the stops come 0.25 s after the last feed."""
ZEROS = b"stop"


class SocketLink:
    """The part of a link that a watchdog uses, over a real pair of sockets; the far end notes when zeros come."""

    def __init__(self, name: str) -> None:
        self.name, self.arrived = name, []
        self._near, self._far = socket.socketpair()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        while self._far.recv(len(ZEROS)):
            self.arrived.append(time.monotonic())

    def stop(self) -> None:
        self._near.sendall(ZEROS)


class StuckLink(SocketLink):
    """Nobody reads at the far end and the buffer is full: `stop` blocks for ever."""

    def _listen(self) -> None:
        pass

    def stop(self) -> None:
        while True:
            self._near.sendall(bytes(1 << 16))


class BrokenLink(SocketLink):
    """Breaks the promise never to raise."""

    def stop(self) -> None:
        super().stop()
        raise OSError("unplugged")


def until(condition, timeout_s=3.0):
    end = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    assert condition()


def fed_then_frozen(dog, feeds=12):
    """A runner's thread that freezes after so many ticks; when it last fed the dog."""
    times = []

    def run():
        for _ in range(feeds):
            dog.feed()
            times.append(time.monotonic())
            time.sleep(1 / 30)
        time.sleep(3600)

    threading.Thread(target=run, daemon=True).start()
    until(lambda: len(times) == feeds)
    return times[-1]


def test_a_frozen_runner_is_followed_by_zeros_within_0_3_s():
    links = {name: SocketLink(name) for name in ("observer_0", "picket_0", "picket_1")}
    trips = []
    with Watchdog(links, log=trips.append) as dog:
        last_s = fed_then_frozen(dog)
        until(lambda: all(len(link.arrived) >= 3 for link in links.values()))
    for link in links.values():
        assert 0.25 - 0.01 <= link.arrived[0] - last_s <= 0.3 + SLACK_S
        gaps = [b - a for a, b in itertools.pairwise(link.arrived)]
        assert all(gap <= 0.1 + SLACK_S for gap in gaps), "and again every 0.1 s"
    assert sorted(trip.robot for trip in trips) == sorted(links), "each robot's first stop is told, once"
    assert all(0.25 <= trip.silent_s <= 0.3 + SLACK_S for trip in trips)


@pytest.mark.parametrize("bad", [StuckLink, BrokenLink])
def test_a_bad_link_delays_no_other(bad):
    links = {"bad": bad("bad"), "good": SocketLink("good")}
    with Watchdog(links) as dog:
        last_s = fed_then_frozen(dog, feeds=3)
        until(lambda: len(links["good"].arrived) >= 3)
        began = time.monotonic()
    assert links["good"].arrived[0] - last_s <= 0.3 + SLACK_S
    assert time.monotonic() - began < 1.0, "close does not wait for it"


def test_a_log_that_raises_stops_no_stops():
    link = SocketLink("a")

    def full(_):
        raise OSError("disk full")

    with Watchdog({"a": link}, log=full) as dog:
        dog.feed()
        until(lambda: len(link.arrived) >= 3)


def test_quiet_before_the_first_feed_and_while_paused_and_once_closed():
    link = SocketLink("a")
    with Watchdog({"a": link}) as dog:
        time.sleep(0.4)
        dog.feed()
        dog.pause()
        time.sleep(0.4)
        assert link.arrived == []
        dog.feed()
        until(lambda: len(link.arrived) >= 1)
    time.sleep(0.15)
    stops = len(link.arrived)
    time.sleep(0.3)
    assert len(link.arrived) == stops


def test_quiet_while_it_is_fed_and_awake_again_after():
    link = SocketLink("a")
    with Watchdog({"a": link}, timeout_s=0.6) as dog:
        for _ in range(30):
            dog.feed()
            time.sleep(1 / 30)
        assert link.arrived == []
        until(lambda: len(link.arrived) >= 1)
        dog.feed()
        before = len(link.arrived)
        until(lambda: len(link.arrived) > before)


def test_it_does_not_keep_a_process_alive():
    program = (
        "from hardware_bridge.safety import Watchdog\n"
        "class Link:\n    def stop(self): import time; time.sleep(3600)\n"
        "dog = Watchdog({'a': Link()}, timeout_s=0.01)\ndog.feed()\nimport time; time.sleep(0.1)\n"
    )
    assert subprocess.run([sys.executable, "-c", program], timeout=30, check=False).returncode == 0


def test_refuses_a_timeout_of_nothing():
    with pytest.raises(ConfigError, match=r"^watchdog.timeout_s: got 0.0, expected more than 0 s$"):
        Watchdog({}, timeout_s=0.0)

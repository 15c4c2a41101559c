"""The wall's clock never goes back; a simulator's passes only when it is asked to."""

from __future__ import annotations

import socket
import threading

import pytest

from hardware_bridge import clocks
from hardware_bridge.clocks import LockstepClock, WallClock
from hardware_bridge.link import LinkError
from hardware_bridge.protocols.datagrams import decode, encode
from hardware_bridge.simulator_client import SimulatorClient

TICK_S = 1 / 30


def test_the_wall_clock_begins_at_zero_and_waits():
    clock = WallClock()
    before = clock.now_s()
    assert 0.0 <= before < 1.0
    clock.wait_until(before + 0.05)
    assert clock.now_s() >= before + 0.05
    clock.wait_until(0.0)


class Echo:
    """A simulator that takes every question down and answers as it is told."""

    def __init__(self, answer):
        self.asked, self._answer, self._over = [], answer, threading.Event()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self.address = self._socket.getsockname()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _run(self):
        while not self._over.is_set():
            try:
                data, sender = self._socket.recvfrom(1000)
            except TimeoutError:
                continue
            message = decode(data)
            assert message is not None
            self.asked.append(message["tick"])
            for tick in self._answer(message["tick"]):
                self._socket.sendto(encode({"kind": "advanced", "tick": tick}), sender)


def test_simulated_time_is_what_was_asked_for():
    with Echo(lambda tick: [tick]) as echo:
        client = SimulatorClient(echo.address)
        clock = LockstepClock(client, TICK_S)
        for k in range(1, 8):
            clock.wait_until(k * TICK_S)
            assert clock.now_s() == pytest.approx(k * TICK_S)
        clock.wait_until(3 * TICK_S)
        clock.wait_until(9 * TICK_S)
        assert echo.asked == [1, 2, 3, 4, 5, 6, 7, 9]
        client.close()


def test_a_second_answer_to_the_last_question_is_none_to_the_next():
    """A slow simulator is asked twice and answers twice; taken for the next tick's, it would set the clock ahead."""
    reached: list[int] = []

    def answer(tick):
        late = tick not in reached and tick > 1
        reached.append(tick)
        return [tick - 1] if late else [tick]

    with Echo(answer) as echo:
        client = SimulatorClient(echo.address)
        clock = LockstepClock(client, TICK_S)
        for k in range(1, 6):
            clock.wait_until(k * TICK_S)
        assert reached == [1, 2, 2, 3, 3, 4, 4, 5, 5]
        client.close()


def test_a_simulator_that_is_gone_is_told(monkeypatch):
    monkeypatch.setattr(clocks, "ADVANCE_S", 0.3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        client = SimulatorClient(deaf.getsockname())
        with pytest.raises(LinkError, match="expected a running simulator"):
            LockstepClock(client, TICK_S).wait_until(1.0)
        client.close()

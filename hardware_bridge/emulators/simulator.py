"""The simulator as a process of its own: robots' firmware, or robots that speak its datagrams, reach it over UDP.

On the wall clock a tick passes every ``tick_s``; set-points that arrived before its end apply to it. In lock-step it
waits to be asked, so that hours pass in minutes and nothing depends on how busy the machine is.
"""

from __future__ import annotations

import contextlib
import random
import select
import socket
import time
from collections.abc import Callable
from typing import Any

from hardware_bridge.emulators.emulated_world import EmulatedWorld
from hardware_bridge.protocols.datagrams import MAX_BYTES, Datagram, decode, encode

Address = tuple[str, int]
CATCH_UP_S = 2.0
"""What was missed on the wall clock while the machine was busy is made good, up to this; then robots' clocks slip."""
COMMANDS_S = 0.05
"""How long lock-step waits for a robot's set-points before it goes on with the last."""


class SimulatorServer:
    """Serves one world until `stopped` says so."""

    def __init__(self, world: EmulatedWorld, *, lockstep: bool, port: int = 0) -> None:
        self.world, self.lockstep = world, lockstep
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.bind(("127.0.0.1", port))
        self._listeners: dict[Address, int] = {}
        self._told: set[int] = set()
        self._faults: dict[int, str] = {}
        self._target: tuple[int, Address] | None = None

    @property
    def address(self) -> Address:
        """Where it listens."""
        host, port = self._socket.getsockname()
        return host, port

    def serve(self, stopped: Callable[[], bool]) -> None:
        """Run until stopped, then let go of the socket."""
        with self._socket:
            self._serve(stopped)

    def _serve(self, stopped: Callable[[], bool]) -> None:
        due = time.monotonic() + self.world.tick_s
        asked_at = 0.0
        while not stopped():
            if self.lockstep:
                before = self._target
                self._listen(0.05 if self._target is None else 0.002)
                if self._target is not None and before is None:
                    asked_at = time.monotonic()
                if self._target is not None and self._may_step(asked_at):
                    asked_at = self._advance(asked_at)
            else:
                self._listen(max(due - time.monotonic(), 0.0))
                if time.monotonic() >= due:
                    self._step()
                    due = max(due + self.world.tick_s, time.monotonic() - CATCH_UP_S)

    def begin(self, robot: int, fault: str) -> None:
        """Begin a fault of a robot that has no firmware of its own: freeze, silent, garbage; any other heals it."""
        self._faults[robot] = fault

    def _may_step(self, asked_at: float) -> bool:
        waiting = {r for r in set(self._listeners.values()) if self.world.powered[r]} - self._told
        return not waiting or time.monotonic() - asked_at > COMMANDS_S

    def _advance(self, asked_at: float) -> float:
        assert self._target is not None
        tick, asker = self._target
        if self.world.tick < tick:
            self._step()
            asked_at = time.monotonic()
        if self.world.tick >= tick:
            self._target = None
            self._answer(asker, {"kind": "advanced", "tick": self.world.tick})
        return asked_at

    def _step(self) -> None:
        self.world.step()
        self._told.clear()
        states: dict[int, bytes] = {}
        for address, robot in self._listeners.items():
            fault = self._faults.get(robot)
            if fault in ("freeze", "silent"):
                continue
            if robot not in states:
                garbage = fault == "garbage"
                states[robot] = random.randbytes(100) if garbage else encode(self.world.state_of(robot))
            self._send(states[robot], address)

    def _listen(self, timeout_s: float) -> None:
        """Take in every message that comes until the time is over, or, in lock-step, until one came."""
        end = time.monotonic() + timeout_s
        while True:
            left = end - time.monotonic()
            if not select.select([self._socket], [], [], max(left, 0.0))[0]:
                return
            data, sender = self._socket.recvfrom(MAX_BYTES)
            message = decode(data)
            if message is not None:
                self._take(message, sender)
            if self.lockstep and not select.select([self._socket], [], [], 0.0)[0]:
                return

    def _take(self, message: Datagram, sender: Address) -> None:
        kind, named = message["kind"], message.get("robot")
        robot = named if isinstance(named, int) and 0 <= named < len(self.world.set_points) else None
        if kind == "set" and robot is not None:
            if self._faults.get(robot) != "freeze":
                self.world.set_points[robot].take(message)
            self._told.add(robot)
        elif kind == "hello" and named == robot:
            if robot is not None:
                self._listeners[sender] = robot
            self._answer(sender, self._welcome(robot))
        elif kind == "operator":
            self.world.operate(message)
        elif kind == "advance" and isinstance(message.get("tick"), int):
            self._target = message["tick"], sender
        elif kind == "truth":
            self._answer(sender, self.world.truth())
        else:
            self._answer(sender, {"kind": "error", "text": f"{kind}: got robot {named}, expected one of the team"})

    def _welcome(self, robot: int | None) -> dict[str, Any]:
        name = None if robot is None else self.world.scenario.team.members[robot].name
        return {"kind": "welcome", "robot": robot, "name": name, "tick": self.world.tick, "tick_s": self.world.tick_s}

    def _answer(self, to: Address, message: Datagram) -> None:
        self._send(encode(message), to)

    def _send(self, data: bytes, to: Address) -> None:
        """What cannot be sent is lost, as on any network."""
        with contextlib.suppress(OSError):
            self._socket.sendto(data, to)

"""What emulated robots on serial lines share: a process between a simulator and a pseudo-terminal.

    python -m hardware_bridge.emulators.zumy_firmware --simulator HOST:PORT --robot K
        [--port-link PATH] [--quirks JSON] [--lock-step]

When it can be reached it prints ``{"ready": true, "port": "/dev/pts/7"}``. Each line on its standard input is a fault
as in `quirks.FaultCommand`, such as ``{"fault": "freeze"}``; at the end of its input it ends. A robot without power
hears nothing and says nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import select
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

from coop_envs.errors import CoopError, require
from coop_envs.validation import validated
from hardware_bridge.emulators.pty_port import PtyPort
from hardware_bridge.emulators.quirks import FaultCommand, Quirks, Wire
from hardware_bridge.protocols.datagrams import Datagram
from hardware_bridge.simulator_client import SimulatorClient

IDLE_S = 0.1
STDIN = 0


class Firmware(Protocol):
    """What a robot does with bytes and with what its sensors see; both give pieces to say."""

    def hear(self, data: bytes) -> list[bytes]:
        """Bytes came over the wire."""
        ...

    def sense(self, state: Datagram) -> list[bytes]:
        """The simulator told a new state."""
        ...


class RobotTime:
    """True time as the robot lives it: the simulator's, and on the wall clock what has passed since it last told."""

    def __init__(self, quirks: Quirks, lockstep: bool, start_s: float = 0.0) -> None:
        self._quirks, self._lockstep, self._jumped_s = quirks, lockstep, 0.0
        self._told_s, self._told_at = start_s, time.monotonic()

    @property
    def true_s(self) -> float:
        """The simulator's time when it last told."""
        return self._told_s

    def told(self, time_s: float) -> None:
        """The simulator's time now."""
        self._told_s, self._told_at = time_s, time.monotonic()

    def jump(self, jump_s: float) -> None:
        """Set the robot's clock ahead or back."""
        self._jumped_s += jump_s

    def sampled_us(self) -> int:
        """The robot's clock when the simulator last told a state."""
        return self._quirks.device_us(self._told_s, self._jumped_s)

    def now_us(self) -> int:
        """The robot's clock."""
        since_s = 0.0 if self._lockstep else time.monotonic() - self._told_at
        return self._quirks.device_us(self._told_s + since_s, self._jumped_s)


class FirmwareProcess:
    """Carries bytes between the port and the firmware, through wires on which things go wrong."""

    def __init__(
        self, port: PtyPort, client: SimulatorClient, clock: RobotTime, firmware: Firmware, quirks: Quirks
    ) -> None:
        self._port, self._client, self._clock, self._firmware = port, client, clock, firmware
        self._chance = random.Random(quirks.seed)
        self._heard, self._said = Wire(quirks, self._chance), Wire(quirks, self._chance)
        self._faults: set[str] = set()
        self._powered, self._input = True, b""

    def run(self) -> None:
        """Serve until the standard input ends."""
        while self._serve(self._idle_s()):
            pass

    def _serve(self, timeout_s: float) -> bool:
        ends = [STDIN, self._client.fileno(), *([self._port.fileno()] if self._port.plugged else [])]
        ready = select.select(ends, [], [], timeout_s)[0]
        if STDIN in ready and not self._take_faults():
            return False
        if self._client.fileno() in ready:
            for message in self._client.poll():
                if message["kind"] == "state":
                    self._sense(message)
        if self._port.plugged and self._port.fileno() in ready:
            data = self._port.read()
            if self._alive:
                self._heard.put(data, time.monotonic())
        for data in self._heard.take(time.monotonic()):
            if self._alive:
                self._say(self._firmware.hear(data))
        for data in self._said.take(time.monotonic()):
            self._port.write(data)
        return True

    @property
    def _alive(self) -> bool:
        return self._powered and "freeze" not in self._faults

    def _idle_s(self) -> float:
        now_s = time.monotonic()
        waits = [wait for wait in (self._heard.wait_s(now_s), self._said.wait_s(now_s)) if wait is not None]
        return min([IDLE_S, *waits])

    def _sense(self, state: Datagram) -> None:
        self._powered = state.get("powered") is True
        self._clock.told(float(state.get("time_s", 0.0)))
        if self._alive:
            self._say(self._firmware.sense(state))
            if "garbage" in self._faults:
                self._said.put(self._chance.randbytes(30), time.monotonic())

    def _say(self, pieces: Sequence[bytes]) -> None:
        if "silent" in self._faults:
            return
        for piece in pieces:
            noise = "garbage" in self._faults
            self._said.put(self._chance.randbytes(len(piece)) if noise else piece, time.monotonic())

    def _take_faults(self) -> bool:
        """Begin the faults that the standard input tells; whether it goes on."""
        data = os.read(STDIN, 4096)
        *lines, self._input = (self._input + data).split(b"\n")
        for line in filter(None, lines):
            try:
                self._begin(validated(FaultCommand, json.loads(line)))
            except (ValueError, CoopError) as error:
                print(f"fault: got {line!r}, expected a fault: {error}", file=sys.stderr)  # noqa: T201
        return bool(data)

    def _begin(self, command: FaultCommand) -> None:
        match command.fault:
            case "heal":
                self._faults.clear()
                for wire in (self._heard, self._said):
                    wire.late_s = 0.0
                    wire.clear()
                self._port.plug()
            case "late":
                self._heard.late_s = self._said.late_s = command.delay_s
            case "unplug":
                self._port.unplug()
            case "clock_jump":
                self._clock.jump(command.jump_s)
            case _:
                self._faults.add(command.fault)


Maker = Callable[[SimulatorClient, RobotTime, argparse.Namespace], Firmware]


def main(make: Maker, parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None) -> int:
    """Run firmware that ``make`` makes; ``parser`` may hold options of its own.

    Returns: 0, or 2 for what cannot be used.
    """
    parser.add_argument("--simulator", required=True, metavar="HOST:PORT")
    parser.add_argument("--robot", required=True, type=int, help="its place in the simulator's team, from 0")
    parser.add_argument("--port-link", type=Path, help="a symbolic link to make to the port")
    parser.add_argument("--quirks", default="{}", help="JSON with entries of Quirks")
    parser.add_argument("--lock-step", action="store_true", help="time is the simulator's alone")
    options = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # at Ctrl-C whoever started us stops the robot, then us
    try:
        _run(make, options)
    except CoopError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    return 0


def _run(make: Maker, options: argparse.Namespace) -> None:
    quirks = validated(Quirks, _json(options.quirks), "quirks")
    client = SimulatorClient(_address(options.simulator), options.robot)
    welcome = client.hello()
    clock = RobotTime(quirks, options.lock_step, float(welcome.get("tick", 0)) * float(welcome.get("tick_s", 0.0)))
    port = PtyPort(options.port_link)
    with contextlib.ExitStack() as stack:
        stack.callback(client.close)
        stack.callback(port.unplug)
        process = FirmwareProcess(port, client, clock, make(client, clock, options), quirks)
        print(json.dumps({"ready": True, "port": port.address}), flush=True)  # noqa: T201
        process.run()


def _json(text: str) -> object:
    try:
        return json.loads(text)
    except ValueError:
        require(False, "--quirks", text, "JSON")


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    require(bool(host) and port.isdigit(), "--simulator", text, "HOST:PORT")
    return host, int(port)

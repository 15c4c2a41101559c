"""A VelociRoACH's firmware behind an XBee radio, as its source describes it, on a pseudo-terminal.

Legs go only while a timed run lasts, at the speeds of the last velocity profile, and only once gains were set: until
then they are 0. Its radio tells positions, no IMU. ``--version`` is what it answers to WHO_AM_I; ``--hat`` is the
brightness of an LED hat on it, which the radio cannot change.
"""

from __future__ import annotations

import argparse
import struct
import sys
from collections.abc import Callable
from typing import Any

from hardware_bridge.emulators.firmware_process import RobotTime, main
from hardware_bridge.protocols.datagrams import Datagram
from hardware_bridge.protocols.roach_commands import (
    RAD_PER_COUNT,
    Kind,
    Payload,
    command_values,
    decode_payload,
    encode_payload,
    profile_speeds,
)
from hardware_bridge.protocols.xbee_frames import FrameParser, Received, Transmit, encode

VERSION = "emulated roach 1"
STANDING = [0.0, 0.0]


class VelociroachFirmware:
    """Hears frames, senses states of the simulator, and tells it set-points through ``tell``."""

    def __init__(
        self,
        tell: Callable[..., None],
        *,
        address: int = 0x2052,
        version: str = VERSION,
        start_s: float = 0.0,
    ) -> None:
        self._tell, self._address, self._version = tell, address, version
        self._parser = FrameParser()
        self._gains = (0,) * 10
        self._speeds = STANDING
        self._time_s = start_s
        self._runs_until_s: float | None = None
        self._angles, self._zero = (0.0, 0.0), (0, 0)

    def hear(self, data: bytes) -> list[bytes]:
        """What the frames in ``data`` that are for this robot make it say."""
        said = []
        for frame in self._parser.feed(data):
            payload = decode_payload(frame.data)
            if isinstance(frame, Transmit) and frame.destination == self._address and payload:
                answer = self._obey(payload)
                if answer is not None:
                    said.append(encode(Received(self._address, encode_payload(Payload(payload.kind, answer)))))
        return said

    def sense(self, state: Datagram) -> list[bytes]:
        """Where the legs are; a timed run whose time is over ends."""
        self._time_s, self._angles = float(state["time_s"]), (state["angles"][0], state["angles"][1])
        if self._runs_until_s is not None and self._time_s >= self._runs_until_s:
            self._stand()
        return []

    def _obey(self, payload: Payload) -> bytes | None:
        """Do what a command tells, and give the data of the answer, if there is one."""
        values = command_values(payload)
        if values is None:
            return None
        match payload.kind:
            case Kind.WHO_AM_I:
                return self._version.encode()
            case Kind.PID_GAINS:
                self._gains = values
                return payload.data
            case Kind.LEG_POSITIONS:
                return struct.pack("<2i", *self._positions())
            case Kind.ZERO_POSITION:
                before = self._positions()
                self._zero = self._counts()
                return struct.pack("<2i", *before)
            case Kind.VELOCITY_PROFILE:
                self._speeds = list(profile_speeds(values))
                self._drive()
            case Kind.TIMED_RUN:
                self._runs_until_s = self._time_s + values[0] * 1e-3
                self._drive()
            case Kind.STOP:
                self._stand()
        return None

    def _drive(self) -> None:
        if self._runs_until_s is not None and any(self._gains):
            self._tell(wheels=self._speeds)

    def _stand(self) -> None:
        self._runs_until_s = None
        self._tell(wheels=STANDING)

    def _counts(self) -> tuple[int, int]:
        left, right = (round(angle / RAD_PER_COUNT) for angle in self._angles)
        return left, right

    def _positions(self) -> tuple[int, int]:
        left, right = (
            (now - zero + 2**31) % 2**32 - 2**31 for now, zero in zip(self._counts(), self._zero, strict=True)
        )
        return left, right


def _make(client: Any, clock: RobotTime, options: argparse.Namespace) -> VelociroachFirmware:
    client.set(brightness=options.hat)
    start_s = clock.true_s
    return VelociroachFirmware(client.set, address=options.address, version=options.version, start_s=start_s)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--address", type=lambda text: int(text, 0), default=0x2052, help="16 bits of its radio")
    parser.add_argument("--version", default=VERSION)
    parser.add_argument("--hat", type=float, default=0.0, metavar="BRIGHTNESS")
    return parser


if __name__ == "__main__":
    sys.exit(main(_make, _parser()))

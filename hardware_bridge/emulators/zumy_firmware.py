"""A Zumy's firmware, as its source and its users describe it, on a pseudo-terminal.

Set-points latch: nothing stops the robot when the host falls silent. A poll without a fresh IMU sample is not answered.
A queue of four packets, of which the main loop takes one each millisecond (*assumed*), while a wire of 230400 baud
fills it. Laser in four duties. The simulator knows when the mirror still runs and drops moves that come meanwhile.

Lock-step has no wall clock by which a host could poll again, so a poll that comes too early waits for the sample there.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from typing import Any

from hardware_bridge.emulators.firmware_process import RobotTime, main
from hardware_bridge.protocols.datagrams import Datagram
from hardware_bridge.protocols.zumy_packets import (
    ACCEL_RANGE_G,
    AMPERES_PER_READING,
    BAUD,
    GYRO_RANGE_DEG_S,
    MAX_WHEEL_RAD_S,
    RAD_PER_TICK,
    STANDARD_GRAVITY_M_S2,
    VOLTS_PER_READING,
    Packet,
    PacketParser,
    Sensors,
    encode_sensors,
    encode_time,
    laser_duty,
)

QUEUE, PASS_S, BYTE_S = 4, 0.001, 10 / BAUD


class ZumyFirmware:
    """Hears packets, senses states of the simulator, and tells it set-points through ``tell``."""

    def __init__(self, tell: Callable[..., None], clock: RobotTime, holds_polls: bool) -> None:
        self.overflowed = 0
        self._tell, self._clock, self._holds_polls = tell, clock, holds_polls
        self._parser = PacketParser()
        self._fresh: Sensors | None = None
        self._polled, self._sequence = False, 0
        self._drained_at = time.monotonic()

    def hear(self, data: bytes) -> list[bytes]:
        """What the packets in ``data`` make it say."""
        now_s = time.monotonic()
        passes = (now_s - self._drained_at + len(data) * BYTE_S) / PASS_S
        room, self._drained_at = QUEUE + int(passes), now_s
        packets = self._parser.feed(data)
        self.overflowed += max(len(packets) - room, 0)
        return [answer for packet in packets[:room] if (answer := self._obey(packet))]

    def sense(self, state: Datagram) -> list[bytes]:
        """A fresh sample, said at once if a poll waits for it."""
        self._fresh = sensors_from(state, self._clock.sampled_us())
        return [self._report()] if self._polled else []

    def _obey(self, packet: Packet) -> bytes:
        """Do what a packet tells, and give the answer, if there is one."""
        self._sequence += 1
        values = packet.values
        if not all(math.isfinite(value) for value in values):
            return b""
        match packet.kind:
            case "C":
                self._tell(wheels=[min(max(w, -MAX_WHEEL_RAD_S), MAX_WHEEL_RAD_S) for w in values])
            case "M":
                self._tell(brightness=max(int(colour) >> s & 0xFF for colour in values for s in (16, 8, 0)) / 255)
            case "L":
                moves = {"galvo": [int(n) for n in values[1:]]} if any(values[1:]) else {}
                self._tell(laser=laser_duty(values[0]), **moves)
            case "R":
                self._tell(wheels=[0.0, 0.0], brightness=0.0, laser=0.0)
            case "T":
                return encode_time(self._clock.now_us(), self._sequence)
            case "G" if self._fresh is not None:
                return self._report()
            case "G":
                self._polled = self._holds_polls
        return b""

    def _report(self) -> bytes:
        assert self._fresh is not None
        sensors, self._fresh, self._polled = self._fresh, None, False
        return encode_sensors(sensors, self._sequence)


def sensors_from(state: Datagram, time_us: int) -> Sensors:
    """A state of the simulator in the firmware's units, within the IMU's ranges."""
    accel = (_within(v / STANDARD_GRAVITY_M_S2, ACCEL_RANGE_G) for v in state["accel"])
    gyro = (_within(math.degrees(v), GYRO_RANGE_DEG_S) for v in state["gyro"])
    (ax, ay, az), (gx, gy, gz) = accel, gyro
    left, right = (_wrapped(round(angle / RAD_PER_TICK)) for angle in state["angles"])
    volts = _within(state["voltage"] / VOLTS_PER_READING, 1.0)
    amperes = _within(state.get("current", 0.0) / AMPERES_PER_READING, 1.0)
    speeds = (state["wheels"][0], state["wheels"][1])
    return Sensors(time_us, (ax, ay, az), (gx, gy, gz), (left, right), speeds, volts, amperes)


def _within(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def _wrapped(ticks: int) -> int:
    return (ticks + 2**31) % 2**32 - 2**31


def _make(client: Any, clock: RobotTime, options: argparse.Namespace) -> ZumyFirmware:
    return ZumyFirmware(client.set, clock, options.lock_step)


if __name__ == "__main__":
    sys.exit(main(_make, argparse.ArgumentParser(description=__doc__)))

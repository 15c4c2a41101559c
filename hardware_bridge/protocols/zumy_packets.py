"""Packets of the Zumy's serial line: written, read, and found again after garbage.

Little-endian, no padding: start u8 = 0, length u8 (of the whole packet), type u8 (a letter), flags u8, sequence u32,
payload, CRC-8. A type has one length, the same in both directions.

Source: `mbed_zumy` [packet] ``protocol.h``, ``packet_parser.cpp``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from hardware_bridge.protocols.crc8 import crc8

BAUD = 230400
HEADER_BYTES, CRC_BYTES = 8, 1
LEDS = 6
MAX_WHEEL_RAD_S = 50.0
TICKS_PER_TURN = 1200
RAD_PER_TICK = 2 * math.pi / TICKS_PER_TURN
STANDARD_GRAVITY_M_S2 = 9.80665
VOLTS_PER_READING = 3.3 * 3.0
AMPERES_PER_READING = 3.3 * 0.6
ACCEL_RANGE_G, GYRO_RANGE_DEG_S = 2.0, 250.0
LASER_DUTIES = (0.0, 0.3, 0.6, 1.0)
"""What the firmware makes of a laser command in 0..1: the entry at its whole thirds."""

PAYLOADS = {"C": "<2f", "G": "<i", "S": "<I3f3f2i2fff", "R": "<", "T": "<I", "M": "<6I", "L": "<f2h"}
SIZES = {kind: HEADER_BYTES + struct.calcsize(form) + CRC_BYTES for kind, form in PAYLOADS.items()}
MAX_BYTES = max(SIZES.values())


@dataclass(frozen=True)
class Packet:
    """A packet whose length and check value were right; ``values`` as listed in `PAYLOADS`."""

    kind: str
    flags: int
    sequence: int
    values: tuple[float, ...]


@dataclass(frozen=True)
class Sensors:
    """An S packet in its own units: g, deg/s, encoder ticks and rad/s (left, right), raw ADC readings 0..1."""

    time_us: int
    accel_g: tuple[float, float, float]
    gyro_deg_s: tuple[float, float, float]
    encoders: tuple[int, int]
    velocities_rad_s: tuple[float, float]
    voltage: float
    current: float


def encode(kind: str, *values: float, sequence: int = 0, flags: int = 0) -> bytes:
    """A packet of any type."""
    body = struct.pack("<BBcBI", 0, SIZES[kind], kind.encode(), flags, sequence & 0xFFFFFFFF)
    body += struct.pack(PAYLOADS[kind], *values)
    return body + bytes([crc8(body)])


def encode_wheels(left_rad_s: float, right_rad_s: float, sequence: int = 0) -> bytes:
    """C: speeds of the wheels; they hold until the next."""
    return encode("C", left_rad_s, right_rad_s, sequence=sequence)


def encode_poll(sequence: int = 0) -> bytes:
    """G: asks for one S; the period in it is ignored by the firmware."""
    return encode("G", 0, sequence=sequence)


def encode_time(time_us: int = 0, sequence: int = 0) -> bytes:
    """T: asks for, or tells, the robot's clock."""
    return encode("T", time_us & 0xFFFFFFFF, sequence=sequence)


def encode_markers(colours: Sequence[int], sequence: int = 0) -> bytes:
    """M: colours 0xRRGGBB of the six LEDs; those beyond ``colours`` are dark."""
    return encode("M", *colours, *(0,) * (LEDS - len(colours)), sequence=sequence)


def encode_laser(laser: float, galvo: tuple[int, int], sequence: int = 0) -> bytes:
    """L: laser in 0..1, and counts of 10 ms for which each mirror motor runs, by their signs."""
    return encode("L", laser, *galvo, sequence=sequence)


def encode_sensors(sensors: Sensors, sequence: int = 0, flags: int = 0) -> bytes:
    """S: what the robot answers to a poll."""
    rows = (*sensors.accel_g, *sensors.gyro_deg_s, *sensors.encoders, *sensors.velocities_rad_s)
    values = (sensors.time_us, *rows, sensors.voltage, sensors.current)
    return encode("S", *values, sequence=sequence, flags=flags)


def sensors_of(packet: Packet) -> Sensors | None:
    """An S packet's content, None for any other packet and for one that no robot can have sent.

    One in 256 damaged packets has a right check value; what lies outside the IMU's ranges, the converter's or twice the
    wheels' is damage.
    """
    v = packet.values
    if packet.kind != "S" or not all(math.isfinite(x) for x in v):
        return None
    counts = (int(v[7]), int(v[8]))
    sensors = Sensors(int(v[0]), (v[1], v[2], v[3]), (v[4], v[5], v[6]), counts, (v[9], v[10]), v[11], v[12])
    return sensors if _possible(sensors) else None


def _possible(sensors: Sensors) -> bool:
    ranges = [(sensors.accel_g, ACCEL_RANGE_G), (sensors.gyro_deg_s, GYRO_RANGE_DEG_S)]
    ranges += [(sensors.velocities_rad_s, 2 * MAX_WHEEL_RAD_S), ((sensors.voltage, sensors.current), 1.0)]
    return all(abs(value) <= 1.01 * most for values, most in ranges for value in values)


def laser_duty(command: float) -> float:
    """The duty at which the firmware drives the laser for a command."""
    if not command > 0:  # also nan
        return 0.0
    return LASER_DUTIES[int(min(command, 1.0) * 3)]


class PacketParser:
    """Finds packets in a stream.

    A packet is given once its last byte came. Where a start is not followed by a known type, its length and a right
    check value, the search goes on at the next byte, so the next whole packet is found whatever came before; a false
    start holds it back until at most `MAX_BYTES` bytes have come. ``dropped`` counts bytes that were in no packet.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that ``data`` completes. Never raises."""
        self._waiting += data
        packets, at, waiting = [], 0, self._waiting
        while at < len(waiting):
            size = _size(waiting, at)
            if size is None:
                break
            if size == 0 or crc8(waiting[at : at + size]):
                at, self.dropped = at + 1, self.dropped + 1
                continue
            packets.append(_decoded(bytes(waiting[at : at + size])))
            at += size
        del waiting[:at]
        return packets


def _size(data: bytearray, at: int) -> int | None:
    """Bytes of the packet that starts here: 0 where none does, None where that cannot be told yet."""
    head = data[at : at + 3]
    if head[0] != 0 or (len(head) > 1 and head[1] not in SIZES.values()):
        return 0
    if len(head) == 3 and SIZES.get(chr(head[2])) != head[1]:
        return 0
    return head[1] if len(head) == 3 and len(data) - at >= head[1] else None


def _decoded(packet: bytes) -> Packet:
    kind, flags, sequence = chr(packet[2]), packet[3], struct.unpack_from("<I", packet, 4)[0]
    return Packet(kind, flags, sequence, struct.unpack_from(PAYLOADS[kind], packet, HEADER_BYTES))

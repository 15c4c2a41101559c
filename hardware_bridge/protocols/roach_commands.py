"""Commands of the VelociRoACH's firmware, as its radio carries them: status u8, type u8, data; little-endian.

An older firmware has the same framing and gives 0x81, here "start motors", another meaning: closed-loop thrust of five
numbers. Whoever drives a robot asks `WHO_AM_I` first, and does not drive one whose version it does not know.

Legs as wheels. A crank turn is 65536 counts. A velocity profile holds a period (ms) and four steps (counts) that are
gone through in it; four steps of 0x4000 are a turn, a stride of each leg. Hence a speed of w rad/s is a sum of steps
of w / (2 pi) 65536 counts a second. That the four steps share the period evenly, that negative steps walk backwards
and that both cranks count up when walking forwards is *inferred*: the firmware's names and examples say so, no text
does.

Source: `roach` [master] ``firmware/source/cmd.h``, ``cmd.c``; `imageproc-lib` ``payload.c``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

COUNTS_PER_TURN = 65536
RAD_PER_COUNT = 2 * math.pi / COUNTS_PER_TURN
STRIDE_STEP = 0x4000
STEPS = 4
MAX_STEP = 32767
GYRO_RAD_S_PER_LSB = 0.00106585
ACCEL_M_S2_PER_LSB = 0.0023942
EXAMPLE_GAINS = (1800, 100, 100, 0, 0)
TELEMETRY = "<LL4l11h"


class Kind(IntEnum):
    """Types of payloads."""

    THRUST_OPEN_LOOP = 0x80
    START_MOTORS = 0x81
    PID_GAINS = 0x82
    LEG_POSITIONS = 0x84
    ERASE_TELEMETRY = 0x8A
    READ_TELEMETRY = 0x8B
    VELOCITY_PROFILE = 0x8D
    WHO_AM_I = 0x8E
    START_TELEMETRY = 0x8F
    ZERO_POSITION = 0x90
    TIMED_RUN = 0x91
    STOP = 0x92
    SET_PHASE = 0x93
    MOTOR_MODE = 0x94


FORMS = {
    Kind.THRUST_OPEN_LOOP: "<2h",
    Kind.START_MOTORS: "<",
    Kind.PID_GAINS: "<10h",
    Kind.LEG_POSITIONS: "<",
    Kind.ERASE_TELEMETRY: "<I",
    Kind.READ_TELEMETRY: "<I",
    Kind.START_TELEMETRY: "<I",
    Kind.VELOCITY_PROFILE: "<12h",
    Kind.WHO_AM_I: "<",
    Kind.ZERO_POSITION: "<",
    Kind.TIMED_RUN: "<H",
    Kind.STOP: "<",
    Kind.SET_PHASE: "<i",
    Kind.MOTOR_MODE: "<2h",
}
"""Data of the commands, host to robot."""


@dataclass(frozen=True)
class Payload:
    """What a frame carries: a status that nobody uses, a type, which may be unknown, and data."""

    kind: int
    data: bytes
    status: int = 0


@dataclass(frozen=True)
class Telemetry:
    """A record of the robot's flash, one a millisecond; positions and commanded ones in counts (left, right)."""

    index: int
    time_us: int
    positions: tuple[int, int]
    commanded: tuple[int, int]
    duties: tuple[int, int]
    gyro_rad_s: tuple[float, float, float]
    accel_m_s2: tuple[float, float, float]
    back_emf: tuple[int, int]
    battery: int


def encode_payload(payload: Payload) -> bytes:
    """The bytes of a payload."""
    return bytes([payload.status, payload.kind]) + payload.data


def decode_payload(data: bytes) -> Payload | None:
    """A payload, None for fewer than two bytes."""
    return Payload(data[1], data[2:], data[0]) if len(data) >= 2 else None


def encode_command(kind: Kind, *values: int) -> bytes:
    """The payload of a command."""
    return encode_payload(Payload(kind, struct.pack(FORMS[kind], *values)))


def command_values(payload: Payload) -> tuple[int, ...] | None:
    """The numbers in a command, None where the type is unknown or the data has another length."""
    form = FORMS.get(payload.kind)  # type: ignore[call-overload]
    if form is None or len(payload.data) != struct.calcsize(form):
        return None
    return struct.unpack(form, payload.data)


def encode_profile(legs_rad_s: Sequence[float], period_ms: int) -> bytes:
    """Both legs' velocity profiles over the same period, in four equal steps each; clipped to what 16 bits hold."""
    sides = [(period_ms, *(step_of(speed, period_ms),) * STEPS, 0) for speed in legs_rad_s]
    return encode_command(Kind.VELOCITY_PROFILE, *sides[0], *sides[1])


def step_of(speed_rad_s: float, period_ms: int) -> int:
    """Counts of each of a profile's four steps for a leg's speed."""
    step = round(speed_rad_s / RAD_PER_COUNT * period_ms * 1e-3 / STEPS)
    return max(-MAX_STEP, min(MAX_STEP, step))


def speed_of(steps: Sequence[int], period_ms: int) -> float:
    """A leg's mean speed in rad/s under a profile; 0 for a period that cannot be."""
    return sum(steps) * RAD_PER_COUNT / (period_ms * 1e-3) if period_ms > 0 else 0.0


def profile_speeds(values: Sequence[int]) -> tuple[float, float]:
    """Speeds (rad/s) of the left and right leg in a velocity profile's twelve numbers."""
    left, right = values[:6], values[6:]
    return speed_of(left[1:5], left[0]), speed_of(right[1:5], right[0])


def positions_of(payload: Payload) -> tuple[int, int] | None:
    """Counts of the left and right crank in an answer to `LEG_POSITIONS`, None for anything else."""
    if payload.kind != Kind.LEG_POSITIONS or len(payload.data) != 8:
        return None
    left, right = struct.unpack("<2i", payload.data)
    return left, right


def version_of(payload: Payload) -> str | None:
    """The version in an answer to `WHO_AM_I`, None for anything else or text that cannot be printed."""
    if payload.kind != Kind.WHO_AM_I:
        return None
    text = payload.data.split(b"\0")[0].decode("latin-1").strip()
    return text if text and text.isprintable() else None


def encode_telemetry(record: Telemetry) -> bytes:
    """A record as the flash holds it."""
    gyro = (round(v / GYRO_RAD_S_PER_LSB) for v in record.gyro_rad_s)
    accel = (round(v / ACCEL_M_S2_PER_LSB) for v in record.accel_m_s2)
    head = (record.index, record.time_us, *record.positions, *record.commanded)
    return struct.pack(TELEMETRY, *head, *record.duties, *gyro, *accel, *record.back_emf, record.battery)


def decode_telemetry(data: bytes) -> Telemetry | None:
    """A record of the robot's flash, None for data of another length."""
    if len(data) != struct.calcsize(TELEMETRY):
        return None
    v = struct.unpack(TELEMETRY, data)
    gyro = (v[8] * GYRO_RAD_S_PER_LSB, v[9] * GYRO_RAD_S_PER_LSB, v[10] * GYRO_RAD_S_PER_LSB)
    accel = (v[11] * ACCEL_M_S2_PER_LSB, v[12] * ACCEL_M_S2_PER_LSB, v[13] * ACCEL_M_S2_PER_LSB)
    return Telemetry(v[0], v[1], v[2:4], v[4:6], v[6:8], gyro, accel, v[14:16], v[16])

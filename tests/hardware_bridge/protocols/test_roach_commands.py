"""The VelociRoACH's commands: bytes worked out by hand, and speeds of legs from counts and milliseconds."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware_bridge.protocols.roach_commands import (
    EXAMPLE_GAINS,
    FORMS,
    STRIDE_STEP,
    Kind,
    Payload,
    Telemetry,
    command_values,
    decode_payload,
    decode_telemetry,
    encode_command,
    encode_payload,
    encode_profile,
    encode_telemetry,
    positions_of,
    profile_speeds,
    speed_of,
    version_of,
)


def test_bytes_by_hand():
    assert encode_command(Kind.STOP).hex() == "0092"
    assert encode_command(Kind.TIMED_RUN, 300).hex() == "00912c01"
    assert encode_command(Kind.SET_PHASE, 0x8000).hex() == "009300800000"
    gains = encode_command(Kind.PID_GAINS, *EXAMPLE_GAINS, *EXAMPLE_GAINS)
    assert gains.hex() == "0082" + "0807" + "6400" + "6400" + "0000" * 2 + "0807" + "6400" + "6400" + "0000" * 2


def test_a_profile_of_whole_strides_by_hand():
    # 10 turns a second on the left, backwards on the right: a turn in 100 ms
    profile = encode_profile((20 * math.pi, -20 * math.pi), 100)
    left = struct.pack("<6h", 100, *[0x4000] * 4, 0)
    right = struct.pack("<6h", 100, *[-0x4000] * 4, 0)
    assert profile == b"\x00\x8d" + left + right
    assert speed_of([STRIDE_STEP] * 4, 500) == pytest.approx(4 * math.pi)


@given(st.floats(-120, 120), st.floats(-120, 120))
def test_speeds_come_back_within_a_count(left, right):
    values = command_values(decode_payload(encode_profile((left, right), 100)) or Payload(0, b""))
    assert values is not None
    assert profile_speeds(values) == pytest.approx((left, right), abs=0.002)


def test_speeds_that_16_bits_cannot_hold_are_clipped():
    values = command_values(decode_payload(encode_profile((1e6, -1e6), 100)) or Payload(0, b""))
    assert values is not None and values[1] == 32767 and values[7] == -32767
    assert speed_of([1, 1, 1, 1], 0) == 0.0 and speed_of([1, 1, 1, 1], -5) == 0.0


@given(st.binary(max_size=130))
def test_no_payload_raises(data):
    payload = decode_payload(data)
    if payload is None:
        assert len(data) < 2
        return
    assert encode_payload(payload) == data
    values, positions = command_values(payload), positions_of(payload)
    assert values is None or struct.calcsize(FORMS[Kind(payload.kind)]) == len(payload.data)
    assert positions is None or len(payload.data) == 8
    assert version_of(payload) is None or payload.kind == Kind.WHO_AM_I


def test_answers():
    assert positions_of(Payload(Kind.LEG_POSITIONS, struct.pack("<2i", -5, 70000))) == (-5, 70000)
    assert version_of(Payload(Kind.WHO_AM_I, b"roach 1.2\0\xff")) == "roach 1.2"
    assert version_of(Payload(Kind.WHO_AM_I, b"\x01\x02")) is None


def test_a_telemetry_record_of_46_bytes():
    gyro, accel = (0.00106585, 0.0, -0.0106585), (0.0, 0.023942, 9.5768)
    record = Telemetry(3, 3000, (1, -1), (2, -2), (3800, -3800), gyro, accel, (5, -5), 900)
    data = encode_telemetry(record)
    assert len(data) == 46 and data[:8] == struct.pack("<LL", 3, 3000)
    back = decode_telemetry(data)
    assert back is not None and back.positions == (1, -1) and back.battery == 900 and back.duties == (3800, -3800)
    assert back.gyro_rad_s == pytest.approx(gyro) and back.accel_m_s2 == pytest.approx(accel)
    assert decode_telemetry(data[:-1]) is None

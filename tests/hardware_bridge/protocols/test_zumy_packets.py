"""The Zumy's packets against vectors worked out by hand, and its parser against damage of every kind."""

from __future__ import annotations

import struct

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hardware_bridge.protocols.crc8 import crc8
from hardware_bridge.protocols.zumy_packets import (
    MAX_BYTES,
    PAYLOADS,
    SIZES,
    Packet,
    PacketParser,
    Sensors,
    encode,
    encode_laser,
    encode_markers,
    encode_poll,
    encode_sensors,
    encode_time,
    encode_wheels,
    laser_duty,
    sensors_of,
)

REST = bytes([0xFF]) * MAX_BYTES
"""What lets a false start run out."""


@st.composite
def packets(draw):
    kind = draw(st.sampled_from(sorted(PAYLOADS)))
    whole = {"f": st.floats(width=32, allow_nan=False), "i": st.integers(-(2**31), 2**31 - 1)}
    numbers = whole | {"I": st.integers(0, 2**32 - 1), "h": st.integers(-(2**15), 2**15 - 1)}
    letters = struct.Struct(PAYLOADS[kind]).format.lstrip("<")
    spread = "".join(int(n or 1) * c for n, c in _runs(letters))
    values = [draw(numbers[c]) for c in spread]
    return encode(kind, *values, sequence=draw(st.integers(0, 2**32 - 1)), flags=draw(st.integers(0, 255)))


def _runs(letters):
    count = ""
    for c in letters:
        if c.isdigit():
            count += c
        else:
            yield count, c
            count = ""


def bytes_of(packet):
    return encode(packet.kind, *packet.values, sequence=packet.sequence, flags=packet.flags)


def test_the_check_value_of_crc8_dvb_s2():
    assert crc8(b"123456789") == 0xBC  # catalogue of CRC algorithms


@pytest.mark.parametrize(
    ("packet", "text"),
    [
        (encode_wheels(5, 5), "00114300000000000000a0400000a04002"),
        (encode_wheels(0, 0), "0011430000000000000000000000000015"),
        (encode_laser(1, (5, -5)), "00114c00000000000000803f0500fbff57"),
        (encode_poll(), "000d4700000000000000000058"),
    ],
)
def test_vectors(packet, text):
    assert packet.hex() == text


def test_sizes_are_those_of_the_table():
    assert SIZES == {"C": 17, "G": 13, "S": 61, "R": 9, "T": 13, "M": 33, "L": 17}
    assert len(encode("R")) == 9 and len(encode_time(2**32 + 5)) == 13
    assert PacketParser().feed(encode_time(2**32 + 5))[0].values == (5,)
    assert PacketParser().feed(encode_markers([0xFF0000, 0x00FF00]))[0].values == (0xFF0000, 0x00FF00, 0, 0, 0, 0)


def test_sensors_come_back():
    sensors = Sensors(4294967295, (0.0, 0.5, 1.0), (-1.0, 2.0, 250.0), (-7, 8), (1.5, -1.5), 0.75, 0.25)
    (packet,) = PacketParser().feed(encode_sensors(sensors, sequence=9, flags=3))
    assert sensors_of(packet) == sensors and packet.sequence == 9 and packet.flags == 3
    assert sensors_of(PacketParser().feed(encode_poll())[0]) is None
    bad = Sensors(0, (float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0), (0, 0), (0.0, 0.0), 0.0, 0.0)
    assert sensors_of(PacketParser().feed(encode_sensors(bad))[0]) is None


@pytest.mark.parametrize("k", [1, 4, 9, 11])
def test_what_no_robot_can_have_measured_is_damage(k):
    values = [0.0] * 13
    assert sensors_of(Packet("S", 0, 0, tuple(values))) is not None
    values[k] = 300.0
    assert sensors_of(Packet("S", 0, 0, tuple(values))) is None


def test_the_laser_is_quantised_in_thirds():
    commands = (-1.0, 0.0, 0.33, 1 / 3, 0.5, 0.67, 0.99, 1.0, 7.0, float("nan"))
    assert [laser_duty(c) for c in commands] == [0, 0, 0, 0.3, 0.3, 0.6, 0.6, 1.0, 1.0, 0]


@given(st.lists(packets(), max_size=6), st.integers(1, 70))
def test_packets_come_back_however_the_stream_is_cut(sent, cut):
    parser, stream, got = PacketParser(), b"".join(sent), []
    for at in range(0, len(stream), cut):
        got += parser.feed(stream[at : at + cut])
    assert [bytes_of(p) for p in got] == sent and parser.dropped == 0


@given(st.binary(max_size=600), st.integers(1, 100))
def test_no_bytes_raise_and_little_is_kept(data, cut):
    parser, used = PacketParser(), 0
    for at in range(0, len(data), cut):
        used += sum(SIZES[p.kind] for p in parser.feed(data[at : at + cut]))
        assert len(parser._waiting) < MAX_BYTES
    assert used + parser.dropped + len(parser._waiting) == len(data)


@given(st.binary(max_size=80).map(lambda b: b.replace(b"\0", b"\1")), packets())
def test_the_packet_after_garbage_is_found_at_once(garbage, packet):
    assert [bytes_of(p) for p in PacketParser().feed(garbage + packet)] == [packet]


@given(st.floats(-50, 50, width=32), st.integers(0, 8 * 17 - 1), st.integers(0, 2**32 - 1))
def test_a_flipped_bit_costs_one_packet(speed, bit, sequence):
    good = encode_wheels(1.0, -1.0, sequence=0x01010101)
    damaged = bytearray(encode_wheels(speed, speed, sequence=sequence))
    damaged[bit // 8] ^= 1 << bit % 8
    got = PacketParser().feed(bytes(damaged) + good + REST)
    assert bytes_of(got[-1]) == good
    assert all(p.kind != "C" or p.sequence != sequence for p in got[:-1])


@given(packets(), st.integers(1, MAX_BYTES), st.integers(1, 3))
def test_a_truncated_packet_costs_one_packet(cut_short, keep, count):
    good = [encode_wheels(k + 1.0, 1.0, sequence=0x01010101) for k in range(count)]
    stream = cut_short[: min(keep, len(cut_short) - 1)] + b"".join(good) + REST
    assume(crc8(stream[: len(cut_short)]) != 0)  # one in 256 is made whole by what follows
    got = PacketParser().feed(stream)
    assert [bytes_of(p) for p in got][-count:] == good


def test_a_false_start_holds_a_packet_back_by_less_than_the_longest():
    parser = PacketParser()
    assert parser.feed(encode("S", *[0] * 13)[:20] + encode_wheels(5, 5)) == []
    got = []
    for _ in range(3):
        got += parser.feed(encode_poll())
    assert [p.kind for p in got] == ["C", "G", "G", "G"]

"""XBee frames against a vector worked out by hand, and their parser against damage of every kind."""

from __future__ import annotations

from hypothesis import assume, given
from hypothesis import strategies as st

from hardware_bridge.protocols.roach_commands import Kind, encode_command
from hardware_bridge.protocols.xbee_frames import MAX_BYTES, MAX_DATA, FrameParser, Received, Transmit, encode

REST = bytes(MAX_BYTES)
U8, U16 = st.integers(0, 255), st.integers(0, 65535)
FRAMES = st.one_of(
    st.builds(Transmit, U16, st.binary(max_size=MAX_DATA), U8, U8),
    st.builds(Received, U16, st.binary(max_size=MAX_DATA), U8, U8),
)
GOOD = Transmit(0x2052, encode_command(Kind.TIMED_RUN, 300))


def test_the_vector_of_who_am_i():
    asked = encode(Transmit(0x2052, encode_command(Kind.WHO_AM_I)))
    assert asked.hex(" ").upper() == "7E 00 07 01 00 20 52 00 00 8E FE"


def test_a_received_frame_by_hand():
    (frame,) = FrameParser().feed(bytes.fromhex("7E 00 07 81 20 52 28 00 00 92 52".replace(" ", "")))
    assert frame == Received(0x2052, bytes([0x00, 0x92]), rssi=0x28)


@given(st.lists(FRAMES, max_size=5), st.integers(1, 150))
def test_frames_come_back_however_the_stream_is_cut(sent, cut):
    parser, stream, got = FrameParser(), b"".join(encode(f) for f in sent), []
    for at in range(0, len(stream), cut):
        got += parser.feed(stream[at : at + cut])
    assert got == sent and parser.dropped == 0


@given(st.binary(max_size=800), st.integers(1, 200))
def test_no_bytes_raise_and_little_is_kept(data, cut):
    parser, used = FrameParser(), 0
    for at in range(0, len(data), cut):
        used += sum(len(encode(f)) for f in parser.feed(data[at : at + cut]))
        assert len(parser._waiting) < MAX_BYTES
    assert used + parser.dropped + len(parser._waiting) == len(data)


@given(st.binary(max_size=200).map(lambda b: b.replace(b"\x7e", b"\1")), FRAMES)
def test_the_frame_after_garbage_is_found_at_once(garbage, frame):
    assert FrameParser().feed(garbage + encode(frame)) == [frame]


@given(st.integers(0, 8 * 13 - 1), st.integers(0, 65535))
def test_a_flipped_bit_costs_one_frame(bit, run_ms):
    damaged = bytearray(encode(Transmit(0x2052, encode_command(Kind.TIMED_RUN, run_ms))))
    damaged[bit // 8] ^= 1 << bit % 8
    got = FrameParser().feed(bytes(damaged) + encode(GOOD) + REST)
    assert got[-1] == GOOD and len(got) == 1


@given(FRAMES, st.integers(1, MAX_BYTES))
def test_a_truncated_frame_costs_one_frame(frame, keep):
    whole = encode(frame)
    stream = whole[: min(keep, len(whole) - 1)] + encode(GOOD) + REST
    assume(sum(stream[3 : len(whole)]) % 256 != 255)  # one in 256 is made whole by what follows
    got = FrameParser().feed(stream)
    assert got[-1] == GOOD

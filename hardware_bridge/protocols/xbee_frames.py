"""XBee frames in API mode 1 (not escaped), with 16-bit addresses: written, read, and found again after garbage.

0x7E, length u16 big-endian, content, checksum (0xFF minus the sum of the content). Sent: 0x01, frame id, destination
u16, options, data. Received: 0x81, source u16, signal strength, options, data. At most 125 bytes of data.

Source: `basestation` ``xbee_constants.h``, ``main.c``.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

START = 0x7E
TRANSMIT, RECEIVED = 0x01, 0x81
MAX_DATA = 125
HEAD_BYTES = 5
MAX_BYTES = 3 + HEAD_BYTES + MAX_DATA + 1


@dataclass(frozen=True)
class Transmit:
    """A frame for the radio to send; ``frame_id`` 0 asks for no confirmation."""

    destination: int
    data: bytes
    frame_id: int = 0
    options: int = 0


@dataclass(frozen=True)
class Received:
    """A frame that the radio heard; ``rssi`` is the strength as the radio states it: dB below 1 mW."""

    source: int
    data: bytes
    rssi: int = 40
    options: int = 0


Frame = Transmit | Received


def encode(frame: Frame) -> bytes:
    """The frame's bytes; data over 125 bytes is our own mistake."""
    assert len(frame.data) <= MAX_DATA, len(frame.data)
    if isinstance(frame, Transmit):
        head = struct.pack(">BBHB", TRANSMIT, frame.frame_id, frame.destination, frame.options)
    else:
        head = struct.pack(">BHBB", RECEIVED, frame.source, frame.rssi, frame.options)
    content = head + frame.data
    return struct.pack(">BH", START, len(content)) + content + bytes([0xFF - sum(content) % 0x100])


class FrameParser:
    """Finds frames in a stream.

    A frame is given once its last byte came. Where a start is not followed by a length that can be, a known kind and a
    right checksum, the search goes on at the next byte, so the next whole frame is found whatever came before; a false
    start holds it back until at most `MAX_BYTES` bytes have come. ``dropped`` counts bytes that were in no frame.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that ``data`` completes. Never raises."""
        self._waiting += data
        frames, at, waiting = [], 0, self._waiting
        while at < len(waiting):
            size = _size(waiting, at)
            if size is None:
                break
            if size == 0 or sum(waiting[at + 3 : at + size]) % 0x100 != 0xFF:
                at, self.dropped = at + 1, self.dropped + 1
                continue
            frames.append(_decoded(bytes(waiting[at + 3 : at + size - 1])))
            at += size
        del waiting[:at]
        return frames


def _size(data: bytearray, at: int) -> int | None:
    """Bytes of the frame that starts here: 0 where none does, None where that cannot be told yet."""
    head = data[at : at + 4]
    if head[0] != START or (len(head) > 1 and head[1] != 0):
        return 0
    if len(head) > 2 and not HEAD_BYTES <= head[2] <= HEAD_BYTES + MAX_DATA:
        return 0
    if len(head) > 3 and head[3] not in (TRANSMIT, RECEIVED):
        return 0
    size = 3 + head[2] + 1 if len(head) > 2 else MAX_BYTES
    return size if len(data) - at >= size else None


def _decoded(content: bytes) -> Frame:
    data = content[HEAD_BYTES:]
    if content[0] == TRANSMIT:
        _, frame_id, destination, options = struct.unpack_from(">BBHB", content)
        return Transmit(destination, data, frame_id, options)
    _, source, rssi, options = struct.unpack_from(">BHBB", content)
    return Received(source, data, rssi, options)

"""CRC-8 as the Zumy's firmware computes it: polynomial 0x1D5, initial value 0 (CRC-8/DVB-S2)."""

from __future__ import annotations

POLYNOMIAL = 0x1D5


def _entry(value: int) -> int:
    for _ in range(8):
        value <<= 1
        if value & 0x100:
            value ^= POLYNOMIAL
    return value


_TABLE = tuple(_entry(value) for value in range(256))


def crc8(data: bytes | bytearray) -> int:
    """The check value of ``data``; that of data with its check value appended is 0."""
    crc = 0
    for byte in data:
        crc = _TABLE[crc ^ byte]
    return crc

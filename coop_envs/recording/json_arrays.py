"""Numpy arrays as JSON: bit-exact as base64 bytes, or as plain numbers that any tool can plot."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import ConfigError

ZLIB_LEVEL = 2
ARRAY_SCHEMA: dict[str, Any] = {
    "type": "object",
    "description": "A C-ordered numpy array: dtype in numpy's notation, bytes in base64, compressed if so said.",
    "properties": {
        "dtype": {"type": "string"},
        "shape": {"type": "array", "items": {"type": "integer"}},
        "encoding": {"enum": ["base64", "zlib+base64"]},
        "data": {"type": "string", "contentEncoding": "base64"},
    },
    "required": ["dtype", "shape", "encoding", "data"],
}


def encode_array(array: NDArray[Any], compress: bool = False) -> dict[str, Any]:
    """The array, bit for bit, as an object of `ARRAY_SCHEMA`.

    Raises:
        ConfigError: a dtype that is not plain bytes (objects, records).
    """
    array = np.asarray(array)
    if array.dtype.kind not in "biufcSUmM":
        raise ConfigError("array.dtype", str(array.dtype), "numbers, booleans, text or times")
    data = array.tobytes()
    if compress:
        data = zlib.compress(data, level=ZLIB_LEVEL)
    return {
        "dtype": array.dtype.str,
        "shape": list(array.shape),
        "encoding": "zlib+base64" if compress else "base64",
        "data": base64.b64encode(data).decode("ascii"),
    }


def decode_array(encoded: Mapping[str, Any]) -> NDArray[Any]:
    """The array that `encode_array` encoded, writable."""
    data = base64.b64decode(encoded["data"])
    if encoded["encoding"] == "zlib+base64":
        data = zlib.decompress(data)
    return np.ndarray(tuple(encoded["shape"]), dtype=np.dtype(encoded["dtype"]), buffer=bytearray(data))


def plain_numbers(value: Any) -> Any:
    """Nested lists of numbers, NaN and infinities as the strings that JSON needs and ``float`` reads.

    Source: the protocol buffers' JSON mapping ("NaN", "Infinity", "-Infinity").
    """
    if isinstance(value, list):
        return [plain_numbers(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
    return value

"""Datagrams between a simulator's process and its robots: one JSON object each, over UDP.

To the simulator::

    {"kind": "hello", "robot": 1}                   who sends this is told of robot 1 from now on; answer: "welcome"
    {"kind": "set", "robot": 1, "wheels": [l, r], "brightness": 0.5, "laser": 1.0, "galvo": [3, 0]}
                                                    any part of it; wheels, brightness and laser latch, galvo does not
    {"kind": "operator", "undock": [3], "collect": [2]}   what people do: put a reserve down, take a lost robot away
    {"kind": "advance", "tick": 120}                in lock-step: run up to this tick; answer: "advanced"
    {"kind": "truth"}                               for judges, not for robots; answer: "truth"

From the simulator, after every tick, to everyone who said hello::

    {"kind": "state", "robot": 1, "tick": 120, "time_s": 4.0, "powered": true, "docked": false,
     "gyro": [..3], "accel": [..3], "angles": [l, r], "wheels": [l, r], "voltage": 7.4, "current": 1.0,
     "brightness": 0.5, "blobs": [[u, v, hue, signal], ..] or null without a camera, "spot": [u, v, sigma] or null}

SI units, as in `hardware_bridge.reading`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

Datagram = dict[str, Any]
KINDS = {"hello", "welcome", "set", "operator", "advance", "advanced", "truth", "state", "error"}
MAX_BYTES = 60_000


def encode(message: Mapping[str, Any]) -> bytes:
    """One datagram."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()


def decode(data: bytes) -> Datagram | None:
    """The message in a datagram, None for anything else."""
    try:
        message = json.loads(data)
    except (ValueError, RecursionError):
        return None
    kind = message.get("kind") if isinstance(message, dict) else None
    return message if isinstance(kind, str) and kind in KINDS else None


def numbers(value: Any, count: int) -> tuple[float, ...] | None:
    """So many finite numbers, None for anything else."""
    if not isinstance(value, list) or len(value) != count:
        return None
    if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in value):
        return None
    try:
        plain = tuple(float(v) for v in value)
    except OverflowError:
        return None
    return plain if all(math.isfinite(v) for v in plain) else None

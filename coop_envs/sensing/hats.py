"""The LED hats of a team, as solvers take them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import warp as wp

MAX_LEDS = 8


class HatLed(Protocol):
    """What an LED's description must hold: hue (degrees) and position in the body."""

    @property
    def hue_deg(self) -> float: ...
    @property
    def position_m(self) -> tuple[float, float, float]: ...


@wp.struct
class Hats:
    """Number of LEDs (N,), 0 without a hat; position in the body (N, 8) in m; hue (N, 8) in degrees."""

    leds: wp.array[int]
    position: wp.array2d[wp.vec3]
    hue: wp.array2d[float]


def pack_hats(hats: Sequence[Sequence[HatLed]], device: str) -> Hats:
    """The LEDs of every robot's hat; none for a robot without one."""
    shape = (len(hats), MAX_LEDS)
    position, hue = np.zeros((*shape, 3), dtype=np.float32), np.zeros(shape, dtype=np.float32)
    for r, leds in enumerate(hats):
        for k, led in enumerate(leds):
            position[r, k], hue[r, k] = led.position_m, led.hue_deg % 360.0
    packed: Any = Hats()
    packed.leds = wp.array([len(leds) for leds in hats], dtype=int, device=device)
    packed.position = wp.array(position, dtype=wp.vec3, device=device)
    packed.hue = wp.array(hue, dtype=float, device=device)
    return packed

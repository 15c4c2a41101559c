"""Camera frames drawn from blobs of light: Gaussian spots of colour on a dark, noisy image.

The light of a blob, summed over its pixels, is proportional to its signal. A strong one blooms: its spot grows wider
rather than brighter, as a camera's does whose exposure suits the weak ones. Pixel centres have whole coordinates.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

PEAK = 250.0
WIDTH_PX = 2.0
"""Standard deviation of the spot of an LED of signal 1, of which the brightest channel sums to 2 pi 4 250."""
NARROWEST_PX = 0.6
DARK, NOISE = 4.0, 1.5
SPOT_HUE_DEG, SPOT_SIGNAL = 0.0, 1.5
Frame = NDArray[np.uint8]


class FrameDrawer:
    """Draws frames of one size; the noise of a frame is one of a few noise images, shifted at random."""

    def __init__(self, width_px: int, height_px: int, seed: int = 0, noise: float = NOISE) -> None:
        self._chance = np.random.default_rng(seed)
        grey = self._chance.normal(DARK, noise, (height_px, width_px, 3))
        self._ground = np.clip(grey, 0.0, 255.0).astype(np.float32)

    def draw(self, blobs: Sequence[Sequence[float]], spot: Sequence[float] | None = None) -> Frame:
        """A frame (h, w, 3) in BGR of blobs (u, v, hue deg, signal), and of a laser's red spot at (u, v, ..)."""
        shift = self._chance.integers(0, self._ground.shape[:2])
        frame = np.roll(self._ground, shift, axis=(0, 1))
        for u, v, hue_deg, signal in blobs:
            add_light(frame, u, v, hue_deg, signal)
        if spot is not None:
            add_light(frame, spot[0], spot[1], SPOT_HUE_DEG, SPOT_SIGNAL)
        return np.clip(frame, 0.0, 255.0).round().astype(np.uint8)


def add_light(frame: NDArray[np.float32], u: float, v: float, hue_deg: float, signal: float) -> None:
    """Add one spot to a frame, as far as it lies inside."""
    light = 2 * np.pi * WIDTH_PX**2 * PEAK * signal
    width = max(WIDTH_PX * signal**0.5, NARROWEST_PX)
    peak = light / (2 * np.pi * width**2)
    reach = round(4 * width) + 1
    rows = np.arange(max(int(v) - reach, 0), min(int(v) + reach + 1, frame.shape[0]))
    columns = np.arange(max(int(u) - reach, 0), min(int(u) + reach + 1, frame.shape[1]))
    if rows.size == 0 or columns.size == 0:
        return
    down, across = (np.exp(-0.5 * ((at - centre) / width) ** 2) for at, centre in ((rows, v), (columns, u)))
    bgr = np.array(colorsys.hsv_to_rgb(hue_deg / 360 % 1, 1.0, 1.0)[::-1])
    profile = peak * down[:, None, None] * across[None, :, None] * bgr
    frame[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += profile.astype(np.float32)

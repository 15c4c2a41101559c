"""Blobs of light in a frame: where, of what hue, how bright.

The brightest channel is smoothed and thresholded; a connected patch of what remains is a blob. Its centre is the mean
of its pixels weighted by how far they rise above the threshold, its hue the direction of the sum of their chroma. Its
light is summed, and what the threshold cut off is added as if the blob were Gaussian: a share of threshold / peak.

Source: threshold, area and blur after the authors of the LED pose estimator (thesis chapters 4 to 6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from coop_envs.errors import ConfigError, require
from coop_envs.validation import STRICT
from hardware_bridge.reading import CameraFrame, Triple

Image = NDArray[np.uint8]
CLIPPED = 250
"""Pixels as bright tell little of their hue: channels have reached their end."""
CLIPPED_WEIGHT = 0.01


@dataclass(frozen=True)
class DetectionSettings:
    """What counts as a blob.

    ``threshold`` 0..255 is that of chapter 4 (chapters 5 and 6 take 200), areas in pixels lie between those of
    chapters 6 (1) and 4 (9), which lose distant LEDs or count single hot pixels. ``full_light`` calibrates the signal:
    the brightest channel summed over the blob of an LED at full brightness at the reference range.
    ``max_blobs`` keeps the brightest; ``spot_sigma_px`` is the centroid's standard deviation that a laser's spot gets.
    """

    __pydantic_config__ = STRICT
    threshold: int = 64
    min_area_px: int = 3
    max_area_px: int = 3000
    blur_sigma_px: float = 0.6
    full_light: float = 6300.0
    max_blobs: int = 64
    spot_sigma_px: float = 0.5

    def __post_init__(self) -> None:
        require(1 <= self.threshold <= 254, "detection.threshold", self.threshold, "1 to 254")
        areas = (self.min_area_px, self.max_area_px)
        require(1 <= areas[0] <= areas[1], "detection.min_area_px", areas, "1 up to max_area_px")
        require(0 <= self.blur_sigma_px <= 10, "detection.blur_sigma_px", self.blur_sigma_px, "0 (none) to 10 px")
        require(self.full_light > 0, "detection.full_light", self.full_light, "more than 0")
        require(1 <= self.max_blobs <= 1000, "detection.max_blobs", self.max_blobs, "1 to 1000")
        require(self.spot_sigma_px > 0, "detection.spot_sigma_px", self.spot_sigma_px, "more than 0 px")


def detect(host_s: float, image: Image, settings: DetectionSettings) -> CameraFrame:
    """The blobs of an image (h, w, 3) in BGR, brightest first; the brightest is the spot, too.

    Raises:
        ConfigError: the image is of another kind.
    """
    blobs = find_blobs(image, settings)
    spot: Triple | None = None
    if blobs:
        spot = (blobs[0][0], blobs[0][1], settings.spot_sigma_px)
    return CameraFrame(host_s, blobs, spot)


def find_blobs(image: Image, settings: DetectionSettings) -> tuple[tuple[float, float, float, float], ...]:
    """(u px, v px, hue deg, signal) of every blob, brightest first."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or image.size == 0:
        raise ConfigError("image", f"{image.dtype} {image.shape}", "uint8 (height, width, 3)")
    blue, green, red = cv2.split(image)
    light = cv2.max(cv2.max(blue, green), red)
    if settings.blur_sigma_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), settings.blur_sigma_px)
    mask = cv2.threshold(light, settings.threshold - 1, 255, cv2.THRESH_BINARY)[1]
    lit = cv2.findNonZero(mask)
    if lit is None:
        return ()
    # Labels of 16 bits take a third of the time; there are no more labels than pixels.
    kind = cv2.CV_16U if len(lit) < 65535 else cv2.CV_32S
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8, ltype=kind)
    area = stats[:, cv2.CC_STAT_AREA]
    kept = (area >= settings.min_area_px) & (area <= settings.max_area_px)
    u, v = np.asarray(lit, dtype=np.int32).reshape(-1, 2).T
    label = np.asarray(labels)[v, u].astype(np.int32)
    u, v, label = (pixels[kept[label]] for pixels in (u, v, label))
    return _measured(image[v, u], light[v, u], u, v, label, int(count), settings) if label.size else ()


def _measured(
    bgr: Image, light: NDArray[Any], u: NDArray[Any], v: NDArray[Any], label: NDArray[Any], count: int,
    settings: DetectionSettings,
) -> tuple[tuple[float, float, float, float], ...]:  # fmt: skip
    """The blobs of these pixels, given by colour, brightness, place and label."""

    def total(weight: NDArray[Any]) -> NDArray[Any]:
        return np.bincount(label, weight, count)

    bright = light.astype(np.float64)
    rise = bright - settings.threshold + 1.0
    peak = np.zeros(count)
    np.maximum.at(peak, label, bright)
    weight = total(rise)
    b, g, r = bgr.T.astype(np.float64)
    trusted = np.where(np.maximum(np.maximum(r, g), b) < CLIPPED, 1.0, CLIPPED_WEIGHT)
    across, along = total(trusted * math.sqrt(0.75) * (g - b)), total(trusted * (r - (g + b) / 2))
    found = np.flatnonzero(weight)
    w = weight[found]
    hue = np.degrees(np.arctan2(across, along))[found] % 360.0
    seen = 1.0 - (settings.threshold - 1.0) / peak[found]
    signal = total(bright)[found] / seen / settings.full_light
    rows = np.stack([total(rise * u)[found] / w, total(rise * v)[found] / w, hue, signal], axis=1)
    order = np.argsort(-signal, kind="stable")[: settings.max_blobs]
    return tuple((u, v, hue, signal) for u, v, hue, signal in rows[order].tolist())

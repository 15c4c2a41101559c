"""Text in pictures: OpenCV 5's own outline font, and the older stroke font where OpenCV 4 is installed."""

from __future__ import annotations

import functools
from typing import Any

import cv2

from coop_envs.viewer.canvas import Picture
from coop_envs.viewer.palette import Rgb

REGULAR, MEDIUM, BOLD = 400, 500, 700
_STROKE_HEIGHT_PX = 30.0


@functools.cache
def _outline_font() -> Any:
    """OpenCV 5's built-in sans font, None in OpenCV 4."""
    return cv2.FontFace("sans") if hasattr(cv2, "FontFace") else None


def write(
    picture: Picture,
    text: str,
    at: tuple[float, float],
    size_px: int,
    colour: Rgb,
    weight: int = REGULAR,
    halo: Rgb | None = None,
) -> None:
    """Write text whose baseline starts at pixel ``at``, in place; a halo sets it off from what lies beneath."""
    u, v = round(at[0]), round(at[1])
    if halo is not None:
        for du, dv in ((-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)):
            _put(picture, text, (u + du, v + dv), size_px, halo, weight)
    _put(picture, text, (u, v), size_px, colour, weight)


def _put(picture: Picture, text: str, at: tuple[int, int], size_px: int, colour: Rgb, weight: int) -> None:
    font = _outline_font()
    if font is not None:
        cv2.putText(picture, text, at, colour, font, size_px, weight)
        return
    plain = text.replace("σ", "sigma").replace("–", "-")
    thickness = 2 if weight >= BOLD else 1
    cv2.putText(
        picture, plain, at, cv2.FONT_HERSHEY_SIMPLEX, size_px / _STROKE_HEIGHT_PX, colour, thickness, cv2.LINE_AA
    )


def text_width(text: str, size_px: int, weight: int = REGULAR) -> float:
    """How many pixels wide the text comes out."""
    font = _outline_font()
    if font is not None:
        return float(cv2.getTextSize((4096, 4096), text, (0, 0), font, size_px, weight)[2])
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size_px / _STROKE_HEIGHT_PX, 1)
    return float(width)

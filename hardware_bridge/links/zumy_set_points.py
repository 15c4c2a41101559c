"""What a Zumy's firmware makes of set-points: the nearest it can do, never more than was asked."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence

from hardware_bridge.command import RobotCommand
from hardware_bridge.protocols.zumy_packets import LASER_DUTIES, LEDS, MAX_WHEEL_RAD_S
from hardware_bridge.reading import Pair

GALVO_LIMIT = 2**15 - 1


def sendable(wanted: RobotCommand, lit: bool) -> tuple[RobotCommand, float]:
    """What the robot will really do, and the laser level 0..1 that makes it.

    The firmware's wheels end at 50 rad/s, its LEDs have 8 bits a channel (and are dark without a hat, whose colours
    they would show), its laser four duties, of which the next lower is taken, its mirror counts 16 bits. What is not
    finite counts as 0.
    """
    step = sum(wanted.laser >= duty - 1e-6 for duty in LASER_DUTIES[1:])
    brightness = round(_clipped(wanted.brightness, 0.0, 1.0) * 255) / 255 if lit else 0.0
    across, up = (int(_clipped(count, -GALVO_LIMIT, GALVO_LIMIT)) for count in wanted.galvo)
    sent = RobotCommand(_wheels(wanted.wheels_rad_s), brightness, LASER_DUTIES[step], (across, up))
    return sent, step / (len(LASER_DUTIES) - 1)


def colours(hues_deg: Sequence[float], brightness: float) -> list[int]:
    """0xRRGGBB of the six LEDs: a hat's pure hues, dimmed; those beyond the hat are dark."""
    lit = [colorsys.hsv_to_rgb(hue / 360 % 1, 1.0, brightness) for hue in hues_deg]
    packed = [sum(round(255 * part) << shift for part, shift in zip(rgb, (16, 8, 0), strict=True)) for rgb in lit]
    return packed + [0] * (LEDS - len(packed))


def _wheels(wanted_rad_s: Pair) -> Pair:
    if not all(math.isfinite(wheel) for wheel in wanted_rad_s):
        return 0.0, 0.0
    left, right = (_clipped(wheel, -MAX_WHEEL_RAD_S, MAX_WHEEL_RAD_S) for wheel in wanted_rad_s)
    return left, right


def _clipped(value: float, low: float, high: float) -> float:
    return min(max(value, low), high) if math.isfinite(value) else 0.0

"""How much of a laser spot's light a camera gets, and how well it then places the spot.

The beam's power lands on a surface of some albedo and leaves it as Lambert's cosine says, so a spot that the camera
does not resolve looks the brighter the more squarely the camera faces the surface; how obliquely the beam strikes does
not dim it but stretches the spot, and the centroid of a streak is the less certain.
The signal has the scale of `leds.led_signal`: 1 for an LED at full brightness at the reference range.
"""

from __future__ import annotations

import warp as wp

from coop_envs.sensing.leds import LedModel, pixel_noise

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

GRAZING = wp.constant(0.02)  # cosine of the incidence below which a beam spreads too thin to be seen
STREAK_NOISE = wp.constant(0.1)  # share of a streak's length by which its centroid is uncertain


@wp.struct
class SpotModel:
    """``gain``: signal of a full-power spot on a white surface, faced squarely from the reference range.

    ``beam`` is its width (m). ``missed``, ``false_spot``: shares of the frames whose spot is lost, or that show another
    light instead; ``jitter`` (s) of the frames' stamps.
    """

    gain: float
    albedo: float
    beam: float
    missed: float
    false_spot: float
    jitter: float


@wp.func
def spot_signal(
    spots: SpotModel, leds: LedModel, duty: float, from_laser_m: float, to_camera: wp.vec3, normal: wp.vec3
) -> float:
    """Signal of a spot from which the camera lies at ``to_camera`` (m); ``normal`` is the surface's unit normal."""
    d2 = wp.dot(to_camera, to_camera)
    d = wp.sqrt(d2)
    faced = wp.max(wp.dot(to_camera, normal) / d, 0.0)
    dimmed = wp.exp(-leds.absorption * (d + from_laser_m))
    return spots.gain * duty * spots.albedo * faced * dimmed * leds.reference_range * leds.reference_range / d2


@wp.func
def spot_noise(spots: SpotModel, leds: LedModel, signal: float, incidence: float, focal_px: float, d: float) -> float:
    """Standard deviation of the centroid (px); ``incidence`` is the cosine at which the beam strikes."""
    streak = STREAK_NOISE * spots.beam / wp.max(incidence, GRAZING) * focal_px / d
    blob = pixel_noise(leds, signal)
    return wp.sqrt(blob * blob + streak * streak)

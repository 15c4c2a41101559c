"""How much of an LED's light a camera gets, and what that does to its pixel.

The signal is relative to one LED at full brightness, level with the camera, at the reference range. It falls with the
square of the distance and exponentially with the medium (thesis eqs (4.2), (4.11)); an LED in its diffuser sends light
up more than down, as 1 + cos of the angle to the hat's upward axis (a model, no measured pattern is published).
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

SHOT_SIGNAL = wp.constant(0.25)


@wp.struct
class LedModel:
    """Noise of pixels and hues (degrees) at full signal, reference range, absorption per metre.

    A blob below ``detection_signal`` is lost; one in ``blob_dropout`` is lost anyway, and two closer than ``merge``
    pixels are one. Of whole hats a frame misses ``dropout`` and shows ``outlier`` as reflections; ``false_lights`` is
    the mean number of other lights in a frame. Blobs within ``hue_tolerance`` (degrees) of an LED's hue may be it, and
    a pose takes ``min_leds``.
    """

    noise_px: float
    hue_noise: float
    hue_tolerance: float
    blob_dropout: float
    merge: float
    false_lights: float
    reference_range: float
    absorption: float
    detection_signal: float
    min_leds: int
    dropout: float
    outlier: float


@wp.func
def led_signal(model: LedModel, brightness: float, to_camera: wp.vec3, axis: wp.vec3) -> float:
    """Signal of an LED from which the camera lies at ``to_camera`` (m); ``axis`` is the hat's unit up vector."""
    d2 = wp.dot(to_camera, to_camera)
    d = wp.sqrt(d2)
    pattern = 1.0 + wp.dot(to_camera, axis) / d
    return brightness * pattern * wp.exp(-model.absorption * d) * model.reference_range * model.reference_range / d2


@wp.func
def shot_noise(signal: float) -> float:
    """Growth of a noise as the signal falls below 1."""
    return wp.sqrt((1.0 + SHOT_SIGNAL / wp.min(signal, 1.0)) / (1.0 + SHOT_SIGNAL))


@wp.func
def pixel_noise(model: LedModel, signal: float) -> float:
    """Standard deviation of the blob's centroid in pixels: shot noise grows as the signal falls."""
    return model.noise_px * shot_noise(signal)


@wp.func
def hue_noise(model: LedModel, signal: float) -> float:
    """Standard deviation of the blob's hue in degrees."""
    return model.hue_noise * shot_noise(signal)

from __future__ import annotations

import numpy as np
import pytest

from coop_envs.sensing.leds import LedModel
from tests.geometry.kernels import on_device
from tests.sensing.kernels import noises, signals

LEVEL = np.array([1.0, 0.0, 0.0])
UP = np.array([0.0, 0.0, 1.0])


def led_model(absorption=0.0):
    model = LedModel()
    model.noise_px, model.reference_range, model.absorption = 0.5, 2.0, absorption
    return model


def signal(to_camera, brightness=1.0, axis=UP, **model):
    to_camera = np.atleast_2d(to_camera)
    rows = len(to_camera)
    level = np.full(rows, brightness, dtype=np.float32)
    return on_device(signals, led_model(**model), level, to_camera, np.tile(axis, (rows, 1)))


def test_the_signal_is_1_at_full_brightness_level_at_the_reference_range():
    assert signal(2.0 * LEVEL)[0] == pytest.approx(1.0)


def test_the_signal_falls_with_the_square_of_the_distance_and_exponentially_with_the_medium():
    d = np.array([0.1, 0.5, 1.0, 2.0, 5.0])
    clear = signal(d[:, None] * LEVEL)
    np.testing.assert_allclose(clear * d**2, 4.0, rtol=1e-5)
    murky = signal(d[:, None] * LEVEL, absorption=0.7)
    np.testing.assert_allclose(np.log(clear / murky), 0.7 * d, rtol=1e-4)


def test_the_signal_is_proportional_to_brightness():
    assert signal(LEVEL, brightness=0.25)[0] == pytest.approx(0.25 * signal(LEVEL)[0])
    assert signal(LEVEL, brightness=0.0)[0] == 0.0


def test_all_of_the_light_goes_somewhere():
    """The pattern's mean over the sphere is 1: the diffuser redirects light, it makes none."""
    around = np.random.default_rng(0).normal(size=(20000, 3))
    around *= 2.0 / np.linalg.norm(around, axis=1, keepdims=True)
    found = signal(np.concatenate([around, -around]), axis=np.array([0.6, 0.0, 0.8]))
    assert found.mean() == pytest.approx(1.0, abs=1e-5)
    assert signal(2.0 * UP)[0] == pytest.approx(2.0) and signal(-2.0 * UP)[0] == pytest.approx(0.0, abs=1e-6)


def test_noise_grows_like_shot_noise_as_the_signal_falls():
    s = np.array([100.0, 1.0, 1e-2, 1e-4, 1e-6], dtype=np.float32)
    sigma = on_device(noises, led_model(), s)
    np.testing.assert_allclose(sigma[:2], 0.5, rtol=1e-6)
    assert np.all(np.diff(sigma[1:]) > 0)
    slope = np.log(sigma[4] / sigma[3]) / np.log(s[4] / s[3])
    assert slope == pytest.approx(-0.5, abs=1e-3)

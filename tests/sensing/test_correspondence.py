from __future__ import annotations

import itertools

import numpy as np
import pytest

from tests.geometry.kernels import on_device
from tests.sensing.kernels import assignment_counts, hue_distances, turans_set


def evenly_spread(detections: int, colours: int = 6) -> list[int]:
    """How many detections each colour gets, none beyond the colours' number of LEDs."""
    return [detections // colours + (k < detections % colours) for k in range(colours)] + [0] * (8 - colours)


def test_assignments_are_those_of_eq_4_15_as_corrected():
    """Checked by listing them all; the text's own figure is 64 at twelve detections."""
    detections = range(21)
    found = on_device(assignment_counts, np.array([evenly_spread(n) for n in detections], dtype=np.int32))
    for n in detections:
        choices = [range(max(count, 1)) for count in evenly_spread(n)]
        assert found[n] == sum(1 for _ in itertools.product(*choices))
    assert [found[n] for n in (5, 6, 7, 12, 13)] == [1, 1, 2, 64, 96]


@pytest.mark.parametrize("leds", [4, 5, 6, 7, 8])
def test_every_four_leds_hold_a_triple_that_is_tried(leds):
    triples = list(itertools.combinations(range(leds), 3))
    tried = {t for t, chosen in zip(triples, on_device(turans_set, np.array(triples)), strict=True) if chosen}
    for four in itertools.combinations(range(leds), 4):
        assert tried & set(itertools.combinations(four, 3))
    assert len(tried) == {4: 1, 5: 3, 6: 6, 7: 12, 8: 20}[leds], "Turan's numbers"


def test_hues_lie_on_a_circle():
    a, b = np.array([358.0, 10.0, 90.0, 0.0, 720.0, -5.0]), np.array([2.0, 350.0, 270.0, 0.0, 5.0, 5.0])
    np.testing.assert_allclose(on_device(hue_distances, a, b), [4.0, 20.0, 180.0, 0.0, 5.0, 10.0], atol=1e-4)

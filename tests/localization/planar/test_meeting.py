from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coop_envs.localization.planar import se2
from coop_envs.localization.planar.meeting import agreed, fitted

FRAME = np.array([1.5, -0.7, 2.2])


def met(K: int, seed: int, sigma_m: float = 0.02):
    rng = np.random.default_rng(seed)
    guest = rng.uniform(-2, 2, (K, 2))
    return se2.acted(FRAME, guest) + rng.normal(size=(K, 2)) * sigma_m / np.sqrt(2), guest, np.full(K, sigma_m)


def test_closed_form_against_scipy():
    host, guest, _ = met(6, 0, 0.3)
    weight = np.random.default_rng(1).uniform(0.5, 2.0, 6)
    ours = fitted(host, guest, weight)
    space = [np.column_stack([p - weight @ p / weight.sum(), np.zeros(6)]) for p in (host, guest)]
    theirs = Rotation.align_vectors(space[0], space[1], weights=weight)[0].as_rotvec()
    np.testing.assert_allclose(theirs, [0.0, 0.0, ours[2]], atol=1e-6)
    np.testing.assert_allclose(weight @ (host - se2.acted(ours, guest)), 0.0, atol=1e-12)


def test_wrong_points_are_left_out():
    host, guest, sigma = met(8, 2)
    host[[1, 5, 6]] += [[1.0, 0.5], [-0.8, 0.3], [0.4, -0.9]]
    found = agreed(host, guest, sigma, np.ones(8))
    assert found is not None
    np.testing.assert_allclose(found[0], FRAME, atol=0.05)
    np.testing.assert_array_equal(found[1], [True, False, True, True, True, False, False, True])


@pytest.mark.parametrize(
    ("K", "weight", "enough"),
    [(2, 1.0, False), (2, 2.0, True), (3, 1.0, False), (4, 1.0, True), (1, 5.0, False), (0, 1.0, False)],
)
def test_four_sightings_or_two_fixes_are_enough(K, weight, enough):
    assert (agreed(*met(K, 3), np.full(K, weight)) is not None) == enough


def test_no_two_sightings_decide():
    """Many of one spot and two elsewhere agree on a turn, whether those two are right or not; one more settles it."""
    guest = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01], [0.01, 0.01], [2.0, 0.0], [2.0, 0.01], [2.01, 0.0]])
    host, sigma, weight = se2.acted(FRAME, guest), np.full(7, 0.02), np.ones(7)
    assert agreed(host[:6], guest[:6], sigma[:6], weight[:6]) is None
    found = agreed(host, guest, sigma, weight)
    assert found is not None
    np.testing.assert_allclose(found[0], FRAME, atol=0.01)


def test_points_on_one_spot_tell_of_no_turn():
    _, guest, sigma = met(5, 4)
    near = guest[:1] + 0.001 * guest
    assert agreed(se2.acted(FRAME, near), near, sigma, np.ones(5)) is None


def test_when_nobody_agrees_nobody_is_believed():
    rng = np.random.default_rng(5)
    assert agreed(rng.uniform(-3, 3, (6, 2)), rng.uniform(-3, 3, (6, 2)), np.full(6, 0.02), np.ones(6)) is None

"""Running moments against NumPy's of all rows at once."""

from __future__ import annotations

import numpy as np
import torch

from policies.normaliser import Normaliser, RunningMoments
from tests.policies.builders import rows, tensors


def test_moments_in_parts_are_those_of_the_whole():
    data = np.random.default_rng(0).normal([3.0, -40.0, 0.01], [0.5, 7.0, 0.3], size=(5000, 3)).astype(np.float32)
    moments = RunningMoments(3)
    for part in np.split(data, [1, 2, 700, 700, 4000]):
        moments.update(torch.from_numpy(part))
    assert int(moments.count) == 5000
    np.testing.assert_allclose(moments.mean, data.mean(0, dtype=np.float64), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(moments.variance, data.var(0, dtype=np.float64), rtol=1e-5)
    turned = moments(torch.from_numpy(data))
    np.testing.assert_allclose(turned.mean(0), 0.0, atol=1e-4)
    np.testing.assert_allclose(turned.std(0), 1.0, rtol=1e-3)


def test_nothing_changes_before_the_first_update_but_for_the_clip():
    moments = RunningMoments(4)
    given = torch.tensor([[0.0, -3.0, 2e7, -11.0]])
    torch.testing.assert_close(moments(given), torch.tensor([[0.0, -3.0, 10.0, -10.0]]))


def test_an_entry_that_never_varied_is_not_blown_up():
    moments = RunningMoments(1)
    moments.update(torch.full((100, 1), 0.5))
    torch.testing.assert_close(moments(torch.tensor([[0.5], [0.6]])), torch.tensor([[0.0], [1.0]]))


def test_absent_mates_do_not_enter():
    observed = rows(40)
    seen = observed["mask"] > 0
    expected = observed["mates"][seen].mean(0)
    observed["mates"][~seen] = np.nan
    normaliser = Normaliser(29, 16)
    normaliser.update(tensors(observed))
    np.testing.assert_allclose(normaliser.mate_moments.mean, expected, atol=1e-5)
    np.testing.assert_allclose(normaliser.self_moments.mean, observed["self"].mean(0), atol=1e-5)


def test_an_update_with_nobody_changes_nothing():
    normaliser, observed = Normaliser(29, 16), rows(5)
    normaliser.update(tensors({key: array[:0] for key, array in observed.items()}))
    assert torch.equal(normaliser.self_moments.variance, torch.ones(29))
    assert torch.equal(normaliser.mate_moments.variance, torch.ones(16))

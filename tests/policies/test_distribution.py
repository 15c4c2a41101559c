"""The distribution against torch's own, numerical integrals and Monte Carlo."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.distributions import Bernoulli, Normal

from policies.distribution import TeamActionDistribution
from policies.networks import Heads

SCANNER = [1, 1, 1, 0, 1, 1, 1, 1]
PICKET = [1, 1, 1, 0, 0, 0, 0, 1]
GO, HOLD = -1.0, 1.0


def heads(n: int = 1, logit: float = -0.7, seed: int = 0) -> Heads:
    generator = torch.Generator().manual_seed(seed)
    mean = 0.8 * torch.randn((n, 7), generator=generator)
    log_std = 0.3 * torch.randn(7, generator=generator) - 0.5
    return Heads(torch.full((n,), logit), mean.requires_grad_(), log_std.requires_grad_())


def masks(entries: list[int], n: int = 1) -> Tensor:
    return torch.tensor([entries] * n, dtype=torch.int8)


@pytest.mark.parametrize("mask", [SCANNER, PICKET])
@pytest.mark.parametrize(
    ("hold", "request_scan", "counted"),
    [(GO, 0.9, {1, 2, 7}), (HOLD, 0.4, {4, 5, 6, 7}), (HOLD, -0.2, {4, 7})],
)
def test_log_prob_counts_the_entries_with_an_effect(mask, hold, request_scan, counted):
    given = heads()
    action = torch.tensor([[hold, 0.3, -1.4, 0.2, request_scan, 0.1, -0.6, 2.0]])
    expected = Bernoulli(logits=given.hold_logit[0]).log_prob(torch.tensor(float(hold > 0)))
    for k in counted & {k for k in range(8) if mask[k]}:
        expected = expected + Normal(given.mean[0, k - 1], given.log_std[k - 1].exp()).log_prob(action[0, k])
    got = TeamActionDistribution(given, masks(mask)).log_prob(action)
    torch.testing.assert_close(got, expected[None])


@pytest.mark.parametrize(("hold", "request_scan", "free"), [(GO, 1.0, {1, 2, 7}), (HOLD, -1.0, {4, 7})])
def test_entries_without_effect_get_no_gradient(hold, request_scan, free):
    given = heads()
    action = torch.tensor([[hold, 0.3, -1.4, 0.2, request_scan, 0.1, -0.6, 2.0]])
    TeamActionDistribution(given, masks(SCANNER)).log_prob(action).sum().backward()
    for gradient in (given.mean.grad, given.log_std.grad):
        assert gradient is not None
        assert {k + 1 for k in gradient.reshape(7).nonzero().flatten().tolist()} == free


def test_what_a_robot_lacks_gets_no_gradient_from_the_entropy():
    given = heads()
    TeamActionDistribution(given, masks(PICKET)).entropy().sum().backward()
    assert given.log_std.grad is not None
    assert {k + 1 for k in given.log_std.grad.nonzero().flatten().tolist()} == {1, 2, 7}


def test_density_integrates_to_one_over_going_and_holding():
    given = heads(logit=0.4)
    x = torch.linspace(-12.0, 12.0, 20_001, dtype=torch.float32)
    driving = torch.zeros(len(x), 8)
    driving[:, 0], driving[:, 1] = GO, x
    wide = Heads(given.hold_logit.expand(len(x)), given.mean.expand(len(x), 7), given.log_std)
    only_forward = TeamActionDistribution(wide, masks([1, 1, 0, 0, 0, 0, 0, 0], len(x)))
    going = torch.trapezoid(only_forward.log_prob(driving).exp(), x)
    standing = TeamActionDistribution(given, masks([1, 1, 0, 0, 0, 0, 0, 0])).log_prob(torch.ones(1, 8)).exp()
    assert float((going + standing[0]).detach()) == pytest.approx(1.0, abs=1e-5)


def test_density_integrates_to_one_where_a_request_decides_on_the_azimuth():
    given = heads(logit=30.0)
    x = torch.linspace(-7.0, 7.0, 701)
    x = x + 0.01 / 2  # no point at a request of 0
    request, azimuth = (grid.flatten() for grid in torch.meshgrid(x, x, indexing="ij"))
    actions = torch.ones(len(request), 8)
    actions[:, 4], actions[:, 5] = request, azimuth
    n, cell = len(request), float(x[1] - x[0])
    wide = Heads(given.hold_logit.expand(n), given.mean.expand(n, 7), given.log_std)
    density = TeamActionDistribution(wide, masks([1, 0, 0, 0, 1, 1, 0, 0], n)).log_prob(actions).exp()
    density = density.view(len(x), len(x))
    refused, scanned = density[x <= 0, 0].sum() * cell, density[x > 0].sum() * cell * cell
    assert float((refused + scanned).detach()) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("mask", [SCANNER, PICKET, [1] * 8])
@pytest.mark.parametrize("logit", [-3.0, -0.4, 1.5])
def test_entropy_is_the_mean_of_minus_log_prob(mask, logit):
    n = 200_000
    given = heads(logit=logit, seed=3)
    wide = Heads(given.hold_logit.expand(n), given.mean.detach().expand(n, 7), given.log_std.detach())
    distribution = TeamActionDistribution(wide, masks(mask, n))
    surprise = -distribution.log_prob(distribution.sample(torch.Generator().manual_seed(5)))
    error = float(surprise.std()) / math.sqrt(n)
    assert float(distribution.entropy()[0]) == pytest.approx(float(surprise.mean()), abs=4 * error)


def test_extreme_logits_stay_finite():
    for logit in (-200.0, 200.0):
        given = heads(logit=logit)
        distribution = TeamActionDistribution(given)
        action = distribution.sample(torch.Generator().manual_seed(0))
        assert torch.isfinite(distribution.log_prob(action)).all()
        assert torch.isfinite(distribution.entropy()).all()


def test_samples_follow_the_heads_and_the_generator():
    n = 100_000
    given = heads(logit=0.6)
    wide = Heads(given.hold_logit.expand(n), given.mean.detach().expand(n, 7), given.log_std.detach())
    first, again = (TeamActionDistribution(wide).sample(torch.Generator().manual_seed(1)) for _ in range(2))
    assert torch.equal(first, again)
    assert set(first[:, 0].unique().tolist()) == {GO, HOLD}
    assert float((first[:, 0] > 0).float().mean()) == pytest.approx(1 / (1 + math.exp(-0.6)), abs=0.01)
    torch.testing.assert_close(first[:, 1:].mean(0), given.mean.detach()[0], atol=0.02, rtol=0)
    torch.testing.assert_close(first[:, 1:].std(0), given.log_std.detach().exp(), atol=0.02, rtol=0)


def test_mode_is_the_likeliest_within_the_limits():
    given = Heads(torch.tensor([0.1, -0.1]), torch.tensor([[3.0] * 7, [-0.2] * 7]), torch.zeros(7))
    expected = torch.tensor([[HOLD] + [1.0] * 7, [GO] + [-0.2] * 7])
    torch.testing.assert_close(TeamActionDistribution(given).mode(), expected)

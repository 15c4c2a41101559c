"""Attention over mates on its own, with mates that are not zero where nobody is."""

from __future__ import annotations

import torch

from policies.mates_attention import MatesAttention

ASKING, MATES = torch.randn((5, 6), generator=torch.Generator().manual_seed(0)), torch.linspace(-1, 1, 140)


def attention() -> MatesAttention:
    torch.manual_seed(1)
    return MatesAttention(entries=4, query_width=6, width=8, heads=2)


def test_nobody_is_the_same_whatever_the_absent_hold():
    layer, mates, nobody = attention(), MATES.view(5, 7, 4), torch.zeros(5, 7)
    assert torch.equal(layer(ASKING, mates, nobody), layer(ASKING, 3.0 - mates, nobody))


def test_two_equal_mates_are_told_as_one():
    layer, mates = attention(), MATES.view(5, 7, 4).clone()
    mates[:, 3] = mates[:, 0]
    one, two = torch.zeros(5, 7), torch.zeros(5, 7)
    one[:, 0] = two[:, 0] = two[:, 3] = 1
    torch.testing.assert_close(layer(ASKING, mates, one), layer(ASKING, mates, two))


def test_with_one_mate_the_question_does_not_matter_with_two_it_does():
    layer, mates = attention(), MATES.view(5, 7, 4)
    one, two = torch.eye(7)[0].expand(5, 7), torch.eye(7)[:2].sum(0).expand(5, 7)
    torch.testing.assert_close(layer(ASKING, mates, one), layer(-ASKING, mates, one))
    assert not torch.allclose(layer(ASKING, mates, two), layer(-ASKING, mates, two), atol=1e-4)

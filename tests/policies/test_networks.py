"""What the network must not depend on, what it must, and where it starts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from coop_envs.errors import ConfigError
from policies.map_encoder import PROBE_DIRECTIONS, BodyProbes
from policies.networks import NetworkSettings, TeamActorCritic
from tests.policies.builders import network, rows, tensors

KINDS = ["attention", "mlp"]


def everything(made: TeamActorCritic, observed: dict[str, Any]) -> torch.Tensor:
    """Hold, means and value side by side (n, 9)."""
    with torch.no_grad():
        heads, value = made.heads_and_value(tensors(observed))
    return torch.cat([heads.hold_logit[:, None], heads.mean, value[:, None]], dim=-1)


@pytest.mark.parametrize("separate_value", [False, True])
def test_attention_does_not_know_the_order_of_mates(separate_value):
    made, observed = network(separate_value=separate_value), rows(20)
    before = everything(made, observed)
    order = np.random.default_rng(1).permuted(np.tile(np.arange(7), (20, 1)), axis=1)
    observed["mates"] = np.take_along_axis(observed["mates"], order[..., None], axis=1)
    observed["mask"] = np.take_along_axis(observed["mask"], order, axis=1)
    torch.testing.assert_close(everything(made, observed), before, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("junk", [1e30, np.nan, -np.inf])
def test_absent_mates_have_no_influence(kind, junk):
    made, observed = network(kind), rows(9)
    before = everything(made, observed)
    assert torch.isfinite(before).all()  # row 0 has no mates at all
    observed["mates"][observed["mask"] == 0] = junk
    torch.testing.assert_close(everything(made, observed), before, atol=0, rtol=0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("key", ["self", "mates", "map"])
def test_everything_else_has_influence(kind, key):
    made, observed = network(kind), rows(9)
    before = everything(made, observed)
    observed[key] = observed[key][:, ::-1].copy() if key == "map" else observed[key] + np.float32(0.5)
    changed = (everything(made, observed) != before).any(dim=-1)
    assert changed[1:].all()


@pytest.mark.parametrize("kind", KINDS)
def test_no_gradient_is_lost_where_nobody_is_seen(kind):
    made, observed = network(kind), rows(6)
    observed["mask"][:] = 0
    heads, value = made.heads_and_value(tensors(observed))
    (heads.mean.sum() + heads.hold_logit.sum() + value.sum()).backward()
    gradients = [p.grad for p in made.parameters() if p.grad is not None]
    assert gradients
    assert all(torch.isfinite(g).all() for g in gradients)


@pytest.mark.parametrize("kind", KINDS)
def test_maps_may_be_bytes_or_floats(kind):
    made, observed = network(kind), rows(5)
    assert torch.equal(
        everything(made, observed), everything(made, observed | {"map": observed["map"].astype(np.float32)})
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("separate_value", [False, True])
def test_heads_and_value_come_together_or_apart(kind, separate_value):
    made, observed = network(kind, separate_value=separate_value), tensors(rows(5))
    heads, value = made.heads_and_value(observed)
    alone = made(observed)
    for got, expected in zip((alone.hold_logit, alone.mean, alone.log_std), vars(heads).values(), strict=True):
        assert torch.equal(got, expected)
    assert torch.equal(made.value(observed), value)
    assert (value.shape, heads.hold_logit.shape, heads.mean.shape, heads.log_std.shape) == ((5,), (5,), (5, 7), (7,))


def test_each_role_has_last_layers_of_its_own():
    made, observed = network(), rows(8)
    observed["self"][:, :2] = [1.0, 0.0]
    heads, value = made.heads_and_value(tensors(observed))
    (heads.mean.sum() + heads.hold_logit.sum() + value.sum()).backward()
    actions, values = made.action_head.weight.grad, made.value_head.weight.grad
    assert actions is not None and values is not None
    assert (actions[:8] != 0).any() and (values[0] != 0).any()
    assert (actions[8:] == 0).all() and (values[1] == 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_training_starts_where_the_settings_say(kind):
    settings = NetworkSettings(kind=kind, hold_probability=0.15, forward_mean=0.4, log_std=-0.8)
    with torch.no_grad():
        heads = TeamActorCritic(settings)(tensors(rows(200)))
    assert float(torch.sigmoid(heads.hold_logit).mean()) == pytest.approx(0.15, abs=0.02)
    torch.testing.assert_close(heads.mean.mean(0), torch.tensor([0.4, 0, 0, 0, 0, 0, 0]), atol=0.05, rtol=0)
    assert float(heads.mean.std(0).max()) < 0.1
    torch.testing.assert_close(heads.log_std, torch.full((7,), -0.8))


@pytest.mark.parametrize("yaw", [0.0, 0.6, math.pi / 2, 2.5, -1.2, math.pi])
def test_probes_turn_with_the_body(yaw):
    """A wall fills the half plane ahead of the robot: probes ahead see it, those behind do not, at every heading."""
    cells = torch.arange(16) - 8.0
    i, j = torch.meshgrid(cells, cells, indexing="ij")
    window = torch.full((1, 3, 16, 16), -1.0)
    window[0, 1] = torch.where(i * math.cos(yaw) + j * math.sin(yaw) > 0, 1.0, -1.0)
    heading = torch.tensor([math.cos(yaw)]), torch.tensor([math.sin(yaw)])
    ground, obstacle = BodyProbes()(window, *heading).view(2, -1, PROBE_DIRECTIONS)
    assert (ground == -1.0).all()
    ahead, behind = [7, 0, 1], [3, 4, 5]
    assert (obstacle[1:, ahead] > 0.6).all()
    assert (obstacle[1:, behind] < -0.6).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "atention"}, "network.kind: got 'atention', expected one of attention, mlp"),
        ({"width": 0}, "network.width: got 0, expected 1 to 4096"),
        ({"depth": 0}, "network.depth: got 0, expected 1 to 8 layers"),
        ({"heads": 5}, "network.mate_width: got 32, expected a multiple of heads = 5, at most 4096"),
        ({"heads": 0}, "network.heads: got 0, expected 1 to 32 (mate_width)"),
        ({"channels": (8,)}, "network.channels: got (8,), expected two numbers from 1 to 256"),
        ({"log_std": math.nan}, "network.log_std: got nan, expected -4 to 1"),
        ({"hold_probability": 1.0}, "network.hold_probability: got 1.0, expected between 0 and 1"),
        ({"forward_mean": -2.0}, "network.forward_mean: got -2.0, expected -1 to 1"),
    ],
)
def test_settings_out_of_range_are_refused_in_one_line(values, message):
    with pytest.raises(ConfigError) as caught:
        replace(NetworkSettings(), **values)
    assert str(caught.value) == message

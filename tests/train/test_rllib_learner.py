"""Silent rows teach PPO of RLlib nothing about acting, and leave the size of the other advantages alone."""

from __future__ import annotations

import torch
from ray.rllib.core.columns import Columns
from ray.rllib.evaluation.postprocessing import Postprocessing

from train.rllib_env import FLAT_SIZE
from train.rllib_learner import SilenceSilent


def test_advantages_of_silent_rows_are_zero_and_the_others_have_mean_0_and_deviation_1() -> None:
    generator = torch.Generator().manual_seed(0)
    observations = torch.zeros(200, FLAT_SIZE)
    observations[:, -1] = (torch.rand(200, generator=generator) < 0.6).float()
    valid = torch.rand(200, generator=generator) < 0.9
    raw = 3.0 + 5.0 * torch.randn(200, generator=generator)
    targets = torch.randn(200, generator=generator)
    columns = {Columns.OBS: observations, Columns.LOSS_MASK: valid}
    columns |= {Postprocessing.ADVANTAGES: raw.clone(), Postprocessing.VALUE_TARGETS: targets.clone()}
    got = SilenceSilent()(batch={"picket": dict(columns)})["picket"]
    acting = (observations[:, -1] > 0.5) & valid
    advantages = got[Postprocessing.ADVANTAGES]
    assert (advantages[~acting] == 0.0).all()
    torch.testing.assert_close(advantages[acting].mean(), torch.tensor(0.0), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(advantages[acting].std(correction=0), torch.tensor(1.0), atol=1e-5, rtol=0.0)
    order = raw[acting].argsort()
    assert (advantages[acting][order].diff() >= 0.0).all()
    torch.testing.assert_close(got[Postprocessing.VALUE_TARGETS], targets)


def test_a_batch_in_which_nobody_acts_is_silent() -> None:
    columns = {Columns.OBS: torch.zeros(4, FLAT_SIZE), Columns.LOSS_MASK: torch.ones(4, dtype=torch.bool)}
    columns[Postprocessing.ADVANTAGES] = torch.ones(4)
    got = SilenceSilent()(batch={"picket": columns})["picket"]
    assert not got[Postprocessing.ADVANTAGES].any()

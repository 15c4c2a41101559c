"""TorchRL takes the environment through its own wrapper; the example of the documentation makes a step of PPO."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
import torch
from torchrl.envs.libs.pettingzoo import PettingZooWrapper

from tests.test_documents import blocks
from tests.train.scripted_parallel import ScriptedTeam


def wrapped(team: Any) -> PettingZooWrapper:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "PettingZoo in TorchRL", UserWarning)
        return PettingZooWrapper(team, use_mask=True, done_on_any=False)


@pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL:UserWarning")
def test_the_documented_step_of_ppo() -> None:
    (program,) = (block for block in blocks("docs/training_libraries.md", "python") if "torchrl" in block)
    names: dict[str, Any] = {}
    head, tail = program.split("\nfor role, model in models.items():")
    exec(head, names)
    old = parameters(names["models"])
    exec(f"for role, model in models.items():{tail}", names)
    new = parameters(names["models"])
    assert all(torch.isfinite(value).all() for value in new.values())
    assert names["env"].group_map == {"observer": ["observer_0"], "picket": ["picket_0", "picket_1"]}
    assert names["rollout"].shape == (100,) and torch.isfinite(names["total"])
    for role in ("observer", "picket"):
        for part in (0, 1):
            mine = [name for name in new if name.startswith(f"{role} {part}")]
            assert mine and any((old[name] != new[name]).any() for name in mine)


def parameters(models: dict[str, Any]) -> dict[str, torch.Tensor]:
    """All parameters: of actors 0, of critics 1."""
    return {
        f"{role} {k} {name}": value.detach().clone()
        for role, model in models.items()
        for k, network in enumerate(model)
        for name, value in network.named_parameters()
    }


def test_masks_say_who_is_left_and_the_team_plays_on() -> None:
    script = [{}, {"picket_0": "lost"}, {}, {"picket_1": "lost", "observer_0": "late"}]
    env = wrapped(ScriptedTeam(("observer_0", "picket_0", "picket_1"), script))
    course = env.rollout(8, break_when_any_done=False)
    assert course["observer", "mask"].squeeze(-1).tolist() == [True] * 8
    assert course["picket", "mask"].tolist() == [[True, True], [True, True], [False, True], [False, True]] * 2
    assert course["next", "done"].squeeze(-1).tolist() == [False, False, False, True] * 2
    assert course["next", "picket", "reward"][:4, 1, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    last = course[3]["next"]
    assert last["observer", "truncated"].item() and not last["observer", "terminated"].item()
    assert last["picket", "terminated"][1].item() and not last["picket", "truncated"][1].item()

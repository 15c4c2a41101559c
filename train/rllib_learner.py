"""PPO's learner of RLlib, told that silent robots make no choice: their rows teach the value and not the policy."""

from __future__ import annotations

from typing import Any

from ray.rllib.algorithms.ppo.torch.ppo_torch_learner import PPOTorchLearner
from ray.rllib.connectors.connector_v2 import ConnectorV2
from ray.rllib.core.columns import Columns
from ray.rllib.evaluation.postprocessing import Postprocessing


class SilenceSilent(ConnectorV2):
    """Sets the advantages of rows whose last entry, ``acting``, is 0 to 0, and scales the others back to one size."""

    def __call__(self, *, batch: dict[str, Any], **context: Any) -> dict[str, Any]:  # noqa: ARG002  RLlib's interface
        for columns in batch.values():
            acting = columns[Columns.OBS][..., -1] > 0.5
            counts = acting & columns[Columns.LOSS_MASK].bool()
            chosen = columns[Postprocessing.ADVANTAGES][counts]
            advantages = columns[Postprocessing.ADVANTAGES].clone().fill_(0.0)
            if chosen.numel() > 1:
                advantages[counts] = (chosen - chosen.mean()) / chosen.std(correction=0).clamp(min=1e-4)
            columns[Postprocessing.ADVANTAGES] = advantages
        return batch


class TeamPPOLearner(PPOTorchLearner):
    """PPO that ignores what silent robots answer; see `train.rllib_env`."""

    def build(self) -> None:
        super().build()
        assert self._learner_connector is not None
        self._learner_connector.append(SilenceSilent())

"""`TeamActorCritic`: one network for every robot of a team, which tells roles apart by the robot's own observation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from coop_envs.actions import ACTION_NAMES, ACTION_SIZE
from coop_envs.observations import MATE_SIZE, MATES, SELF_FIELDS, SELF_SIZE
from policies.map_encoder import POOLED, PROBES, BodyProbes, MapEncoder, pooled, scaled
from policies.mates_attention import MatesAttention
from policies.network_settings import NetworkSettings
from policies.normaliser import Normaliser

__all__ = ["Heads", "NetworkSettings", "TeamActorCritic"]

ROLES = 2  # the first entries of ``self``: observer, picket
_FIELD = {field.name: k for k, field in enumerate(SELF_FIELDS)}
COS_YAW, SIN_YAW = _FIELD["cos_yaw"], _FIELD["sin_yaw"]
FORWARD = ACTION_NAMES.index("forward_speed")
LOG_STD_LIMITS = (-4.0, 1.0)


@dataclass(frozen=True)
class Heads:
    """What a distribution of actions is made of.

    ``hold_logit`` (n,) is the log-odds of holding, ``mean`` (n, 7) and ``log_std`` (7,) are of the other entries, in
    the order of `ACTION_NAMES`. Means are not bounded: the action is clipped at its limits.
    """

    hold_logit: Tensor
    mean: Tensor
    log_std: Tensor


@dataclass(frozen=True)
class _Reading:
    """An observation as the layers want it: normalised, absent mates zero, the map in [-1, 1]."""

    own: Tensor
    mates: Tensor
    seen: Tensor
    window: Tensor
    probes: Tensor


class _AttentionEncoder(nn.Module):
    """Self, map and mates by a part each; the robot's own state asks for the mates."""

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        self.own = nn.Sequential(nn.Linear(SELF_SIZE + PROBES, settings.width), nn.ReLU())
        self.map = MapEncoder(settings.channels, settings.width)
        self.mates = MatesAttention(MATE_SIZE, settings.width, settings.mate_width, settings.heads)
        self.size = 2 * settings.width + settings.mate_width

    def forward(self, reading: _Reading) -> Tensor:
        own = self.own(torch.cat([reading.own, reading.probes], dim=-1))
        mates = self.mates(own, reading.mates, reading.seen)
        return torch.cat([own, self.map(reading.window), mates], dim=-1)


class _FlatEncoder(nn.Module):
    """Nothing learned: every number side by side, the map in blocks of 4 x 4 cells."""

    size = SELF_SIZE + PROBES + MATES * (MATE_SIZE + 1) + POOLED

    def forward(self, reading: _Reading) -> Tensor:
        mates = [reading.mates.flatten(1), reading.seen]
        return torch.cat([reading.own, reading.probes, *mates, pooled(reading.window)], dim=-1)


class TeamActorCritic(nn.Module):
    """Heads of the action's distribution, and the value of the team's future, from each robot's observation.

    Observations are tensors: ``self`` (n, 29), ``mates`` (n, 7, 16), ``mask`` (n, 7), ``map`` (n, 3, 16, 16) of 0 to
    255, integer or float; other keys are left alone. Absent mates have no influence. Each role has last layers of
    its own.
    """

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        self.normaliser = Normaliser(SELF_SIZE, MATE_SIZE)
        self.probes = BodyProbes()
        self.encoder = _encoder(settings)
        self.value_encoder = _encoder(settings) if settings.separate_value else None
        hidden = [settings.width] * settings.depth
        self.actor = _dense([self.encoder.size, *hidden])
        self.critic = _dense([self.encoder.size, *hidden])
        self.action_head = nn.Linear(settings.width, ROLES * ACTION_SIZE)
        self.value_head = nn.Linear(settings.width, ROLES)
        self.log_std = nn.Parameter(torch.full((ACTION_SIZE - 1,), settings.log_std))
        self._start()

    def _start(self) -> None:
        """Orthogonal weights; actions that start near the settings' and hardly depend on the observation."""
        for module in self.modules():
            if isinstance(module, (nn.Linear, nn.Conv2d)):
                nn.init.orthogonal_(module.weight, gain=math.sqrt(2.0))
                assert module.bias is not None
                nn.init.zeros_(module.bias)
        nn.init.orthogonal_(self.action_head.weight, gain=0.01)
        nn.init.orthogonal_(self.value_head.weight, gain=1.0)
        p = self.settings.hold_probability
        with torch.no_grad():
            bias = self.action_head.bias.view(ROLES, ACTION_SIZE)
            bias[:, 0] = math.log(p / (1.0 - p))
            bias[:, FORWARD] = self.settings.forward_mean

    def forward(self, observations: dict[str, Tensor]) -> Heads:
        """The action's distribution for each row."""
        return self._heads(self.encoder(self._read(observations)), observations)

    def value(self, observations: dict[str, Tensor]) -> Tensor:
        """What the team may expect, seen from each row (n,)."""
        encoder = self.value_encoder or self.encoder
        return self._value(encoder(self._read(observations)), observations)

    def heads_and_value(self, observations: dict[str, Tensor]) -> tuple[Heads, Tensor]:
        """`forward` and `value` for the price of one encoding, unless the value has its own."""
        reading = self._read(observations)
        features = self.encoder(reading)
        apart = self.value_encoder(reading) if self.value_encoder is not None else features
        return self._heads(features, observations), self._value(apart, observations)

    def _read(self, observations: dict[str, Tensor]) -> _Reading:
        raw, seen = observations["self"].float(), observations["mask"] > 0
        own, mates = self.normaliser(raw, observations["mates"].float())
        mates = torch.where(seen.unsqueeze(-1), mates, torch.zeros_like(mates))
        window = scaled(observations["map"])
        probes = self.probes(window, raw[:, COS_YAW], raw[:, SIN_YAW])
        return _Reading(own, mates, seen.float(), window, probes)

    def _heads(self, features: Tensor, observations: dict[str, Tensor]) -> Heads:
        actions = _of_role(self.action_head(self.actor(features)), observations)
        return Heads(actions[:, 0], actions[:, 1:], self.log_std.clamp(*LOG_STD_LIMITS))

    def _value(self, features: Tensor, observations: dict[str, Tensor]) -> Tensor:
        return _of_role(self.value_head(self.critic(features)), observations)[:, 0]


def _encoder(settings: NetworkSettings) -> _AttentionEncoder | _FlatEncoder:
    return _AttentionEncoder(settings) if settings.kind == "attention" else _FlatEncoder()


def _dense(sizes: list[int]) -> nn.Sequential:
    return nn.Sequential(*(part for a, b in pairwise(sizes) for part in (nn.Linear(a, b), nn.ReLU())))


def _of_role(outputs: Tensor, observations: dict[str, Tensor]) -> Tensor:
    """Of outputs (n, roles x k) those of the row's role (n, k)."""
    role = observations["self"][:, :ROLES].float()
    return (outputs.unflatten(-1, (ROLES, -1)) * role.unsqueeze(-1)).sum(1)

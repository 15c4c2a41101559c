"""The distribution of a robot's action: to hold or not, and seven Gaussian entries of which only some have an effect.

Forward, yaw and pitch count only while the robot does not hold, the scan's entries only while it does, the scan's
centre only if a scan is requested, and what a robot lacks never. Entries without effect leave probability and entropy,
so that no gradient flows through them.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from coop_envs.actions import ACTION_NAMES
from policies.networks import Heads

_PLACE = {name: k - 1 for k, name in enumerate(ACTION_NAMES)}  # among the seven after hold
REQUEST = _PLACE["scan_request"]
MOTION = [_PLACE[name] for name in ("forward_speed", "yaw_rate", "pitch_rate")]
CENTRE = [_PLACE[name] for name in ("scan_azimuth", "scan_elevation")]
_HALF_LOG_TAU = 0.5 * math.log(2.0 * math.pi)


class TeamActionDistribution:
    """Actions (n, 8) in the order of `ACTION_NAMES`; entry 0 is -1 (go) or 1 (hold).

    ``action_mask`` (n, 8) is 1 for the entries that the row's robot has; without it, it has all.
    """

    def __init__(self, heads: Heads, action_mask: Tensor | None = None) -> None:
        self.hold_logit, self.mean = heads.hold_logit, heads.mean
        self.log_std = heads.log_std.expand_as(heads.mean)
        mask = torch.ones_like(heads.mean) if action_mask is None else action_mask[:, 1:].to(heads.mean.dtype)
        self._has = mask

    @property
    def hold_probability(self) -> Tensor:
        """(n,)"""
        return torch.sigmoid(self.hold_logit)

    def sample(self, generator: torch.Generator | None = None) -> Tensor:
        """Actions at random, not clipped: `log_prob` wants them so; clip what is sent to the robots."""
        with torch.no_grad():
            draw = torch.rand(self.hold_logit.shape, generator=generator, device=self.mean.device)
            noise = torch.randn(self.mean.shape, generator=generator, device=self.mean.device)
            hold = torch.where(draw < self.hold_probability, 1.0, -1.0)
            return torch.cat([hold.unsqueeze(-1), self.mean + self.log_std.exp() * noise], dim=-1)

    def mode(self) -> Tensor:
        """The likeliest action, in [-1, 1]."""
        hold = torch.where(self.hold_logit > 0, 1.0, -1.0)
        return torch.cat([hold.unsqueeze(-1), self.mean.clamp(-1.0, 1.0)], dim=-1)

    def log_prob(self, actions: Tensor) -> Tensor:
        """Log-density (n,) of those entries of actions that have an effect."""
        holds = actions[:, 0] > 0
        hold = functional.logsigmoid(torch.where(holds, self.hold_logit, -self.hold_logit))
        z = (actions[:, 1:] - self.mean) * (-self.log_std).exp()
        each = -0.5 * z**2 - self.log_std - _HALF_LOG_TAU
        requested = actions[:, 1 + REQUEST] > 0
        return hold + (each * self._effective(holds.float(), requested.float())).sum(-1)

    def entropy(self) -> Tensor:
        """Entropy (n,): of holding, and that of the entries with an effect, expected over what decides on them."""
        p = self.hold_probability
        hold = functional.softplus(self.hold_logit) - p * self.hold_logit
        each = self.log_std + _HALF_LOG_TAU + 0.5
        requested = torch.special.ndtr(self.mean[:, REQUEST] * (-self.log_std[:, REQUEST]).exp())
        return hold + (each * self._effective(p, requested)).sum(-1)

    def _effective(self, hold: Tensor, requested: Tensor) -> Tensor:
        """How much each of the seven entries counts (n, 7), for (chances of) holding and of a request (n,)."""
        weights = list(torch.ones_like(self.mean).unbind(-1))
        for k in MOTION:
            weights[k] = 1.0 - hold
        weights[REQUEST] = hold
        for k in CENTRE:
            weights[k] = hold * requested
        return torch.stack(weights, dim=-1) * self._has

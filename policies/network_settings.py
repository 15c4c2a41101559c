"""What a learned policy's network is made of, as plain data: it is written into the policy's file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from coop_envs.errors import require
from coop_envs.validation import STRICT

NetworkKind = Literal["attention", "mlp"]


@dataclass(frozen=True)
class NetworkSettings:
    """Sizes and starting point of a `policies.networks.TeamActorCritic`.

    ``attention`` reads the map by convolutions and attends over the mates; ``mlp`` reads a pooled map and the list of
    mates, and is several times faster. ``width`` is that of every dense layer, ``depth`` how many of them the action
    and the value each have. ``mate_width`` and ``heads`` are the attention's, ``channels`` those of the two
    convolutions. With ``separate_value`` the value has an encoder of its own. Training starts at ``log_std`` of the
    seven continuous entries, at ``hold_probability``, and at ``forward_mean`` of the forward speed (in [-1, 1]).
    """

    __pydantic_config__ = STRICT
    kind: NetworkKind = "attention"
    width: int = 64
    depth: int = 2
    mate_width: int = 32
    heads: int = 4
    channels: tuple[int, int] = (8, 16)
    separate_value: bool = False
    log_std: float = -0.5
    hold_probability: float = 0.2
    forward_mean: float = 0.0

    def __post_init__(self) -> None:
        kinds = get_args(NetworkKind)
        require(self.kind in kinds, "network.kind", self.kind, f"one of {', '.join(kinds)}")
        require(1 <= self.width <= 4096, "network.width", self.width, "1 to 4096")
        require(1 <= self.depth <= 8, "network.depth", self.depth, "1 to 8 layers")
        require(1 <= self.heads <= self.mate_width, "network.heads", self.heads, f"1 to {self.mate_width} (mate_width)")
        divides = self.mate_width <= 4096 and self.mate_width % self.heads == 0
        require(divides, "network.mate_width", self.mate_width, f"a multiple of heads = {self.heads}, at most 4096")
        fits = len(self.channels) == 2 and all(1 <= c <= 256 for c in self.channels)
        require(fits, "network.channels", self.channels, "two numbers from 1 to 256")
        require(-4.0 <= self.log_std <= 1.0, "network.log_std", self.log_std, "-4 to 1")
        probable = 0.0 < self.hold_probability < 1.0
        require(probable, "network.hold_probability", self.hold_probability, "between 0 and 1")
        require(-1.0 <= self.forward_mean <= 1.0, "network.forward_mean", self.forward_mean, "-1 to 1")

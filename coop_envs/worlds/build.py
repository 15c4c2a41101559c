"""From a geometry to a world that a team can start in; training and held-out worlds never share a seed."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, Protocol

import numpy as np

from coop_envs.errors import require
from coop_envs.worlds.media import MEDIA
from coop_envs.worlds.placement import Footprint, check_placement
from coop_envs.worlds.world import World

Split = Literal["train", "heldout"]
SPLITS = ("train", "heldout")


class Geometry(Protocol):
    """What builds the ground, hazards, starts and goal of a world."""

    @property
    def kind(self) -> str: ...

    def build(self, team: Sequence[Footprint], rng: np.random.Generator) -> World: ...


def build_world(
    geometry: Geometry,
    team: Sequence[Footprint],
    *,
    split: Split = "train",
    index: int = 0,
    friction: float = 0.8,
    albedo: float = 0.6,
    ambient_lux: float = 0.0,
    medium: str = "air",
    particulate: float = 0.0,
) -> World:
    """World number ``index`` of a split.

    Raises: `WorldError` where the ground is unfit or a robot cannot stand at its start.
    """
    rng = np.random.default_rng(world_seed(split, index))
    world = replace(
        geometry.build(team, rng),
        friction=friction,
        albedo=albedo,
        ambient_lux=ambient_lux,
        medium=replace(MEDIA[medium], particulate=particulate),
    )
    check_placement(world, team)
    return world


def world_seed(split: Split, index: int) -> int:
    """A 64-bit seed: 63 bits hashed from the index, the lowest tells held-out from training."""
    require(split in SPLITS, "split", split, "train or heldout")
    require(index >= 0, "index", index, "0 or more")
    digest = hashlib.blake2b(f"{split} {index}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 1 << 1 | SPLITS.index(split)

"""What an evaluation reports of each episode: names, units and meanings, from ``metrics.yaml``."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from importlib import resources
from typing import Literal

import yaml


@dataclass(frozen=True)
class Metric:
    """A figure of an episode.

    ``better`` says which way is good, None where neither is. ``scale`` leads from the recorded value to the ``unit``
    in which it is shown with so many ``decimals``.
    """

    name: str
    label: str
    meaning: str = ""
    unit: str = ""
    better: Literal["higher", "lower"] | None = None
    decimals: int = 2
    scale: float = 1.0

    def text(self, value: object) -> str:
        """The value as shown: counts whole, truths as yes or no, a dash where there is none."""
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, int) and self.scale == 1.0:
            return f"{value:,}"
        if not isinstance(value, int | float) or not math.isfinite(value):
            return "–"
        return f"{value * self.scale:,.{self.decimals}f}"


@functools.cache
def known_metrics() -> tuple[Metric, ...]:
    """Every metric that an evaluation knows, in the order of its tables."""
    text = resources.files("coop_envs.viewer").joinpath("metrics.yaml").read_text(encoding="utf-8")
    return tuple(Metric(**entry) for entry in yaml.safe_load(text))

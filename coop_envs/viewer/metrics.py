"""What an evaluation reports of each episode: names, units and meanings, from ``metrics.yaml``."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal

import yaml

LEAST_PAIRS = 6
"""Of fewer pairs not even equal signs in all would be significant at 5 % (two-sided sign test)."""


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
        return f"{value * self.scale:z,.{self.decimals}f}"

    def interval(self, entry: Mapping[str, Any]) -> str:
        """The interval of an estimate with ``low``, ``high`` and ``n``; one episode alone tells none."""
        return "1 episode" if entry.get("n") == 1 else f"{self.text(entry['low'])} to {self.text(entry['high'])}"

    @staticmethod
    def is_clear(entry: Mapping[str, Any]) -> bool:
        """Whether the interval of a difference leaves out zero, and enough pairs of episodes stand behind it."""
        low, high = entry["low"], entry["high"]
        return entry["n"] >= LEAST_PAIRS and low is not None and high is not None and low * high > 0


LOST_PER_AREA = Metric("pickets_lost_per_mapped_m2", "Pickets lost per mapped area", unit="1/m2", better="lower")


@functools.cache
def known_metrics() -> tuple[Metric, ...]:
    """Every metric that an evaluation knows, in the order of its tables."""
    text = resources.files("coop_envs.viewer").joinpath("metrics.yaml").read_text(encoding="utf-8")
    return tuple(Metric(**entry) for entry in yaml.safe_load(text))


def compared_metrics(names: Iterable[str]) -> list[Metric]:
    """The metrics of these names, with those that are only told as differences between policies."""
    known = {metric.name: metric for metric in (*known_metrics(), LOST_PER_AREA)}
    return [known.get(name) or Metric(name, name) for name in names]

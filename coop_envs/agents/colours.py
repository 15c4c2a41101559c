"""Who wears which colours: hats of one shape are told apart by where on them each colour sits.

The LEDs' colours are free to be set (thesis section 4.3.1), their places are not.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from typing import Any


@functools.cache
def arrangements(leds: int, count: int) -> tuple[tuple[int, ...], ...]:
    """``count`` ways to spread so many colours over as many LEDs; no two agree on more LEDs than they must.

    Two hats are mistaken for one another only where they agree on four LEDs.
    """
    for shared in range(leds + 1):
        chosen: list[tuple[int, ...]] = []
        for order in itertools.permutations(range(leds)):
            if all(sum(a == b for a, b in zip(order, other, strict=True)) <= shared for other in chosen):
                chosen.append(order)
            if len(chosen) == count:
                return tuple(chosen)
    return tuple(chosen[k % len(chosen)] for k in range(count))


def with_distinct_hats(members: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Members of a team as mappings; those with the same hat as another get its colours in another arrangement."""
    alike: dict[str, list[int]] = {}
    for i, member in enumerate(members):
        hat = member.get("hat")
        if isinstance(hat, Mapping) and isinstance(hat.get("leds"), list | tuple):
            alike.setdefault(repr(hat["leds"]), []).append(i)
    out = [dict(member) for member in members]
    for wearers in alike.values():
        for i, order in zip(wearers, _orders(out[wearers[0]]["hat"]["leds"], len(wearers)), strict=True):
            out[i]["hat"] = _recoloured(out[i]["hat"], order)
    return out


def _orders(leds: Sequence[Any], count: int) -> tuple[tuple[int, ...], ...]:
    plain = count == 1 or not all(isinstance(led, Mapping) and "hue_deg" in led for led in leds) or len(leds) > 8
    return (tuple(range(len(leds))),) * count if plain else arrangements(len(leds), count)


def _recoloured(hat: Mapping[str, Any], order: Sequence[int]) -> dict[str, Any]:
    leds = hat["leds"]
    if list(order) == list(range(len(leds))):
        return dict(hat)
    changed = [{**led, "hue_deg": leds[k]["hue_deg"]} for led, k in zip(leds, order, strict=True)]
    return {**hat, "leds": type(leds)(changed)}

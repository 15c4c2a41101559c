"""From a battery's voltage to its charge and back: a straight line between full and empty.

Lithium cells of nominally 3.6 to 3.7 V read 4.2 V when full and about 3.2 V when they should be taken off; between, the
line is good to a tenth of the charge or so.
"""

from __future__ import annotations

from coop_envs.agents.specification import Battery

FULL, EMPTY = 4.2 / 3.6, 3.2 / 3.6
"""Shares of the nominal voltage."""


def voltage_v(battery: Battery, charge: float) -> float:
    """Voltage of a battery with this share of its charge left."""
    return battery.voltage_v * (EMPTY + charge * (FULL - EMPTY))


def charge(battery: Battery, voltage: float) -> float:
    """Share of the charge that is left at a voltage, 0 to 1."""
    return min(max((voltage / battery.voltage_v - EMPTY) / (FULL - EMPTY), 0.0), 1.0)

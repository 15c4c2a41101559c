"""Voltage and charge of a battery."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_team
from hardware_bridge.battery import charge, voltage_v

BATTERY = load_team("surveyors").members[0].robot.battery


@given(st.floats(0.0, 1.0))
def test_charge_and_voltage_are_each_others_inverse(share):
    assert charge(BATTERY, voltage_v(BATTERY, share)) == pytest.approx(share, abs=1e-12)


def test_two_cells_of_a_zumy():
    """7.2 V nominal are two lithium cells: 8.4 V full, 6.4 V to be taken off."""
    assert BATTERY.voltage_v == 7.2
    assert voltage_v(BATTERY, 1.0) == pytest.approx(8.4)
    assert voltage_v(BATTERY, 0.0) == pytest.approx(6.4)
    assert charge(BATTERY, 7.4) == pytest.approx(0.5)


def test_beyond_full_and_empty_there_is_nothing():
    assert charge(BATTERY, 9.0) == 1.0
    assert charge(BATTERY, 0.0) == 0.0

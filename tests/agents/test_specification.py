from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from coop_envs.agents import load_camera, load_hat, load_robot
from coop_envs.agents.catalog import names
from coop_envs.errors import ConfigError

ZUMY, ROACH = load_robot("zumy"), load_robot("velociroach")


def power_w(matrix, state):
    return float(np.array(state) @ np.array(matrix) @ np.array(state))


def test_robots_are_those_of_table_2_1():
    assert (ZUMY.mass_kg, ZUMY.height_m, ZUMY.max_speed_m_s) == (0.325, 0.12, 1.0)
    assert (ROACH.mass_kg, ROACH.height_m, ROACH.max_speed_m_s) == (0.045, 0.09, 2.7)
    assert pytest.approx(7.2 * 0.850 * 3600) == ZUMY.battery.energy_j
    assert pytest.approx(3.7 * 0.120 * 3600) == ROACH.battery.energy_j


@pytest.mark.parametrize(
    ("state", "watts"),
    [((0, 0, 0, 1), 7.56), ((0.1, 0, 0, 1), 7.70), ((0, 0.5, 0, 1), 7.569), ((0.1, 0, 1, 1), 7.70 + 0.336)],
)
def test_zumys_power_has_the_measured_values(state, watts):
    assert power_w(ZUMY.power.robot, state) == pytest.approx(watts, abs=1e-3)


def test_leds_and_scanner_draw_the_measured_power():
    assert power_w(ZUMY.power.marker, (9 * 255, 1)) == pytest.approx(0.918)
    assert power_w(ZUMY.power.marker, (18 * 255, 1)) == pytest.approx(1.836)
    assert power_w(ZUMY.power.scanner, (1, 0, 1)) == pytest.approx(0.5)
    assert power_w(ZUMY.power.scanner, (0, 1, 1)) == pytest.approx(0.05)


def test_velociroach_draws_its_own_power_and_pays_its_own_weight_uphill():
    assert power_w(ROACH.power.robot, (0.3, 2.0, 0, 1)) == pytest.approx(2.7)
    climbing = power_w(ROACH.power.robot, (0.1, 0, 1, 1)) - 2.7
    assert climbing == pytest.approx(ROACH.mass_kg * 9.81 * 0.1, rel=1e-3)


@pytest.mark.parametrize("name", names("hats"))
def test_every_hat_has_distinct_hues_and_leds_that_are_not_in_a_plane(name):
    hat = load_hat(name)
    points = np.array([led.position_m for led in hat.leds])
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    assert spread[2] > 0.01
    assert np.abs(points).max() < 0.15


def test_cameras_see_what_their_makers_say():
    def across_deg(camera):
        return np.degrees(2 * np.arctan(camera.width_px / 2 / camera.fx_px))

    assert across_deg(load_camera("lifecam")) == pytest.approx(50, abs=1)
    assert across_deg(load_camera("ch6")) == pytest.approx(70, abs=0.1)
    assert load_camera("ch6").position_m[2] + ZUMY.body_height_m == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("zummy", r"^robot: got 'zummy'.*velociroach_radio, zumy; did you mean 'zumy'\?"),
        ({"base": "zumy", "masss_kg": 1}, r"^robot\.masss_kg: .*did you mean 'mass_kg'\?"),
        ({"base": "zumy", "height_m": "30 cm"}, r"^robot\.height_m: got '30 cm', expected a number in metres"),
        ({"base": "zumy", "mass_kg": -1}, r"robot zumy\.mass_kg: got -1.0, expected more than 0"),
        ({"base": "zumy", "mass_kg": float("nan")}, r"robot\.mass_kg: got nan, expected a finite number"),
        ({"base": "zumy", "contact_radius_m": 1}, r"contact_radius_m: .*at most body_radius_m"),
        ({"base": "zumy", "battery": {"voltage_v": 7.2}}, r"^robot\.battery\.capacity_mah: got None, expected a value"),
        ({"name": "bare"}, r"^robot\.mass_kg: got None, expected a value in kilograms"),
    ],
)
def test_bad_robots_are_refused_in_one_line(reference, message):
    with pytest.raises(ConfigError, match=message) as caught:
        load_robot(reference)
    assert "\n" not in str(caught.value)


def test_bad_hats_and_matrices_are_refused():
    hat = load_hat("hat0")
    with pytest.raises(ConfigError, match="4 to 8 LEDs"):
        replace(hat, leds=hat.leds[:3])
    with pytest.raises(ConfigError, match="each hue once"):
        replace(hat, leds=hat.leds[:4] + hat.leds[:1])
    with pytest.raises(ConfigError, match="a symmetric matrix"):
        replace(ZUMY.power, marker=((0.0, 1.0), (2.0, 0.0)))


def test_a_mount_that_shakes_too_much_is_refused():
    with pytest.raises(ConfigError, match=r"camera\.shake_rad: got 0\.5, expected 0 to 0\.2 rad"):
        replace(load_camera("lifecam"), shake_rad=0.5)

"""Where the battery's energy goes, against integrals of eq (6.16) done by SciPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from coop_envs.agents.catalog import load_hat
from coop_envs.agents.specification import Battery, Laser
from coop_envs.simulation.parameters import marker_sum
from coop_envs.simulation.state import Status
from coop_envs.worlds.world import Hazard
from tests.simulation.builders import (
    ROACH,
    ZUMY,
    calm,
    clock_of,
    command,
    ground_of,
    physics_of,
    prompt,
    run,
    status,
    team_of,
    world_of,
)

IDLE, MOTION, MARKERS, SCANNER = range(4)
DEAD = Battery(voltage_v=1.0, capacity_mah=10.0 / 3.6)
"""A battery of 10 J."""


def energy(physics, index=0):
    """Joules drawn so far: idle, motion, markers, scanner."""
    return physics.state.energy.numpy()[0, index].copy()


@pytest.mark.parametrize(
    ("speed", "yaw_rate", "watts"), [(0.0, 0.0, 7.56), (0.1, 0.0, 7.70), (0.0, 0.5, 7.569), (-0.1, 0.0, 7.70)]
)
def test_a_zumy_draws_what_its_authors_model_gives(speed, yaw_rate, watts):
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot))
    command(physics, robot, speed, yaw_rate)
    run(physics, 2.0)
    assert energy(physics).sum() / 2.0 == pytest.approx(watts, abs=5e-4)


def test_a_roach_draws_2_7_watts_whatever_it_does():
    robot = prompt(ROACH)
    physics = physics_of(team_of(robot))
    command(physics, robot, 0.5)
    run(physics, 2.0)
    assert energy(physics).sum() / 2.0 == pytest.approx(2.7, abs=1e-4)


def test_the_lights_scanner_and_mirrors_have_accounts_of_their_own():
    team = team_of(prompt(ZUMY))
    physics = physics_of(replace(team, members=(replace(team.members[0], laser=Laser()),)))
    physics.command.brightness.numpy()[:] = 1.0
    physics.command.laser.numpy()[:] = 0.6
    run(physics, 1.0)
    assert energy(physics)[[IDLE, MOTION]] == pytest.approx([7.56, 0.0], abs=1e-4)
    assert energy(physics)[MARKERS] == pytest.approx(0.918, abs=1e-5)
    assert energy(physics)[SCANNER] == pytest.approx(0.05 * 0.6, abs=1e-6)
    physics.command.galvo.numpy()[:] = (3, 0)
    run(physics, 1.0)
    moving = 30 * 3 * 0.01  # thirty moves of three counts of 10 ms
    assert energy(physics)[SCANNER] == pytest.approx(2 * 0.05 * 0.6 + 0.5 * moving, abs=1e-5)


def test_a_white_hat_costs_twice_a_coloured_one():
    """Red, green and blue light one channel of three, cyan, magenta and yellow two: 2295 against 4590 for white."""
    assert marker_sum(load_hat("hat0")) == pytest.approx(4590 / 2)
    assert marker_sum(None) == 0.0


def test_energy_of_a_start_is_the_integral_of_the_power():
    robot = calm(ZUMY, drive_lag_s=0.3)
    physics = physics_of(team_of(robot), clock=clock_of(1.0 / 600.0, 1, 120))
    command(physics, robot, 0.5, 2.0)
    run(physics, 2.0)

    def power(t):
        share = 1.0 - np.exp(-t / 0.3)
        return 14.0 * (0.5 * share) ** 2 + 0.035 * (2.0 * share) ** 2

    assert energy(physics)[MOTION] == pytest.approx(quad(power, 0.0, 2.0)[0], rel=5e-3)


@pytest.mark.parametrize("uphill", [True, False])
def test_climbing_lifts_the_robots_weight(uphill):
    angle, speed = 0.2, 0.1
    robot = prompt(ZUMY, slope_slip=0.0)
    world = world_of(ground_of(lambda x, y: np.tan(angle) * x), [(0.0, 0.0, 0.0 if uphill else np.pi)])
    physics = physics_of(team_of(robot), world)
    command(physics, robot, speed)
    start = physics.state.position.numpy()[0, 0, 2]
    run(physics, 2.0)
    lifted = physics.state.position.numpy()[0, 0, 2] - start
    weight = 3.36
    assert energy(physics)[MOTION] == pytest.approx(14.0 * speed**2 * 2.0 + weight * lifted, abs=2e-3)


def test_rolling_downhill_does_not_charge_the_battery():
    robot = prompt(ZUMY)
    bank = world_of(ground_of(lambda x, y: -np.tan(0.45) * x))
    physics = physics_of(team_of(robot), bank)
    command(physics, robot, 0.2)
    drawn = np.array(run(physics, 3.0, lambda: energy(physics).sum()))
    assert np.all(np.diff(drawn) >= 0.0)


def test_a_trapped_robot_draws_its_motion_power():
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot), world_of(hazards=[Hazard("trap", (0.0, 0.0), radius_m=0.5)]))
    command(physics, robot, 0.3)
    run(physics, 0.2)
    assert status(physics) == Status.TRAPPED
    before = energy(physics)[MOTION]
    run(physics, 2.0)
    assert energy(physics)[MOTION] - before == pytest.approx(2.0 * 14.0 * 0.09, rel=1e-3)


def test_a_docked_robot_draws_nothing():
    physics = physics_of(team_of(ZUMY, ROACH, reserves=1), world_of(starts=[(0.0, 0.0, 0.0)] * 2))
    physics.command.wheels.numpy()[:] = 5.0
    physics.command.brightness.numpy()[:] = 1.0
    run(physics, 1.0)
    assert np.all(energy(physics, 1) == 0.0)
    assert physics.measurements.battery.numpy()[0, 1] == 1.0


def test_the_battery_is_empty_when_its_energy_is_used():
    robot = replace(prompt(ZUMY), battery=DEAD)
    physics = physics_of(team_of(robot))
    command(physics, robot, 0.3)
    lasts = 10.0 / (7.56 + 14.0 * 0.09)
    run(physics, np.floor(lasts / 0.2) * 0.2)
    assert status(physics) == Status.ACTIVE
    assert physics.measurements.battery.numpy()[0, 0] == pytest.approx(
        1.0 - np.floor(lasts / 0.2) * 0.2 / lasts, abs=1e-4
    )
    run(physics, 0.2)
    assert status(physics) == Status.DEPLETED
    assert energy(physics).sum() == pytest.approx(10.0, abs=(7.56 + 1.26) / 30.0)
    assert physics.measurements.battery.numpy()[0, 0] == 0.0
    assert physics.measurements.heard.numpy()[0, 0] == 0
    spent, place = energy(physics), physics.state.position.numpy().copy()
    run(physics, 1.0)
    np.testing.assert_array_equal(energy(physics), spent)
    np.testing.assert_array_equal(physics.state.position.numpy(), place)

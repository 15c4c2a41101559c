"""Free motion: laws of kinematics on level ground and slopes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from coop_envs.simulation.state import Status
from tests.simulation.builders import (
    DECISION_S,
    ROACH,
    ZUMY,
    calm,
    clock_of,
    command,
    ground_of,
    physics_of,
    position,
    prompt,
    run,
    status,
    team_of,
    wheels_of,
    world_of,
    yaw,
)


@pytest.mark.parametrize("robot", [ZUMY, ROACH], ids=lambda robot: robot.name)
@pytest.mark.parametrize("speed", [0.1, -0.3])
def test_a_straight_drive_covers_speed_times_time(robot, speed):
    robot = prompt(robot)
    physics = physics_of(team_of(robot), world_of(starts=[(0.2, -0.1, 0.7)]))
    command(physics, robot, speed)
    run(physics, 2.0)
    covered = position(physics)[:2] - (0.2, -0.1)
    np.testing.assert_allclose(covered, 2.0 * speed * np.array([np.cos(0.7), np.sin(0.7)]), atol=1e-4)
    assert position(physics)[2] == pytest.approx(robot.body_height_m)
    assert physics.state.path.numpy()[0, 0] == pytest.approx(2.0 * abs(speed), rel=1e-4)


def test_opposed_wheels_turn_on_the_spot():
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot))
    command(physics, robot, 0.0, 1.3)
    run(physics, 2.0)
    assert yaw(physics) == pytest.approx(2.6, abs=1e-4)
    np.testing.assert_allclose(position(physics)[:2], 0.0, atol=1e-6)


@pytest.mark.parametrize(("speed", "yaw_rate"), [(0.2, 0.8), (0.2, -0.8), (-0.3, 1.5)])
def test_steady_wheels_drive_a_circle(speed, yaw_rate):
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot))
    command(physics, robot, speed, yaw_rate)
    way = np.array(run(physics, 6.0, lambda: position(physics)[:2]))
    centre = np.array([0.0, speed / yaw_rate])
    np.testing.assert_allclose(np.linalg.norm(way - centre, axis=1), abs(speed / yaw_rate), rtol=2e-4)
    heading = np.arctan2(np.sin(yaw_rate * 6.0), np.cos(yaw_rate * 6.0))
    assert yaw(physics) == pytest.approx(heading, abs=2e-4)


def test_wheels_follow_with_their_time_constant():
    robot = calm(ZUMY, drive_lag_s=0.4)
    physics = physics_of(team_of(robot))
    command(physics, robot, 0.5)
    speeds = np.array(run(physics, 2.0, lambda: physics.state.wheels.numpy()[0, 0, 0] * robot.wheel_radius_m))
    after = DECISION_S * np.arange(1, 11)
    np.testing.assert_allclose(speeds, 0.5 * (1.0 - np.exp(-after / 0.4)), rtol=1e-4)
    command(physics, robot, 0.0)
    slowing = np.array(run(physics, 1.0, lambda: physics.state.wheels.numpy()[0, 0, 0] * robot.wheel_radius_m))
    np.testing.assert_allclose(slowing, speeds[-1] * np.exp(-after[:5] / 0.4), rtol=1e-4)
    run(physics, 4.0)
    assert np.all(physics.state.wheels.numpy() == 0.0)


def test_encoders_count_what_the_wheels_turned():
    robot = calm(ZUMY, drive_lag_s=0.3)
    physics = physics_of(team_of(robot))
    command(physics, robot, 0.4)
    wheels = run(physics, 1.0, lambda: physics.measurements.wheels.numpy()[0, 0].astype(float))
    turned = np.sum(wheels, axis=0) * DECISION_S * robot.wheel_radius_m
    np.testing.assert_allclose(turned, position(physics)[0], rtol=1e-4)


def drive_a_curve(substeps):
    """End point of a curved drive from rest with lagging wheels."""
    robot = calm(ZUMY, drive_lag_s=0.3)
    physics = physics_of(team_of(robot), clock=clock_of(substeps=substeps))
    command(physics, robot, 0.4, 2.0)
    run(physics, 1.2)
    return np.append(position(physics)[:2], yaw(physics))


def test_the_error_falls_at_least_with_the_time_step():
    finest = drive_a_curve(64)
    errors = [np.linalg.norm(drive_a_curve(n) - finest) for n in (1, 2, 4, 8)]
    assert all(coarse > 1.8 * fine for coarse, fine in pairwise(errors))
    assert errors[2] < 0.02


def test_the_way_from_rest_is_the_integral_of_the_lag():
    robot = calm(ZUMY, drive_lag_s=0.3)
    physics = physics_of(team_of(robot), clock=clock_of(substeps=64))
    command(physics, robot, 0.4)
    run(physics, 1.2)
    assert position(physics)[0] == pytest.approx(0.4 * (1.2 - 0.3 * (1.0 - np.exp(-4.0))), rel=1e-3)


def test_slip_wanders_with_its_deviation_and_time():
    robot = calm(ZUMY, slip=0.1, slip_time_s=0.5)
    physics = physics_of(team_of(robot), teams=2000)
    slips = np.array(run(physics, 4.0, lambda: physics.state.slip.numpy()[:, 0].copy()))
    sample = slips.shape[1] * 2
    assert np.std(slips[0]) == pytest.approx(0.1, rel=4 / np.sqrt(2 * sample))
    assert np.std(slips[-1]) == pytest.approx(0.1, rel=4 / np.sqrt(2 * sample))
    assert np.corrcoef(slips[-1, :, 0], slips[-1, :, 1])[0, 1] == pytest.approx(0.0, abs=4 / np.sqrt(2000))
    for lag in (1, 3, 10):
        found = np.mean(slips[-1] * slips[-1 - lag]) / 0.01
        assert found == pytest.approx(np.exp(-lag * DECISION_S / 0.5), abs=5 / np.sqrt(sample))


def test_slip_spreads_the_way_of_a_straight_drive():
    """Both sides' slips are Ornstein-Uhlenbeck; the way's variance is (v sigma)^2 tau (T - tau (1 - e^-T/tau))."""
    robot = prompt(ZUMY, slip=0.05, slip_time_s=0.5, track_m=100.0)
    physics = physics_of(team_of(robot), teams=2000)
    command(physics, robot, 0.2)
    run(physics, 5.0)
    way = physics.state.position.numpy()[:, 0, 0]
    assert way.mean() == pytest.approx(1.0, abs=0.003)
    expected = 0.2 * 0.05 * np.sqrt(0.5 * (5.0 - 0.5 * (1.0 - np.exp(-10.0))))
    assert way.std() == pytest.approx(expected, rel=0.06)


def incline(angle):
    return ground_of(lambda x, y: np.tan(angle) * x, (-2.0, -1.0, 2.0, 1.0))


def way_on_incline(angle, heading, speed=0.2, **changes):
    """Way in the plane of the slope (along x, along y) gone in 2 s, and where the body ended."""
    robot = prompt(ZUMY, **changes)
    physics = physics_of(team_of(robot), world_of(incline(angle), [(0.0, 0.0, heading)]))
    before = position(physics)
    command(physics, robot, speed)
    run(physics, 2.0)
    moved = position(physics) - before
    assert status(physics) == Status.ACTIVE
    assert moved[2] == pytest.approx(np.tan(angle) * moved[0], abs=1e-4)
    return np.array([moved[0] / np.cos(angle), moved[1]]), physics


@pytest.mark.parametrize("heading", [0.0, 0.5, np.pi / 2, 2.0, np.pi])
def test_without_slip_a_slope_costs_no_way(heading):
    way, _ = way_on_incline(0.35, heading, slope_slip=0.0)
    assert np.linalg.norm(way) == pytest.approx(0.4, rel=1e-4)
    level = way * [np.cos(0.35), 1.0]
    assert np.arctan2(level[1], level[0]) == pytest.approx(heading, abs=1e-4)


def test_climbing_is_slower_and_descending_is_not():
    up, _ = way_on_incline(0.35, 0.0)
    down, _ = way_on_incline(0.35, np.pi)
    assert up[0] == pytest.approx(0.4 * (1.0 - ZUMY.slope_slip * np.sin(0.35)), rel=1e-4)
    assert down[0] == pytest.approx(-0.4, rel=1e-4)


def test_across_a_slope_a_robot_crabs_downhill():
    way, _ = way_on_incline(0.35, np.pi / 2)
    np.testing.assert_allclose(way, [-0.4 * ZUMY.slope_slip * np.sin(0.35), 0.4], rtol=1e-3)


def test_beyond_its_slope_limit_a_robot_gains_no_height():
    up, _ = way_on_incline(ZUMY.max_slope_rad + 0.02, 0.0)
    down, _ = way_on_incline(ZUMY.max_slope_rad + 0.02, np.pi)
    np.testing.assert_allclose(up, 0.0, atol=1e-6)
    assert down[0] == pytest.approx(-0.4, rel=1e-4)


@pytest.mark.parametrize(("angle", "slides"), [(0.10, False), (0.25, True)])
def test_a_robot_at_rest_slides_beyond_the_friction_angle(angle, slides):
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot), world_of(incline(angle), friction=np.tan(0.15)))
    run(physics, 1.0)
    assert (position(physics)[0] < -0.02) == slides


def test_turning_on_a_slope_is_turning_about_its_normal():
    robot = prompt(ZUMY, slope_slip=0.0)
    physics = physics_of(team_of(robot), world_of(incline(0.4)))
    command(physics, robot, 0.0, 1.0)
    before = physics.state.rotation.numpy()[0, 0].astype(float)
    run(physics, 1.0)
    after = physics.state.rotation.numpy()[0, 0].astype(float)
    np.testing.assert_allclose(after[:, 2], before[:, 2], atol=1e-6)
    assert np.arctan2(before[:, 1] @ after[:, 0], before[:, 0] @ after[:, 0]) == pytest.approx(1.0, abs=1e-3)


def test_pitch_and_roll_are_those_of_the_ground():
    physics = physics_of(team_of(prompt(ZUMY)), world_of(incline(0.3), [(0.0, 0.0, np.pi / 3)]))
    R = physics.state.rotation.numpy()[0, 0]
    np.testing.assert_allclose(R[:, 2], [-np.sin(0.3), 0.0, np.cos(0.3)], atol=1e-5)
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(np.pi / 3, abs=1e-5)


def test_wheel_speeds_in_the_tests_turn_counter_clockwise():
    left, right = wheels_of(ZUMY, 0.0, 1.0)
    assert right == -left == pytest.approx(2.5)

"""Walls, steps, edges and other robots."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.simulation.state import Status
from coop_envs.worlds.world import HeightField
from tests.simulation.builders import (
    FLAT,
    ROACH,
    ZUMY,
    calm,
    clock_of,
    command,
    feet,
    ground_of,
    physics_of,
    position,
    prompt,
    run,
    status,
    team_of,
    wheels_of,
    world_of,
)

ROBOTS = pytest.mark.parametrize("robot", [ZUMY, ROACH], ids=lambda robot: robot.name)
CELL_M = 0.01


def rise(height_m, start_x=0.5):
    """Ground that rises by a height within one cell."""
    return ground_of(lambda x, y: np.where(x > start_x - 1e-6, height_m, 0.0), (-1.0, -1.0, 1.5, 1.0), CELL_M)


@ROBOTS
@pytest.mark.parametrize("speed", [0.1, 0.6])
def test_a_wall_stops_the_way_into_it(robot, speed):
    robot = prompt(robot)
    physics = physics_of(team_of(robot), world_of(rise(0.3)))
    command(physics, robot, speed)
    run(physics, 8.0)
    gap = 0.5 - (feet(physics, robot)[0, 0, 0] + robot.body_radius_m)
    assert -CELL_M <= gap <= CELL_M + speed / 120.0
    assert abs(position(physics)[1]) < 1e-3


@pytest.mark.parametrize("angle", [0.5, 1.0, -0.8])
def test_along_a_wall_the_rest_of_the_motion_stays(angle):
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot), world_of(rise(0.3), [(0.3, 0.0, angle)]))
    command(physics, robot, 0.2)
    run(physics, 2.0)
    before = position(physics)[1]
    run(physics, 1.0)
    assert position(physics)[1] - before == pytest.approx(0.2 * np.sin(angle), rel=0.02)
    assert position(physics)[0] < 0.5 - robot.body_radius_m + CELL_M


@ROBOTS
def test_steps_up_to_the_limit_are_climbed_and_higher_ones_are_not(robot):
    for share, climbs in ((0.95, True), (1.35, False)):
        fast = prompt(robot)
        physics = physics_of(team_of(fast), world_of(rise(share * robot.max_step_m)))
        command(physics, fast, 0.2)
        run(physics, 5.0)
        assert status(physics) == Status.ACTIVE
        assert (position(physics)[0] > 0.6) == climbs
        if climbs:
            assert position(physics)[2] == pytest.approx(share * robot.max_step_m + robot.body_height_m, abs=1e-4)


@ROBOTS
@pytest.mark.parametrize("heading", [0.0, 0.26, 0.5])
def test_edges_within_the_drop_limit_are_taken_and_deeper_ones_are_falls(robot, heading):
    for share, outcome in ((0.9, Status.ACTIVE), (1.5, Status.FALLEN), (10.0, Status.FALLEN)):
        fast = prompt(robot)
        world = world_of(rise(-share * robot.max_drop_m), [(0.2, 0.0, heading)])
        physics = physics_of(team_of(fast), world)
        command(physics, fast, 0.2)
        run(physics, 3.0)
        assert status(physics) == outcome
        if outcome == Status.ACTIVE:
            assert position(physics)[0] > 0.6
        else:
            assert 0.5 - robot.body_radius_m < position(physics)[0] < 0.5 + robot.body_radius_m
            assert physics.state.rotation.numpy()[0, 0][2, 2] < 0.0


def test_a_fallen_robot_stays_where_it_lies():
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot), world_of(rise(-0.5)))
    command(physics, robot, 0.5)
    run(physics, 2.0)
    lying = position(physics)
    run(physics, 1.0)
    np.testing.assert_array_equal(position(physics), lying)
    assert np.all(physics.measurements.wheels.numpy() == 0.0)


@ROBOTS
def test_a_robot_bridges_a_crack_narrower_than_itself(robot):
    crack = ground_of(lambda x, y: np.where(np.abs(x - 0.3) < 0.011, -0.5, 0.0), (-1.0, -1.0, 1.5, 1.0), CELL_M)
    fast = prompt(robot)
    physics = physics_of(team_of(fast), world_of(crack))
    command(physics, fast, 0.2)
    run(physics, 4.0)
    assert status(physics) == Status.ACTIVE and position(physics)[0] == pytest.approx(0.8, abs=0.01)


@ROBOTS
@pytest.mark.parametrize("heading", [0.0, np.pi / 4, np.pi / 2, np.pi])
def test_a_slope_is_entered_from_level_ground(robot, heading):
    """A ramp as steep as the robot may climb begins at x = 0.3; it is no wall, whatever the heading on it."""
    angle = 0.9 * robot.max_slope_rad
    ramp = ground_of(lambda x, y: np.tan(angle) * np.maximum(x - 0.3, 0.0), (-1.0, -1.0, 1.5, 1.0), CELL_M)
    fast = prompt(robot, slope_slip=0.0)
    physics = physics_of(team_of(fast), world_of(ramp))
    command(physics, fast, 0.2)
    run(physics, 4.0)
    assert position(physics)[0] == pytest.approx(0.3 + 0.5 * np.cos(angle), abs=0.02)
    up = physics.state.rotation.numpy()[0, 0][:, 2]
    np.testing.assert_allclose(up, [-np.sin(angle), 0.0, np.cos(angle)], atol=1e-4)
    command(physics, fast, 0.0, heading)
    run(physics, 1.0)
    before = position(physics)
    command(physics, fast, 0.1)
    run(physics, 1.0)
    moved = position(physics) - before
    assert np.linalg.norm(moved) == pytest.approx(0.1, rel=0.01)


def test_a_robot_tips_over_where_its_centre_of_mass_leaves_its_base():
    """Half height 6 cm over a base of 5 cm: tan of the limit is 5/6. Down a slope nothing else stops it."""
    for tangent, outcome in ((0.78, Status.ACTIVE), (0.88, Status.FALLEN)):
        bank = ground_of(lambda x, y, t=tangent: np.minimum(0.0, -t * x), (-1.0, -1.0, 1.0, 1.0), CELL_M)
        robot = prompt(ZUMY)
        physics = physics_of(team_of(robot), world_of(bank, [(-0.2, 0.0, 0.0)], friction=2.0))
        command(physics, robot, 0.2)
        run(physics, 3.0)
        assert status(physics) == outcome


def test_the_edge_of_the_world_is_a_wall():
    robot = prompt(ZUMY)
    world = world_of(ground_of(lambda x, y: 0.0 * x, (-0.5, -0.5, 0.5, 0.5), CELL_M))
    physics = physics_of(team_of(robot), world)
    for heading in range(4):
        command(physics, robot, 0.5)
        run(physics, 3.0)
        assert status(physics) == Status.ACTIVE
        assert np.max(np.abs(position(physics)[:2])) <= 0.5 - robot.body_radius_m + 1e-4
        command(physics, robot, 0.0, 1.1 + 0.3 * heading)
        run(physics, 1.0)


# Walls no thinner than the gaps between a robot's rim points: 3.6 cm.
boxes = st.lists(
    st.tuples(st.integers(-75, 60), st.integers(-75, 60), st.integers(4, 40), st.integers(4, 40)),
    min_size=1,
    max_size=6,
)


def boxed(walls) -> HeightField:
    """Ground 1.6 m across inside walls, with those boxes (i, j, width, depth in cells) that leave its middle free."""
    heights = np.full((161, 161), 0.3, dtype=np.float32)
    heights[3:-3, 3:-3] = 0.0
    for i, j, width, depth in walls:
        box = slice(80 + i, 81 + i + width), slice(80 + j, 81 + j + depth)
        middle = max(i, -i - width) < 10 and max(j, -j - depth) < 10
        heights[box] = 0.0 if middle else 0.3
    return HeightField(heights, (-0.8, -0.8), CELL_M)


def wall_depth(ground: HeightField, at, radius_m):
    """How far the nearest wall node reaches into a disc."""
    i, j = np.nonzero(ground.heights_m > 0.1)
    nodes = np.stack([i, j], axis=-1) * ground.cell_m + ground.origin_m
    return radius_m - np.min(np.linalg.norm(nodes - np.asarray(at)[:2], axis=1))


@settings(deadline=None, max_examples=20)
@given(boxes, st.integers(0, 10**6), st.sampled_from([ZUMY, ROACH]))
def test_nobody_gets_into_or_through_walls_at_full_speed(walls, seed, robot):
    ground = boxed(walls)
    physics = physics_of(team_of(robot), world_of(ground), teams=16, seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(6):
        speed = rng.choice([-1.0, 1.0], 16) * robot.max_speed_m_s
        command(physics, robot, speed, rng.uniform(-2.0, 2.0, 16))
        run(physics, 1.0)
        places = physics.state.position.numpy()[:, 0].astype(float)
        assert np.all(np.abs(places[:, :2]) < 0.8)
        np.testing.assert_array_equal(physics.state.status.numpy()[:, 0], Status.ACTIVE)
        deepest = max(wall_depth(ground, place, robot.body_radius_m) for place in places)
        assert deepest < robot.body_radius_m * (1.0 - np.cos(np.pi / 12)) + 2 * CELL_M


@ROBOTS
def test_the_arenas_kerb_holds_its_robots(robot):
    """Nobody climbs its 4 cm, at full speed and whatever the heading."""
    kerb = ground_of(
        lambda x, y: np.where(np.maximum(np.abs(x), np.abs(y)) > 0.4 - 1e-6, 0.04, 0.0), (-0.6, -0.6, 0.6, 0.6), CELL_M
    )
    physics = physics_of(team_of(robot), world_of(kerb), teams=64)
    rng = np.random.default_rng(0)
    for _ in range(10):
        command(physics, robot, rng.uniform(0.1, robot.max_speed_m_s, 64), rng.uniform(-1.0, 1.0, 64))
        run(physics, 1.0)
    inside = 0.4 + CELL_M - robot.body_radius_m * np.cos(np.pi / 12)
    assert np.max(np.abs(physics.state.position.numpy()[:, 0, :2])) < inside


def overlap(physics, *robots):
    """The deepest overlap of two robots of any team, in metres."""
    at, radii = feet(physics, *robots)[..., :2], [robot.body_radius_m for robot in robots]
    gaps = np.linalg.norm(at[:, :, None] - at[:, None], axis=-1) - np.add.outer(radii, radii)
    return -np.min(gaps[:, ~np.eye(len(radii), dtype=bool)])


def test_a_robot_stops_before_another():
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot, robot), world_of(starts=[(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)]))
    command(physics, robot, 0.2)
    run(physics, 4.0)
    gap = position(physics, 1)[0] - position(physics, 0)[0] - 2 * robot.body_radius_m
    assert -1e-6 <= gap <= 0.2 / 120.0
    np.testing.assert_allclose(position(physics, 1)[:2], [0.5, 0.0], atol=1e-6)


def test_a_robot_glides_along_another():
    robot = prompt(ZUMY)
    physics = physics_of(team_of(robot, robot), world_of(starts=[(0.0, 0.05, 0.0), (0.3, 0.0, 0.0)]))
    command(physics, robot, 0.2)
    run(physics, 4.0)
    assert position(physics)[0] > 0.4
    assert overlap(physics, robot, robot) < 1e-5


def test_nobody_squeezes_between_two_robots():
    robot = prompt(ZUMY)
    half = 0.97 * 2 * robot.body_radius_m
    starts = [(0.0, 0.001, 0.0), (0.3, half, 0.0), (0.3, -half, 0.0)]
    physics = physics_of(team_of(robot, robot, robot), world_of(starts=starts))
    command(physics, robot, 0.2)
    run(physics, 6.0)
    assert overlap(physics, robot, robot, robot) < 1e-5
    assert position(physics)[0] < 0.3


def test_nobody_squeezes_between_a_robot_and_a_wall():
    robot = prompt(ZUMY)
    ground = ground_of(lambda x, y: np.where(y > 0.2 - 1e-6, 0.3, 0.0), (-1.0, -1.0, 1.0, 1.0), CELL_M)
    starts = [(0.0, 0.06, 0.3), (0.4, -0.01, 0.0)]
    physics = physics_of(team_of(robot, robot), world_of(ground, starts))
    command(physics, robot, 0.2)
    run(physics, 6.0)
    assert overlap(physics, robot, robot) < 1e-5
    assert position(physics)[0] < 0.4 and position(physics)[1] < 0.2 - robot.body_radius_m + CELL_M


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_robots_never_overlap(seed, substeps):
    robots = [ZUMY, ROACH, ZUMY, ROACH, ROACH]
    starts = [(0.25 * np.cos(a), 0.25 * np.sin(a), a + np.pi) for a in 2 * np.pi * np.arange(5) / 5]
    ground = ground_of(lambda x, y: np.where(np.hypot(x, y) > 0.45, 0.3, 0.0), (-0.6, -0.6, 0.6, 0.6), CELL_M)
    clock = clock_of(substeps=substeps)
    physics = physics_of(team_of(*robots), world_of(ground, starts), teams=8, seed=seed, clock=clock)
    rng = np.random.default_rng(seed)
    for _ in range(8):
        for k, robot in enumerate(robots):
            command(physics, robot, rng.uniform(0.0, 0.5, 8), rng.uniform(-1.0, 1.0, 8), k)
        run(physics, 1.0)
        assert overlap(physics, *robots) < 1e-4


def test_docked_reserves_are_not_in_the_way():
    robot = prompt(ZUMY)
    starts = [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0)]
    physics = physics_of(team_of(robot, robot, reserves=1), world_of(FLAT, starts))
    command(physics, robot, 0.2)
    run(physics, 3.0)
    assert position(physics)[0] == pytest.approx(0.6, abs=1e-3)


def test_a_reserve_undocks_when_called_and_the_dock_is_free():
    robot = prompt(ZUMY)
    starts = [(0.02, 0.0, 0.0), (0.0, 0.0, 0.0)]
    physics = physics_of(team_of(robot, robot, reserves=1), world_of(FLAT, starts, dock=(0.0, 0.0, 1.0)))
    run(physics, 0.4)
    assert status(physics, 1) == Status.DOCKED and physics.measurements.docked.numpy()[0, 1] == 1
    physics.command.undock.numpy()[:] = 1
    run(physics, 0.4)
    assert status(physics, 1) == Status.DOCKED
    command(physics, robot, 0.5)
    run(physics, 0.6)
    command(physics, robot, 0.0)
    assert status(physics, 1) == Status.ACTIVE and physics.measurements.docked.numpy()[0, 1] == 0
    np.testing.assert_allclose(position(physics, 1)[:2], 0.0, atol=1e-6)


def test_a_team_that_does_not_run_stands_still():
    robot = calm(ZUMY)
    physics = physics_of(team_of(robot), teams=2)
    physics.running.numpy()[1] = 0
    physics.command.wheels.numpy()[:] = wheels_of(robot, 0.2, 0.0)
    run(physics, 1.0)
    assert position(physics, team=0)[0] > 0.1
    np.testing.assert_array_equal(position(physics, team=1)[:2], 0.0)
    np.testing.assert_array_equal(physics.state.tick.numpy(), [30, 0])

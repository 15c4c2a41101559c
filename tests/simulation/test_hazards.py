"""Traps, holes and slippery ground."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.simulation.state import Status
from coop_envs.worlds.world import Hazard
from tests.simulation.builders import (
    FLAT,
    ROACH,
    ZUMY,
    command,
    physics_of,
    position,
    prompt,
    run,
    status,
    team_of,
    world_of,
)


def outline(hazard: Hazard):
    """The hazard's shape as shapely draws it."""
    (x, y), (a, b) = hazard.centre_m, hazard.half_size_m
    box = shapely.box(x - a, y - b, x + a, y + b) if min(a, b) > 0 else shapely.Point(x, y)
    turned = shapely.affinity.rotate(box, hazard.yaw_rad, origin=(x, y), use_radians=True)
    return turned.buffer(hazard.radius_m, quad_segs=64)


hazards = st.builds(
    Hazard,
    kind=st.just("trap"),
    centre_m=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    half_size_m=st.tuples(st.floats(0.05, 0.3), st.floats(0.05, 0.3)),
    radius_m=st.floats(0.0, 0.1),
    yaw_rad=st.floats(-3.0, 3.0),
)


@settings(deadline=None, max_examples=25)
@given(hazards, st.sampled_from([ZUMY, ROACH]), st.integers(0, 100))
def test_a_trap_holds_whoever_reaches_into_it(hazard, robot, seed):
    places = np.random.default_rng(seed).uniform(-0.9, 0.9, (64, 2))
    physics = physics_of(team_of(prompt(robot)), world_of(hazards=[hazard]), teams=64)
    state = physics.state.position.numpy()
    state[:, 0, :2] = places
    physics.step()
    distance = np.array([outline(hazard).distance(shapely.Point(*place)) for place in places])
    sure = np.abs(distance - robot.contact_radius_m) > 1e-3
    caught = physics.state.status.numpy()[:, 0] == Status.TRAPPED
    np.testing.assert_array_equal(caught[sure], (distance < robot.contact_radius_m)[sure])


def drive_at(hazard, *others, robot=ZUMY, speed=0.2, seconds=3.0):
    """Drive from the origin along x; the physics afterwards."""
    robot = prompt(robot)
    physics = physics_of(team_of(robot), world_of(hazards=[hazard, *others]))
    command(physics, robot, speed)
    run(physics, seconds)
    return physics


def test_a_trap_stops_a_robot_where_its_contact_disc_touches():
    physics = drive_at(Hazard("trap", (0.4, 0.0), (0.1, 0.1)))
    assert status(physics) == Status.TRAPPED
    touch = 0.3 - ZUMY.contact_radius_m
    assert touch - 1e-4 <= position(physics)[0] <= touch + 0.2 / 30.0 + 1e-4
    assert np.all(physics.measurements.wheels.numpy() > 0.0)
    held = position(physics)
    run(physics, 1.0)
    np.testing.assert_array_equal(position(physics), held)


def test_a_hole_swallows_a_robot_whose_contact_disc_touches_it():
    physics = drive_at(Hazard("hole", (0.4, 0.0), radius_m=0.1))
    assert status(physics) == Status.SWALLOWED
    edge = 0.3 - ZUMY.contact_radius_m
    assert edge <= position(physics)[0] <= edge + 0.2 / 30.0 + 1e-4
    assert physics.measurements.heard.numpy()[0, 0] == 0
    assert np.all(physics.measurements.wheels.numpy() == 0.0)


def test_a_hole_beside_the_way_is_passed():
    physics = drive_at(Hazard("hole", (0.4, 0.16), radius_m=0.1))
    assert status(physics) == Status.ACTIVE and position(physics)[0] == pytest.approx(0.6, abs=1e-3)


@pytest.mark.parametrize("trap_first", [True, False])
def test_a_hole_in_a_trap_swallows(trap_first):
    pair = [Hazard("trap", (0.4, 0.0), radius_m=0.1), Hazard("hole", (0.35, 0.0), radius_m=0.2)]
    physics = drive_at(*(pair if trap_first else pair[::-1]))
    assert status(physics) == Status.SWALLOWED


def test_slippery_ground_scales_the_motion_while_the_centre_is_on_it():
    physics = drive_at(Hazard("slippery", (0.3, 0.0), (0.1, 0.5), motion_scale=0.25), seconds=1.0)
    assert position(physics)[0] == pytest.approx(0.2, abs=0.002)
    run(physics, 2.0)
    assert position(physics)[0] == pytest.approx(0.3, abs=0.002)
    run(physics, 3.0)
    assert position(physics)[0] == pytest.approx(0.6, abs=0.005)
    assert np.allclose(physics.state.wheels.numpy(), 0.2 / ZUMY.wheel_radius_m)


def test_the_slipperiest_of_overlapping_patches_counts():
    pair = [Hazard("slippery", (0.0, 0.0), radius_m=0.5, motion_scale=s) for s in (0.2, 0.6)]
    physics = drive_at(*pair, seconds=2.0)
    assert position(physics)[0] == pytest.approx(0.08, abs=1e-3)


def test_each_world_has_its_own_hazards():
    robot = prompt(ZUMY)
    worlds = [
        world_of(FLAT, hazards=[Hazard("hole", (0.2, 0.0), radius_m=0.05), Hazard("trap", (9.0, 9.0), radius_m=0.1)]),
        world_of(FLAT),
        world_of(FLAT, hazards=[Hazard("trap", (0.3, 0.0), radius_m=0.05)]),
    ]
    physics = physics_of(team_of(robot), *worlds, teams=3, chosen_worlds=[2, 1, 0])
    command(physics, robot, 0.2)
    run(physics, 3.0)
    assert [status(physics, team=b) for b in range(3)] == [Status.TRAPPED, Status.ACTIVE, Status.SWALLOWED]


def test_reset_brings_the_lost_back():
    physics = drive_at(Hazard("trap", (0.4, 0.0), (0.1, 0.1)))
    physics.reset(np.ones(1, np.int32), np.ones(1, np.uint64), np.zeros(1, np.int32))
    assert status(physics) == Status.ACTIVE
    np.testing.assert_allclose(position(physics), [0.0, 0.0, ZUMY.body_height_m], atol=1e-6)
    assert np.all(physics.state.energy.numpy() == 0.0) and np.all(physics.state.path.numpy() == 0.0)

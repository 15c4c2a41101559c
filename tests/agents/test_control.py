from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_team
from coop_envs.agents.command import allocate_command
from coop_envs.agents.control import ACTION_NAMES, action_mask, control, drive_models
from coop_envs.agents.raster import Raster, laser_models
from coop_envs.device import prepare
from coop_envs.geometry.arrays import allocate

SCOUTS = load_team("scouts")
ROBOTS = len(SCOUTS.members)
WAITING, AT_WORK, LOST = 0, 1, 2
TICKS, TICK_S = 6, 1 / 30

numbers = st.floats(-1.0, 1.0, width=32)
actions_of_one = st.tuples(*[numbers] * len(ACTION_NAMES))


def controlled(action, robot=0, team=SCOUTS, declared=AT_WORK, called=0, collect=False):
    """Commands (by name) of one robot that acts; the others of the team hold."""
    device, n = prepare("cpu"), len(team.members)
    actions = np.zeros((1, n, len(ACTION_NAMES)), dtype=np.float32)
    actions[:, :, 0], actions[0, robot] = 1.0, action
    flags = np.full((1, n), AT_WORK, dtype=np.int32), np.zeros((1, n), dtype=np.int32)
    flags[0][0, robot], flags[1][0, robot] = declared, called
    command = allocate_command(1, n, TICKS, device)
    inputs = [wp.array(a, device=device) for a in (actions, *flags, np.zeros(1, dtype=np.int32))]
    scanner = laser_models(team, TICK_S, device), allocate(Raster, (1, n), device)
    wp.launch(
        control,
        (1, n),
        inputs=[*inputs, drive_models(team, collect, device), *scanner, command, wp.ones(1, dtype=int)],
        device=device,
    )
    return {
        name: getattr(command, name).numpy()[0, robot] for name in ("wheels", "brightness", "hold", "undock", "collect")
    }


def action(**entries):
    """An action that does not hold, with these entries."""
    return [entries.get(name, -1.0 if name == "hold" else 0.0) for name in ACTION_NAMES]


def motion(wheels, robot=0):
    """Forward speed and yaw rate of a differential drive with these wheel speeds."""
    rim = wheels.astype(float) * SCOUTS.members[robot].robot.wheel_radius_m
    return rim.mean(), (rim[1] - rim[0]) / SCOUTS.members[robot].robot.track_m


@settings(deadline=None)
@given(actions_of_one, st.floats(0.0, 1.0, exclude_min=True, width=32), st.integers(0, ROBOTS - 1))
def test_hold_is_exactly_zero(entries, hold, robot):
    command = controlled([hold, *entries[1:]], robot)
    assert np.all(command["wheels"] == 0.0) and command["hold"] == 1


@pytest.mark.parametrize("robot", [0, 1])
@pytest.mark.parametrize(("forward", "yaw"), [(1.0, 0.0), (-0.5, 0.0), (0.0, 1.0), (0.3, -0.7)])
def test_actions_scale_to_cruise_speeds(robot, forward, yaw):
    member = SCOUTS.members[robot]
    command = controlled(action(forward_speed=forward, yaw_rate=yaw), robot)
    speed, yaw_rate = motion(command["wheels"], robot)
    assert speed == pytest.approx(forward * member.cruise_speed_m_s, abs=1e-6)
    assert yaw_rate == pytest.approx(yaw * member.cruise_yaw_rate_rad_s, abs=1e-5)
    assert command["hold"] == 0


def test_the_right_wheel_is_the_faster_one_in_a_left_turn():
    left, right = controlled(action(forward_speed=1.0, yaw_rate=1.0))["wheels"]
    assert right > left > 0


def fast_team():
    """A team that asks its drives for all they can do at once."""
    members = [
        replace(m, cruise_speed_m_s=m.robot.max_speed_m_s, cruise_yaw_rate_rad_s=m.robot.max_yaw_rate_rad_s)
        for m in SCOUTS.members
    ]
    return replace(SCOUTS, members=tuple(members))


@settings(deadline=None)
@given(numbers, numbers, st.sampled_from([0, 1]))
def test_saturation_keeps_the_curvature(forward, yaw, robot):
    team = fast_team()
    drive = team.members[robot].robot
    command = controlled(action(forward_speed=forward, yaw_rate=yaw), robot, team)
    speed, yaw_rate = motion(command["wheels"], robot)
    wanted = forward * drive.max_speed_m_s, yaw * drive.max_yaw_rate_rad_s
    rims = np.abs(command["wheels"]) * drive.wheel_radius_m
    assert np.all(rims <= drive.max_speed_m_s * (1 + 1e-5))
    assert speed * wanted[1] == pytest.approx(yaw_rate * wanted[0], abs=1e-4)
    reachable = max(abs(wanted[0] - s * wanted[1] * drive.track_m / 2) for s in (-1, 1)) <= drive.max_speed_m_s
    if reachable:
        assert (speed, yaw_rate) == pytest.approx(wanted, abs=1e-4)
    else:
        assert rims.max() == pytest.approx(drive.max_speed_m_s, rel=1e-5)


@settings(deadline=None)
@given(actions_of_one)
def test_actions_beyond_their_range_are_clipped(entries):
    loud, clipped = (
        controlled([-1.0, *(5.0 * np.array(entries[1:]))]),
        controlled([-1.0, *np.clip(5.0 * np.array(entries[1:]), -1, 1)]),
    )
    for name, value in loud.items():
        np.testing.assert_array_equal(value, clipped[name])


@pytest.mark.parametrize(("entry", "level"), [(-1.0, 0.0), (0.0, 0.5), (1.0, 1.0)])
def test_brightness_runs_from_dark_to_full(entry, level):
    assert controlled(action(marker_brightness=entry))["brightness"] == level


@settings(deadline=None)
@given(actions_of_one, st.sampled_from([WAITING, LOST]))
def test_who_waits_or_is_lost_stands_with_its_hat_lit(entries, declared):
    command = controlled([-1.0, *entries[1:]], 1, declared=declared)
    assert np.all(command["wheels"] == 0.0) and command["hold"] == 1 and command["brightness"] > 0


def test_reserves_leave_the_dock_when_called():
    assert controlled(action(), 5, declared=WAITING, called=1)["undock"] == 1
    assert controlled(action(), 5, declared=WAITING)["undock"] == 0


@pytest.mark.parametrize(
    ("declared", "collect", "taken"), [(LOST, True, 1), (LOST, False, 0), (AT_WORK, True, 0), (WAITING, True, 0)]
)
def test_only_the_lost_are_collected(declared, collect, taken):
    assert controlled(action(), 1, declared=declared, collect=collect)["collect"] == taken


def test_masks_name_what_a_robot_has():
    def used(member):
        return {name for name, bit in zip(ACTION_NAMES, action_mask(member), strict=True) if bit}

    wheels, scanner = {"hold", "forward_speed", "yaw_rate"}, {"scan_request", "scan_azimuth", "scan_elevation"}
    observer, surveyor = SCOUTS.members[0], load_team("surveyors").members[0]
    assert used(observer) == wheels | {"marker_brightness"}
    assert used(replace(observer, hat=None)) == wheels
    assert used(surveyor) == wheels | scanner | {"marker_brightness"}

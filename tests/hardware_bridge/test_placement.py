"""Hats are looked for where people say they set the robots down: wrong starts, lenses and hats show at once."""

from __future__ import annotations

from dataclasses import replace

import pytest

from coop_envs.agents.catalog import load_hat
from coop_envs.agents.team import Team
from coop_envs.errors import ConfigError
from coop_envs.scenario import load_scenario
from hardware_bridge.cameras.simulator_camera import SimulatorCameraSettings, frame_of
from hardware_bridge.deployment import Deployment, Site, Wiring
from hardware_bridge.emulators.emulated_world import EmulatedWorld
from hardware_bridge.links.simulator_udp import SimulatorUdpSettings
from hardware_bridge.placement import check_places
from hardware_bridge.seeing import Seeing


@pytest.fixture(scope="module")
def seen():
    """A deployment as the emulated people set it down, and a dozen frames of every camera."""
    scenario = load_scenario("rubble", fidelity="features")
    world = EmulatedWorld(scenario, "heldout", 0, seed=3)
    site = world.site()
    plan, members = site["plan"], scenario.team.members
    robots = {
        member.name: Wiring(SimulatorUdpSettings("simulator", robot=i), SimulatorCameraSettings("simulator"))
        for i, member in enumerate(members)
    }
    place = Site(tuple(tuple(pose) for pose in plan["start"]), tuple(plan["corner"]))
    deployment = Deployment(scenario.team, robots, place, seeing=Seeing(**site["seeing"]))
    frames = {member.name: [] for member in members}
    for points in world.set_points:
        points.brightness = 0.8
    for _ in range(12):
        world.step()
        for i, member in enumerate(members):
            frame = frame_of(world.state_of(i), 0.0)
            assert frame is not None
            frames[member.name].append(frame)
    return deployment, frames


def with_member(deployment: Deployment, place: int, **changes) -> Deployment:
    members = list(deployment.team.members)
    members[place] = replace(members[place], **changes)
    return replace(deployment, team=Team(deployment.team.name, tuple(members)))


def test_robots_where_they_should_be_are_told(seen):
    lines = check_places(*seen)
    assert [line.split(" from ")[0].rsplit(" ", 2)[0] for line in lines] == [
        "observer_0 sees picket_0",
        "observer_0 sees picket_1",
    ]
    assert all(float(line.split()[3]) < 3.0 for line in lines), lines


def test_a_robot_that_stands_elsewhere_is_refused(seen):
    deployment, frames = seen
    start = list(deployment.site.start)
    start[1] = (start[1][0] + 0.4, start[1][1], 0.0)
    elsewhere = replace(deployment, site=replace(deployment.site, start=tuple(start)))
    with pytest.raises(ConfigError, match=r"site\.start of picket_0: got '\(0\.5.*seen by observer_0.*calibration"):
        check_places(elsewhere, frames)


def test_a_wrong_calibration_is_refused(seen):
    deployment, frames = seen
    camera = deployment.team.members[0].camera
    wrong = replace(camera, fx_px=1.5 * camera.fx_px, fy_px=1.5 * camera.fy_px)
    with pytest.raises(ConfigError, match="the camera's calibration"):
        check_places(with_member(deployment, 0, cameras=(wrong,)), frames)


def test_a_hat_of_another_size_is_refused(seen):
    deployment, frames = seen
    hat = load_hat("hat0")
    leds = tuple(
        replace(led, position_m=(2.0 * led.position_m[0], 2.0 * led.position_m[1], 2.0 * led.position_m[2]))
        for led in deployment.team.members[1].hat.leds
    )
    with pytest.raises(ConfigError, match="picket_0"):
        check_places(with_member(deployment, 1, hat=replace(hat, leds=leds)), frames)


def test_without_frames_nothing_is_said(seen):
    assert check_places(seen[0], {}) == []
    assert check_places(seen[0], {"observer_0": ()}) == []

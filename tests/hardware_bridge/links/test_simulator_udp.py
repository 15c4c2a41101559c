"""The link to a simulator's robot, over a real socket to a real server."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.errors import ConfigError, CoopError
from hardware_bridge.command import RobotCommand
from hardware_bridge.link import LinkError
from hardware_bridge.links.simulator_udp import SimulatorUdpLink, SimulatorUdpSettings, _sample
from tests.hardware_bridge.emulated import rubble, serving
from tests.hardware_bridge.fake_simulator import safe
from tests.hardware_bridge.ros import until


@pytest.fixture(scope="module")
def server():
    with serving(rubble(), lockstep=False) as server:
        yield server


@pytest.fixture
def link(server):
    robot = server.world.scenario.team.members[1].robot
    link = SimulatorUdpLink(
        "picket_0", robot, SimulatorUdpSettings("simulator", port=server.address[1], robot=1), clock
    )
    yield link
    link.close()


def clock():
    return 12.5


def test_it_says_who_answered(link, server):
    identity = link.connect()
    assert (identity.kind, identity.version) == ("simulator", "picket_0")
    assert identity.address == f"udp:127.0.0.1:{server.address[1]}"


def test_reports_come_stamped_by_both_clocks(link):
    link.connect()
    sample = until(link.read)[0]
    assert sample.host_s == 12.5
    assert 0.0 < sample.device_s < 600.0
    assert math.hypot(*sample.accel_m_s2) == pytest.approx(9.81, abs=1.0)
    assert sample.voltage_v == pytest.approx(8.4, abs=0.1)


def test_what_was_sent_is_returned_and_turns_the_wheels(link, server):
    link.connect()
    sent = link.send(safe(2.0, 1.0, brightness=0.5))
    assert sent == RobotCommand((2.0, 1.0), 0.5)
    until(lambda: [s for s in link.read() if s.wheels_rad_s[0] > 1.0])
    link.stop()
    until(lambda: server.world.truth()["set_wheels"][1] == [0.0, 0.0])


def test_wheels_are_clipped_to_what_the_robot_can_do(link, server):
    link.connect()
    limit = server.world.scenario.team.members[1].robot
    most = limit.max_speed_m_s / limit.wheel_radius_m
    assert link.send(safe(1e9, -1e9)).wheels_rad_s == (most, -most)
    link.stop()


def test_closing_stops_and_may_be_done_twice(link, server):
    link.connect()
    link.send(safe(2.0, 2.0))
    until(lambda: server.world.truth()["set_wheels"][1] == [2.0, 2.0])
    link.close()
    until(lambda: server.world.truth()["set_wheels"][1] == [0.0, 0.0])
    link.close()
    link.stop()
    assert link.read() == []


def test_only_a_supervisors_commands_pass(link):
    link.connect()
    with pytest.raises(CoopError, match="expected a supervisor's output"):
        link.send(RobotCommand())


def test_nobody_there_is_told(server):
    robot = server.world.scenario.team.members[1].robot
    link = SimulatorUdpLink("x", robot, SimulatorUdpSettings("simulator", port=9, robot=0), clock)
    with pytest.raises(LinkError, match="expected a running simulator"):
        link.connect()
    link.close()


def test_a_port_that_is_none_is_refused():
    with pytest.raises(ConfigError, match=r"link\.port"):
        SimulatorUdpSettings("simulator", port=70_000)


@given(
    st.dictionaries(
        st.sampled_from(["gyro", "accel", "angles", "wheels", "time_s", "voltage", "powered"]),
        st.none() | st.booleans() | st.floats() | st.lists(st.floats() | st.integers() | st.none(), max_size=4),
    )
)
def test_nonsense_is_no_sample(parts):
    sample = _sample({"kind": "state", **parts}, 1.0)
    assert sample is None or all(math.isfinite(v) for v in sample.angles_rad)

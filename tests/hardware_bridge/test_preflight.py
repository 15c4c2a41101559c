"""Before anything moves: robots that are silent, move, lie on their side or are flat are refused, in one line."""

from __future__ import annotations

import pytest

from coop_envs.errors import ConfigError
from hardware_bridge.clocks import WallClock
from hardware_bridge.link import Identity, LinkError
from hardware_bridge.preflight import connect_all, listen
from hardware_bridge.reading import Sample
from tests.hardware_bridge.emulated import rubble, serving, settled

UPRIGHT = Sample(0.0, None, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0, 0.01), (0.0, 0.1, 9.8), 8.0)


@pytest.fixture(scope="module")
def deployment():
    with serving(rubble()) as server:
        return settled(server)


class Robot:
    """Says the same every time it is asked."""

    def __init__(self, name, *samples, fails=False):
        self.name, self._samples, self._fails, self.closed = name, list(samples), fails, False

    def connect(self):
        if self._fails:
            raise LinkError(f"{self.name}: got nobody, expected a robot")
        return Identity("zumy", "1", "here")

    def read(self):
        return list(self._samples)

    def send(self, command):
        return command

    def stop(self):
        pass

    def close(self):
        self.closed = True


def heard(deployment, sample):
    names = [member.name for member in deployment.team.members]
    links = {name: Robot(name, UPRIGHT) for name in names}
    links[names[1]] = Robot(names[1], *([sample] if sample else []))
    assert listen(deployment, links, {}, WallClock(), lambda: None) == {}


def test_a_team_at_rest_passes(deployment):
    heard(deployment, UPRIGHT)


def altered(**changes):
    return Sample(**{**vars(UPRIGHT), **changes})


@pytest.mark.parametrize(
    ("sample", "field"),
    [
        (None, "reports"),
        (altered(wheels_rad_s=(2.0, 0.0)), "wheels"),
        (altered(gyro_rad_s=(0.0, 0.0, 0.5)), "gyro"),
        (altered(accel_m_s2=(9.8, 0.0, 0.1)), "accel"),
        (altered(accel_m_s2=(0.0, 0.0, 1.0)), "accel"),
        (altered(accel_m_s2=(0.0, 0.0, -9.8)), "accel"),
        (altered(voltage_v=6.4), "battery"),
    ],
)
def test_a_robot_that_makes_no_sense_is_refused_by_name(deployment, sample, field):
    name = deployment.team.members[1].name
    with pytest.raises(ConfigError, match=rf"^robots\.{name}\.{field}: got .*, expected ") as told:
        heard(deployment, sample)
    assert "\n" not in str(told.value)


def test_robots_without_imu_or_voltage_are_only_asked_to_report(deployment):
    heard(deployment, altered(gyro_rad_s=None, accel_m_s2=None, voltage_v=None))


def test_whoever_was_opened_is_closed_when_one_is_not_there():
    links = {"a": Robot("a"), "b": Robot("b", fails=True), "c": Robot("c")}
    told = []
    with pytest.raises(LinkError, match="b: got nobody"):
        connect_all(links, {}, told.append)
    assert [link.closed for link in links.values()] == [True, True, False]
    assert told == ["a: zumy 1 at here"]

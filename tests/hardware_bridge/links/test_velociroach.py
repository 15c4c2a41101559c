"""The VelociRoACH's link against its emulated firmware over a real pseudo-terminal."""

from __future__ import annotations

import time

import pytest

from coop_envs.agents.catalog import load_hat, load_robot
from coop_envs.errors import ConfigError, CoopError
from coop_envs.validation import validated
from hardware_bridge.command import RobotCommand
from hardware_bridge.emulators.velociroach_firmware import VelociroachFirmware
from hardware_bridge.link import LinkError
from hardware_bridge.links.velociroach_xbee import LegTrack, VelociroachSettings, VelociroachXbeeLink
from hardware_bridge.protocols.roach_commands import EXAMPLE_GAINS, Kind, encode_command, encode_profile
from hardware_bridge.protocols.xbee_frames import FrameParser, Transmit, encode
from tests.hardware_bridge.fake_simulator import Emulator, FakeSimulator, safe, wait_until

ROACH, MODULE, KNOWN = load_robot("velociroach"), "velociroach_firmware", ("emulated roach",)
STANDING = [0.0, 0.0]


def link_to(port, now=time.monotonic, hat=None, firmware=KNOWN, **settings):
    return VelociroachXbeeLink("picket", ROACH, hat, VelociroachSettings(port=port, firmware=firmware, **settings), now)


@pytest.fixture
def rig():
    """A simulator, the emulated robot and a connected link."""
    with FakeSimulator() as simulator, Emulator(MODULE, simulator) as emulator:
        link = link_to(emulator.port)
        link.connect()
        yield simulator, emulator, link
        link.close()


def test_who_answers(rig):
    _, emulator, link = rig
    link.close()
    identity = link.connect()
    assert (identity.kind, identity.version) == ("velociroach", "emulated roach 1")
    assert identity.address == f"{emulator.port} 0x2052"


def test_legs_turn_as_sent_and_their_positions_come_back(rig):
    simulator, _, link = rig
    samples = []

    def drive():
        sent = link.send(safe(6.0, -3.0, brightness=1.0, laser=1.0, galvo=(3, 3)))
        assert sent == RobotCommand(sent.wheels_rad_s) and sent.wheels_rad_s == pytest.approx((6.0, -3.0), abs=0.002)
        samples.extend(link.read())
        return sent

    wait_until(lambda: tuple(simulator.wheels) == drive().wheels_rad_s)
    wait_until(lambda: drive() and samples and samples[-1].angles_rad[0] > 3.0)
    last = samples[-1]
    assert last.angles_rad[1] == pytest.approx(-last.angles_rad[0] / 2, abs=0.01)
    assert last.wheels_rad_s[0] > 0 > last.wheels_rad_s[1]
    assert last.device_s is None and last.gyro_rad_s is None and last.accel_m_s2 is None


def test_a_run_that_is_not_renewed_ends_by_itself(rig):
    simulator, _, link = rig
    wait_until(lambda: link.send(safe(5.0, 5.0)) and simulator.wheels[0] > 4.9)
    wait_until(lambda: simulator.wheels == STANDING)


def test_a_stop_stops_and_zero_is_a_stop(rig):
    simulator, _, link = rig
    for halt in (link.stop, lambda: link.send(safe(0.0, 0.0))):
        wait_until(lambda: link.send(safe(5.0, 5.0)) and simulator.wheels[0] > 4.9)
        halt()
        wait_until(lambda: simulator.wheels == STANDING, timeout_s=5.0)


def test_only_a_supervisors_output_is_sent(rig):
    with pytest.raises(CoopError, match="expected a supervisor's output"):
        rig[2].send(RobotCommand())


def test_firmware_that_is_not_known_is_never_driven():
    with FakeSimulator() as simulator, Emulator(MODULE, simulator, "--version", "octoroach 2011") as emulator:
        told = len(simulator.sets)
        with pytest.raises(
            LinkError, match="got firmware 'octoroach 2011', expected one that is known: 'emulated roach'"
        ):
            link_to(emulator.port).connect()
        with pytest.raises(LinkError, match=r"expected one that is known: none is listed in link.firmware"):
            link_to(emulator.port, firmware=()).connect()
        assert all("wheels" not in message for message in simulator.sets[told:])


def test_a_radio_with_nobody_at_the_address(rig):
    _, emulator, link = rig
    link.close()
    with pytest.raises(LinkError, match=r"0x1111: got no answer within 0.3 s, expected a VelociRoACH at 57600 baud"):
        link_to(emulator.port, address=0x1111, connect_s=0.3).connect()


def test_a_hat_that_is_always_lit_is_told():
    with FakeSimulator() as simulator, Emulator(MODULE, simulator, "--hat", "0.5") as emulator:
        link = link_to(emulator.port, hat=load_hat("hat0"), hat_brightness=0.5)
        link.connect()
        assert link.send(safe(brightness=1.0)).brightness == 0.5
        wait_until(lambda: simulator.brightness == 0.5)
        link.close()


def test_a_bad_wire_costs_frames_and_no_more():
    quirks = {"lost": 0.1, "garbled": 0.2, "delay_s": 0.005, "jitter_s": 0.005, "seed": 4}
    with FakeSimulator() as simulator, Emulator(MODULE, simulator, quirks=quirks) as emulator:
        link = link_to(emulator.port, connect_s=10.0)
        link.connect()
        wait_until(lambda: link.send(safe(5.0, 5.0)) and simulator.wheels[0] > 4.9)
        wait_until(lambda: link.dropped > 0)
        wait_until(lambda: link.stop() or simulator.wheels == STANDING)
        link.close()


def test_faults_of_the_port(rig):
    _, emulator, link = rig
    emulator.fault("freeze")
    wait_until(lambda: not [time.sleep(0.2), *link.read()][1:])
    link.send(safe(1.0, 1.0))
    emulator.fault("heal")
    wait_until(link.read)
    emulator.fault("unplug")
    with pytest.raises(LinkError, match="plugged in"):
        wait_until(lambda: link.read() and False)
    with pytest.raises(LinkError, match="plugged in"):
        link.send(safe(1.0, 1.0))
    link.stop()


def test_lock_step_runs_end_by_the_simulators_time():
    with FakeSimulator(lockstep=True) as simulator, Emulator(MODULE, simulator) as emulator:
        link = link_to(emulator.port, now=lambda: simulator.tick / 30)
        link.connect()
        for k in range(60):
            link.send(safe(1.0 + k % 30, 1.0))
            wait_until(lambda k=k: abs(simulator.wheels[0] - 1.0 - k % 30) < 0.002)
            simulator.advance()
        samples = []
        wait_until(lambda: samples.extend(link.read()) or (samples and samples[-1].host_s == 2.0))
        assert max(sample.wheels_rad_s[0] for sample in samples) > 10.0
        time.sleep(0.5)
        assert simulator.wheels[0] > 1.0  # no time passes while nobody asks
        for _ in range(10):
            simulator.advance()
        wait_until(lambda: simulator.wheels == STANDING)
        link.close()


def heard(*commands):
    told = []
    firmware = VelociroachFirmware(lambda **points: told.append(points["wheels"]))
    for command in commands:
        firmware.hear(encode(Transmit(0x2052, command)))
    return told


def test_legs_do_not_go_without_gains_or_without_a_run():
    gains = encode_command(Kind.PID_GAINS, *EXAMPLE_GAINS, *EXAMPLE_GAINS)
    profile, run = encode_profile((5.0, 5.0), 100), encode_command(Kind.TIMED_RUN, 300)
    assert heard(profile, run) == [] and heard(gains, profile) == []
    assert heard(gains, profile, run)[-1] == pytest.approx([5.0, 5.0], abs=0.002)
    assert heard(gains, profile, run, encode_command(Kind.STOP))[-1] == STANDING


def test_zero_position_answers_the_old_one():
    firmware = VelociroachFirmware(lambda **_: None)
    firmware.sense({"time_s": 1.0, "angles": [3.0, -3.0]})
    answers = [
        firmware.hear(encode(Transmit(0x2052, encode_command(k)))) for k in (Kind.ZERO_POSITION, Kind.LEG_POSITIONS)
    ]
    before, after = (FrameParser().feed(pieces[0])[0].data[2:] for pieces in answers)
    assert any(before) and not any(after)


def test_speeds_from_positions():
    track = LegTrack()
    assert track.speeds(0.0, (0.0, 0.0)) == (0.0, 0.0)
    for k in range(1, 50):
        speeds = track.speeds(k * 0.02, (0.1 * k, -0.05 * k))
    assert speeds == pytest.approx((5.0, -2.5))
    assert track.speeds(0.98, (9.0, 9.0)) == speeds  # no time has passed


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"firmware": [""]}, "link.firmware: got"),
        ({"run_ms": 5000}, "link.run_ms: got 5000, expected 100 to 1000 ms"),
        ({"gains_left": [0, 0, 0, 0, 0]}, "link.gains_left: got"),
        ({"address": 70000}, "link.address: got 70000, expected 16 bits"),
    ],
)
def test_settings_are_checked(entry, message):
    with pytest.raises(ConfigError, match=message):
        validated(VelociroachSettings, {"kind": "velociroach_xbee", **entry})

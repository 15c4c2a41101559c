"""The Zumy's link against its emulated firmware over a real pseudo-terminal."""

from __future__ import annotations

import itertools
import math
import os
import threading
import time
import tty

import pytest

from coop_envs.agents.catalog import load_hat, load_robot
from coop_envs.agents.specification import Hat, Led
from coop_envs.errors import ConfigError, CoopError
from coop_envs.validation import validated
from hardware_bridge.command import RobotCommand
from hardware_bridge.link import LinkError
from hardware_bridge.links.zumy_serial import ZumySerialLink, ZumySerialSettings
from hardware_bridge.links.zumy_set_points import colours, sendable
from hardware_bridge.protocols.zumy_packets import PacketParser, encode_time
from tests.hardware_bridge.fake_simulator import (
    ACCEL,
    GYRO,
    VOLTAGE,
    Emulator,
    FakeSimulator,
    safe,
    wait_until,
)

ZUMY, HAT = load_robot("zumy"), load_hat("hat0")


def link_to(port, now=time.monotonic, **settings):
    return ZumySerialLink("scout", ZUMY, HAT, ZumySerialSettings(port=port, **settings), now)


@pytest.fixture
def rig():
    """A simulator, the emulated robot and a connected link."""
    with FakeSimulator() as simulator, Emulator("zumy_firmware", simulator) as emulator:
        link = link_to(emulator.port)
        link.connect()
        yield simulator, emulator, link
        link.close()


def samples_of(link, count=3):
    got = []
    wait_until(lambda: got.extend(link.read()) or len(got) >= count)
    return got


def test_sensors_arrive_in_si_units(rig):
    simulator, _, link = rig
    link.send(safe(3.0, -1.5))
    wait_until(lambda: simulator.wheels == [3.0, -1.5])
    wait_until(lambda: abs(samples_of(link, 1)[-1].angles_rad[0]) > 1.0)
    before, *_, after = samples_of(link, 5)
    assert after.gyro_rad_s == pytest.approx(GYRO) and after.accel_m_s2 == pytest.approx(ACCEL)
    assert after.voltage_v == pytest.approx(VOLTAGE, abs=1e-4) and after.wheels_rad_s == (3.0, -1.5)
    assert after.angles_rad[1] == pytest.approx(-after.angles_rad[0] / 2, abs=0.01)
    elapsed_s = after.device_s - before.device_s
    turned_rad = after.angles_rad[0] - before.angles_rad[0]
    assert turned_rad == pytest.approx(3.0 * elapsed_s, abs=2 * math.tau / 1200)
    assert before.host_s < after.host_s <= time.monotonic()


def test_what_is_sent_is_what_the_robot_does(rig):
    simulator, _, link = rig
    sent = link.send(safe(70.0, -3.25, brightness=0.5, laser=0.7, galvo=(3, -2)))
    assert sent == RobotCommand((50.0, -3.25), 128 / 255, 0.6, (3, -2))
    wait_until(lambda: simulator.galvo == [[3, -2]])
    done = (tuple(simulator.wheels), simulator.brightness, simulator.laser)
    assert done == (sent.wheels_rad_s, sent.brightness, sent.laser)


def test_only_a_supervisors_output_is_sent(rig):
    _, _, link = rig
    with pytest.raises(CoopError, match="expected a supervisor's output"):
        link.send(RobotCommand())


def test_set_points_latch_until_they_are_stopped(rig):
    simulator, _, link = rig
    driving = {"brightness": 1.0, "laser": 1.0}
    wait_until(lambda: link.send(safe(5.0, 5.0, **driving)) and simulator.wheels == [5.0, 5.0] and simulator.laser == 1)
    time.sleep(0.4)
    assert simulator.wheels == [5.0, 5.0]  # the robot has no watchdog
    link.stop()
    wait_until(lambda: simulator.wheels == [0.0, 0.0] and simulator.laser == 0.0)
    assert simulator.brightness == 1.0
    wait_until(lambda: link.send(safe(5.0, 5.0, **driving)) and simulator.wheels == [5.0, 5.0] and simulator.laser == 1)
    link.close()
    wait_until(lambda: simulator.wheels == [0.0, 0.0] and simulator.laser == 0.0)


def test_a_mirror_move_is_sent_once(rig):
    simulator, _, link = rig
    link.send(safe(galvo=(7, 0)))
    for _ in range(20):
        link.send(safe(1.0, 1.0))
        time.sleep(1 / 30)
    wait_until(lambda: simulator.wheels == [1.0, 1.0])
    assert simulator.galvo == [[7, 0]]


def test_no_fresh_sample_no_answer(rig):
    simulator, _, link = rig
    wait_until(lambda: link.polls >= 60)
    assert link.answers <= simulator.tick + 1 < link.polls


def test_round_trips_are_timed(rig):
    _, _, link = rig
    assert 0 < wait_until(lambda: list(link.round_trips_s))[-1] < 0.5


def test_a_frozen_robot_is_silent_and_blocks_nobody(rig):
    simulator, emulator, link = rig
    emulator.fault("freeze")
    wait_until(lambda: not [time.sleep(0.2), *link.read()][1:])
    started = time.monotonic()
    for _ in range(300):
        link.send(safe(9.0, 9.0))
    assert time.monotonic() - started < 2.0 and link.read() == []
    assert simulator.wheels == [0.0, 0.0]
    emulator.fault("heal")
    samples_of(link)
    link.send(safe(2.0, 2.0))
    wait_until(lambda: simulator.wheels == [2.0, 2.0])


def test_garbage_is_dropped_and_counted(rig):
    simulator, emulator, link = rig
    emulator.fault("garbage")
    wait_until(lambda: link.dropped > 300)
    link.send(safe(4.0, 4.0))
    wait_until(lambda: simulator.wheels == [4.0, 4.0])
    emulator.fault("heal")
    samples_of(link)


def test_a_port_that_is_unplugged_raises_and_comes_back(tmp_path):
    path = tmp_path / "zumy"
    with FakeSimulator() as simulator, Emulator("zumy_firmware", simulator, "--port-link", str(path)) as emulator:
        link = link_to(emulator.port)
        assert link.connect().address == str(path)
        emulator.fault("unplug")
        with pytest.raises(LinkError, match="plugged in"):
            wait_until(lambda: link.read() and False)
        with pytest.raises(LinkError, match="plugged in"):
            link.send(safe(1.0, 1.0))
        link.stop()
        link.close()
        with pytest.raises(LinkError, match="no such port"):
            link.connect()
        emulator.fault("heal")
        wait_until(path.exists)
        link.connect()
        samples_of(link)
        link.close()


def test_a_clock_that_jumps_is_told_as_it_is(rig):
    _, emulator, link = rig
    before = samples_of(link)[-1]
    emulator.fault("clock_jump", jump_s=100.0)
    after = wait_until(lambda: next((s for s in link.read() if s.device_s > before.device_s + 90), None))
    assert after.device_s - before.device_s == pytest.approx(100.0 + after.host_s - before.host_s, abs=1.0)


def test_late_samples_carry_the_time_at_which_they_were_taken(rig):
    _, emulator, link = rig
    offset = min(s.host_s - s.device_s for s in samples_of(link, 10))
    emulator.fault("late", delay_s=0.3)
    wait_until(lambda: next((s for s in link.read() if s.host_s - s.device_s > offset + 0.25), None))


def test_a_clock_near_its_wrap_goes_on():
    quirks = {"clock_start_us": 2**32 - 2_000_000, "clock_drift_ppm": 50}
    with FakeSimulator() as simulator, Emulator("zumy_firmware", simulator, quirks=quirks) as emulator:
        link = link_to(emulator.port)
        link.connect()
        times = [s.device_s for s in samples_of(link, 60)]
        link.close()
    assert times[0] < 4294.9 and times[-1] > 4295.0
    assert all(0 < b - a < 0.5 for a, b in itertools.pairwise(times))


def test_a_bad_wire_costs_packets_and_no_more():
    quirks = {"lost": 0.1, "garbled": 0.2, "delay_s": 0.005, "jitter_s": 0.005, "seed": 3}
    with FakeSimulator() as simulator, Emulator("zumy_firmware", simulator, quirks=quirks) as emulator:
        link = link_to(emulator.port, connect_s=5.0)
        link.connect()
        for k in range(60):
            link.send(safe(1.0 + k, 1.0))
            time.sleep(0.01)
        assert len(samples_of(link, 20)) >= 20 and link.dropped > 0
        wait_until(lambda: link.send(safe(5.0, 5.0)) and simulator.wheels == [5.0, 5.0])
        wait_until(lambda: link.stop() or simulator.wheels == [0.0, 0.0])
        link.close()


def test_lock_step_gives_a_sample_a_tick():
    ticks = 200
    with FakeSimulator(lockstep=True) as simulator, Emulator("zumy_firmware", simulator) as emulator:
        link, got = link_to(emulator.port, now=lambda: simulator.tick / 30), []
        link.connect()
        started = time.monotonic()
        for k in range(ticks):
            link.send(safe(float(k % 40 + 1), 0.0))
            wait_until(lambda k=k: simulator.wheels[0] == k % 40 + 1)
            simulator.advance()
            wait_until(lambda k=k: got.extend(link.read()) or len(got) > k)
        took_s = time.monotonic() - started
        link.close()
    assert len(got) == ticks and took_s < ticks / 30 + 5.0
    assert [round(s.device_s * 30) for s in got] == list(range(1, ticks + 1))


def test_a_robot_without_power_says_nothing(rig):
    simulator, _, link = rig
    simulator.powered = False
    wait_until(lambda: not [time.sleep(0.2), *link.read()][1:])
    link.send(safe(3.0, 3.0))
    time.sleep(0.1)
    assert simulator.wheels == [0.0, 0.0]


def test_nobody_there():
    robot, host = os.openpty()
    try:
        with pytest.raises(
            LinkError, match=r"scout: /dev/pts/\d+: got no answer within 0.3 s, expected a Zumy at 230400"
        ):
            link_to(os.ttyname(host), connect_s=0.3).connect()
        with pytest.raises(LinkError, match="no such port"):
            link_to("/dev/no_such_port").connect()
        with pytest.raises(LinkError, match="expected a serial port"):
            link_to(None).connect()
        with pytest.raises(LinkError, match="closed link"):
            link_to(None).send(safe())
    finally:
        os.close(robot)
        os.close(host)


def test_a_port_is_one_hosts_alone(rig):
    _, emulator, link = rig
    with pytest.raises(LinkError, match="in use"):
        link_to(emulator.port).connect()
    samples_of(link)


def test_a_stop_finds_room_where_all_is_full():
    robot, host = os.openpty()
    tty.setraw(host)
    link = link_to(os.ttyname(host))
    try:
        threading.Timer(0.3, os.write, (robot, encode_time())).start()
        link.connect()
        for _ in range(5000):  # nobody reads: the queue is full
            link.send(safe(9.0, 9.0))
        link.stop()
        stream, chunk = b"", bytes(1000)
        while len(chunk) > 100:  # then only polls come
            chunk = os.read(robot, 4096)
            stream += chunk
        wheels = [p.values for p in PacketParser().feed(stream) if p.kind == "C"]
        assert wheels[-1] == (0.0, 0.0) and (9.0, 9.0) in wheels
        assert len(wheels) < 1000  # what fits into a pseudo-terminal, which a flush empties only in part
    finally:
        link.close()
        os.close(robot)
        os.close(host)


def test_colours_are_the_hats():
    full = [0xFF0000, 0xFFFF00, 0x00FF00, 0x00FFFF, 0x0000FF, 0xFF00FF]
    assert colours([led.hue_deg for led in HAT.leds], 1.0) == full
    assert colours([0.0, 60.0], 0.5) == [0x800000, 0x808000, 0, 0, 0, 0]


def test_what_is_not_finite_is_not_sent():
    nan = float("nan")
    sent, level = sendable(RobotCommand((nan, 5.0), nan, nan, (0, 0)), lit=True)
    assert sent == RobotCommand() and level == 0.0


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"port": ""}, "link.port: got '', expected a serial port"),
        ({"poll_hz": 0.0}, "link.poll_hz: got 0.0, expected 1 to 1000 Hz"),
        ({"speed": 1}, "speed: got 'speed', expected one of"),
    ],
)
def test_settings_are_checked(entry, message):
    with pytest.raises(ConfigError, match=message):
        validated(ZumySerialSettings, {"kind": "zumy_serial", **entry})


def test_a_hat_of_more_leds_than_the_robot_has_is_refused():
    hat = Hat("big", tuple(Led(40.0 * k, (0.0, 0.0, 0.1)) for k in range(8)))
    with pytest.raises(ConfigError, match=r"scout.hat.leds: got 8, expected at most 6 LEDs"):
        ZumySerialLink("scout", ZUMY, hat, ZumySerialSettings(), time.monotonic)

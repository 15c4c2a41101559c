"""A Zumy over a real roscore: what is sent arrives, what it reports arrives, and what goes wrong is noticed."""

from __future__ import annotations

import contextlib
import itertools
import math
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from coop_envs.agents.catalog import load_hat, load_robot
from coop_envs.errors import ConfigError, CoopError
from coop_envs.validation import validated
from hardware_bridge import ros1
from hardware_bridge.command import RobotCommand, SafeCommand, supervisors_seal
from hardware_bridge.link import LinkError
from hardware_bridge.links.laser_service import LaserService
from hardware_bridge.links.zumy_reports import Reports
from hardware_bridge.links.zumy_ros1 import ZumyRos1Link, ZumyRos1Settings, colours, sendable, twist_of
from hardware_bridge.protocols.zumy_packets import LASER_DUTIES, RAD_PER_TICK, laser_duty
from tests.hardware_bridge.ros import ROOT, answers, emulated, process_master, roscore, until

ZUMY, HAT = load_robot("zumy"), load_hat("hat0")
SPACES = (f"/zumy{k}" for k in itertools.count())
ros = pytest.mark.ros
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:rospy.*")


def safe(**parts):
    return SafeCommand(RobotCommand(**parts), supervisors_seal())


def link_to(namespace, now=time.monotonic, **settings):
    settings = ZumyRos1Settings("zumy_ros1", process_master(), namespace, **settings)
    return ZumyRos1Link("zumy", ZUMY, HAT, settings, now)


@pytest.fixture
def pair():
    """A simulator, the emulated node, and a link that is connected to it."""
    namespace = next(SPACES)
    with emulated(process_master(), namespace) as (simulator, node):
        link = link_to(namespace)
        link.connect()
        yield simulator, node, link
        link.close()


def driven(link, **parts):
    """One tick of driving; what the link says if the node is gone."""
    try:
        link.send(safe(**parts))
    except LinkError as error:
        return str(error)
    time.sleep(0.03)
    return None


@ros
def test_commands_arrive_as_they_were_said_to_be_sent(pair):
    simulator, _, link = pair
    wanted = safe(wheels_rad_s=(-3.0, 70.0), brightness=0.3, laser=0.7, galvo=(12, -40_000))
    sent = link.send(wanted)
    assert sent.wheels_rad_s == (-3.0, 50.0) and sent.laser == 0.6 and sent.galvo == (12, -32767)
    until(lambda: simulator.last("laser") == 0.6 and simulator.last("wheels") != [0.0, 0.0])
    assert simulator.last("wheels") == pytest.approx(sent.wheels_rad_s)
    assert simulator.last("galvo") == [12.0, -32767.0]
    until(lambda: simulator.last("brightness") == pytest.approx(sent.brightness))
    for _ in range(5):
        link.send(safe(wheels_rad_s=(2.0, 2.0), laser=0.7))
        time.sleep(0.02)
    until(lambda: sum(m.get("wheels") == pytest.approx([2.0, 2.0]) for m in simulator.told) >= 3)
    assert sum("galvo" in m and m["galvo"] != [0.0, 0.0] for m in simulator.told) == 1, "a move is made once"


@ros
def test_reports_arrive_in_units_of_the_bridge():
    namespace, clock = next(SPACES), iter(itertools.count(100.0))
    with emulated(process_master(), namespace) as (_, _):
        link = link_to(namespace, lambda: next(clock))
        identity = link.connect()
        assert identity.kind == "zumy" and identity.address == f"{process_master()}{namespace}"
        link.send(safe(wheels_rad_s=(10.0, -20.0)))
        samples = until(lambda: [s for s in link.read() if s.angles_rad[0] > 5.0])
        sample = samples[0]
        assert sample.host_s >= 100.0 and sample.host_s % 1 == 0
        assert sample.gyro_rad_s == (0.1, 0.2, 0.3) and sample.accel_m_s2 == (1.0, 2.0, 9.0)
        assert sample.wheels_rad_s == pytest.approx((10.0, -20.0))
        assert sample.angles_rad[1] == pytest.approx(-2 * sample.angles_rad[0], abs=1.5 * RAD_PER_TICK)
        assert sample.voltage_v == pytest.approx(7.4)
        assert sample.device_s == pytest.approx(round(sample.device_s * 30) / 30, abs=1e-6)
        link.close()


@ros
def test_closing_leaves_the_robot_at_rest_with_its_laser_off(pair):
    simulator, _, link = pair
    link.send(safe(wheels_rad_s=(5.0, 5.0), laser=1.0, brightness=1.0))
    until(lambda: simulator.last("laser") == 1.0 and simulator.last("brightness") == 1.0)
    link.close()
    until(lambda: simulator.last("wheels") == [0.0, 0.0] and simulator.last("laser") == 0.0)
    assert simulator.last("brightness") == 1.0, "its lights stay, they are landmarks"
    with pytest.raises(LinkError, match="closed link"):
        link.read()
    link.stop()
    link.close()


@ros
def test_only_a_supervisors_output_is_sent(pair):
    _, _, link = pair
    with pytest.raises(CoopError, match="expected a supervisor's output"):
        link.send(RobotCommand((1.0, 1.0)))


@ros
def test_a_node_that_is_killed_is_gone_at_once_and_its_set_points_stay(pair):
    simulator, node, link = pair
    link.send(safe(wheels_rad_s=(5.0, 5.0)))
    until(lambda: simulator.last("wheels") == [5.0, 5.0])
    node.fault("die")
    gone = until(lambda: driven(link, wheels_rad_s=(5.0, 5.0)))
    assert re.fullmatch(r"zumy: got nobody at /\S+.*, expected the robot's bridge node", gone)
    assert simulator.last("wheels") == [5.0, 5.0]
    link.stop()


@ros
def test_a_silent_node_still_obeys_and_one_that_heals_reports_again(pair):
    simulator, node, link = pair
    until(link.read)
    node.fault("silent")
    until(lambda: not driven(link, wheels_rad_s=(4.0, 4.0)) and quiet(link))
    until(lambda: simulator.last("wheels") == [4.0, 4.0])
    node.fault("heal")
    until(link.read)


def quiet(link, seconds=0.3):
    """Whether nothing comes for a while."""
    link.read()
    time.sleep(seconds)
    return not link.read()


@ros
def test_a_node_that_hangs_holds_up_no_tick_and_moves_of_the_mirror_are_counted(pair):
    simulator, node, link = pair
    assert link.laser is not None and link.laser.settled(20)
    node.fault("freeze")
    until(lambda: quiet(link))
    longest = 0.0
    for k in range(6):
        begin = time.monotonic()
        link.send(safe(wheels_rad_s=(1.0 + k, 1.0), laser=1.0, galvo=(k + 1, 0)))
        longest = max(longest, time.monotonic() - begin)
        time.sleep(0.02)
    assert longest < 0.5
    assert link.laser.dropped == 4, "one is under way, one waits, the others were replaced"
    node.fault("heal")
    until(lambda: simulator.last("galvo") == [6.0, 0.0])


@ros
def test_garbage_is_dropped_and_counted(pair):
    _, node, link = pair
    node.fault("garbage")
    until(lambda: link.reports.garbage > 20)
    until(lambda: quiet(link, 0.1))
    node.fault("heal")
    samples = until(link.read)
    assert all(math.isfinite(x) for s in samples for x in (*s.gyro_rad_s, *s.wheels_rad_s))


@ros
def test_the_older_dialect_is_driven_by_cmd_vel_and_has_no_laser():
    namespace = next(SPACES)
    with emulated(process_master(), namespace, "--dialect", "master") as (simulator, _):
        link = link_to(namespace, dialect="master")
        assert link.connect().version == "ros_zumy [master]"
        sent = link.send(safe(wheels_rad_s=(3.0, 4.0), laser=1.0, galvo=(3, 3)))
        assert sent.laser == 0.0 and sent.galvo == (0, 0)
        until(lambda: simulator.last("wheels") == pytest.approx([3.0, 4.0]))
        link.close()


@ros
def test_nobody_at_the_topics_is_refused():
    with pytest.raises(LinkError, match=r"zumy: got nobody at /nowhere/command, .* expected a Zumy's bridge node"):
        link_to("/nowhere", connect_s=0.3).connect()


@ros
def test_a_process_speaks_to_one_master(tmp_path):
    ros1.start_node("coop_bridge", process_master())
    with roscore(tmp_path) as other, pytest.raises(LinkError, match="rospy knows one master a process"):
        ros1.start_node("coop_bridge", other)


OUTLIVES = """
import sys, time
from tests.hardware_bridge.links.test_zumy_ros1 import ZUMY, ZumyRos1Link, ZumyRos1Settings, driven, until
link = ZumyRos1Link("z", ZUMY, None, ZumyRos1Settings("zumy_ros1", sys.argv[1], "/zumy1"), time.monotonic)
link.connect()
print("connected", flush=True)
sys.stdin.readline()
link.read()
until(link.read)
until(lambda: not driven(link, wheels_rad_s=(3.0, 4.0)) and any(s.wheels_rad_s[0] > 2.9 for s in link.read()))
link.close()
print("done")
"""


@ros
def test_a_link_outlives_its_master(tmp_path):
    """Connections are between the nodes. In a process of its own, which knows no other master."""
    with contextlib.ExitStack() as mastered:
        master = mastered.enter_context(roscore(tmp_path))
        with emulated(master, "/zumy1") as (simulator, _):
            child = subprocess.Popen(
                [sys.executable, "-c", OUTLIVES, master],
                cwd=ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            assert child.stdout is not None and child.stdout.readline() == "connected\n"
            mastered.close()
            assert not answers(master)
            assert child.communicate("go\n", timeout=60)[0] == "done\n" and child.returncode == 0
            until(lambda: any(m.get("wheels") == pytest.approx([3.0, 4.0]) for m in simulator.told))
            assert simulator.last("wheels") == [0.0, 0.0]


FORGETS = """
import logging, signal, sys, time, warp, cv2
from hardware_bridge.links.zumy_ros1 import ZumyRos1Link, ZumyRos1Settings
from coop_envs.agents.catalog import load_robot
def taken():
    return signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM), list(logging.getLogger().handlers)
before = taken()
link = ZumyRos1Link("z", load_robot("zumy"), None, ZumyRos1Settings("zumy_ros1", *sys.argv[1:]), time.monotonic)
link.connect()
assert taken() == before
print("done")
"""


@ros
def test_rospy_leaves_signals_and_logging_alone_and_a_program_that_forgets_to_close_ends():
    with emulated(process_master(), next(SPACES)) as (_, node):
        command = [sys.executable, "-W", "ignore", "-c", FORGETS, process_master(), node.namespace]
        run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
        assert (run.returncode, run.stdout, run.stderr) == (0, "done\n", "")


@ros
def test_the_emulators_process_ends_with_its_stdin_and_stops_the_robot():
    with emulated(process_master(), next(SPACES)) as (simulator, node):
        assert node.end() == 0
        until(lambda: simulator.last("wheels") == [0.0, 0.0])
    with emulated(process_master(), next(SPACES)) as (simulator, node):
        node.process.send_signal(signal.SIGTERM)
        assert node.process.wait(20) == 0


@ros
def test_the_services_reply_may_be_any():
    """A strict server, with a checksum and a reply of its own."""
    rospy = ros1.start_node("coop_bridge", process_master())
    heard = []
    text = "float32 laser_cmd\nint16 galvo_cmd_0\nint16 galvo_cmd_1"
    kind = ros1.service_class("other/Laser", text, "string why\nfloat64[] rows", strict=True)

    def take(request):
        heard.append((request.laser_cmd, request.galvo_cmd_0, request.galvo_cmd_1))
        return kind._response_class("because", [1.0, 2.0])

    server = rospy.Service("/other/set_laser_galvo", kind, take)
    client = LaserService(rospy, "/other/set_laser_galvo")
    client.want(0.5, (3, -4))
    assert client.settled(20) and heard == [(0.5, 3, -4)] and client.failed == 0
    server.shutdown()
    client.close()


@ros
def test_a_service_that_fails_is_tried_again_but_no_move_is_made_twice():
    rospy = ros1.start_node("coop_bridge", process_master())
    client = LaserService(rospy, "/late/set_laser_galvo")
    client.want(1.0, (5, 5))
    until(lambda: client.failed >= 2)
    assert client.dropped == 1
    heard, kind = [], ros1.service_class("late/Laser", "float32 a\nint16 b\nint16 c", strict=True)

    def take(request):
        heard.append((request.a, request.b, request.c))
        return kind._response_class()

    server = rospy.Service("/late/set_laser_galvo", kind, take)
    until(lambda: client.settled(0.1))
    assert heard == [(1.0, 0, 0)]
    server.shutdown()
    client.close()


@ros
def test_a_service_that_comes_back_is_called_again():
    rospy = ros1.start_node("coop_bridge", process_master())
    heard, kind = [], ros1.service_class("again/Laser", "float32 a\nint16 b\nint16 c", strict=True)

    def take(request):
        heard.append(request.a)
        return kind._response_class()

    client = LaserService(rospy, "/again/set_laser_galvo")
    for level in (1.0, 0.5):
        server = rospy.Service("/again/set_laser_galvo", kind, take)
        client.want(level, (0, 0))
        until(lambda level=level: client.settled(0.1) and level in heard)
        server.shutdown()
    client.close()


def test_no_master_is_told_at_once():
    begin = time.monotonic()
    with pytest.raises(LinkError, match=r"got no answer .*, expected a running roscore") as error:
        ros1.ask_master("http://127.0.0.1:9")
    assert time.monotonic() - begin < 5 and "\n" not in str(error.value)
    assert not answers("http://127.0.0.1:9")


def test_a_master_that_hangs_is_given_up():
    with socket.create_server(("127.0.0.1", 0)) as mute, pytest.raises(LinkError, match="timed out"):
        ros1.ask_master(f"http://127.0.0.1:{mute.getsockname()[1]}", 0.2)


@pytest.mark.parametrize(
    "wrong",
    [{"master": "localhost:11311"}, {"master": "http://localhost"}, {"master": "http://a:b"}, {"namespace": "zumy1"},
     {"namespace": "/"}, {"namespace": "/zumy-1"}, {"dialect": "new"}, {"connect_s": 0.0}, {"port": 1}],
)  # fmt: skip
def test_settings_are_checked(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        validated(ZumyRos1Settings, {"kind": "zumy_ros1", **wrong}, "link")


@given(st.tuples(*[st.floats(-50, 50)] * 2))
def test_the_twist_turns_the_wheels_as_the_robots_node_does(wheels):
    """Its kinematics: l, r = (v -/+ omega 0.05) / 0.02."""
    v, omega = twist_of(wheels, ZUMY)
    assert ((v - 0.05 * omega) / 0.02, (v + 0.05 * omega) / 0.02) == pytest.approx(wheels, abs=1e-9)


@given(st.floats(-1, 2), st.floats(-1, 2), st.tuples(st.floats(), st.floats()))
def test_what_is_said_to_be_sent_is_what_the_firmware_makes_of_it(laser, brightness, wheels):
    sent, level = sendable(RobotCommand(wheels, brightness, laser), True)
    level = struct.unpack("f", struct.pack("f", level))[0]
    assert laser_duty(level) == sent.laser == max(d for d in LASER_DUTIES if d <= max(laser + 1e-6, 0.0))
    assert all(abs(w) <= 50 for w in sent.wheels_rad_s)
    assert (sent.brightness * 255) % 1 == pytest.approx(0, abs=1e-9) and 0 <= sent.brightness <= 1
    if not all(math.isfinite(w) for w in wheels):
        assert sent.wheels_rad_s == (0.0, 0.0)


def test_colours_are_the_hats_hues_dimmed():
    assert colours([0, 60, 120, 240, 300], 1.0) == [0xFF0000, 0xFFFF00, 0x00FF00, 0x0000FF, 0xFF00FF, 0]
    assert colours([120.0], 128 / 255) == [0x008000, 0, 0, 0, 0, 0]


def a_round(reports, k, order):
    parts = {
        "imu": lambda: reports.imu(float(k), (k, 0.0, 0.0), (0.0, 0.0, 9.8)),
        "l_enc": lambda: reports.encoder(0, k),
        "r_enc": lambda: reports.encoder(1, -k),
        "l_vel": lambda: reports.speed(0, 1.0 * k),
        "r_vel": lambda: reports.speed(1, -1.0 * k),
    }
    for part in order:
        parts[part]()


@pytest.mark.parametrize("order", list(itertools.permutations(["imu", "l_enc", "r_enc", "l_vel", "r_vel"]))[::7])
def test_a_round_of_messages_is_one_sample_in_whatever_order_they_come(order):
    reports = Reports(lambda: 7.0)
    for k in range(1, 4):
        a_round(reports, k, order)
    samples = reports.take()
    assert [s.device_s for s in samples] == [1.0, 2.0, 3.0] and reports.unpaired == 0
    assert [s.wheels_rad_s for s in samples] == [(1.0, -1.0), (2.0, -2.0), (3.0, -3.0)]
    assert [s.angles_rad[0] / RAD_PER_TICK for s in samples] == pytest.approx([1, 2, 3])


def test_a_message_that_is_missing_costs_no_sample():
    reports = Reports(lambda: 7.0)
    a_round(reports, 1, ["l_enc", "r_enc", "l_vel", "r_vel", "imu"])
    a_round(reports, 2, ["l_enc", "imu"])
    a_round(reports, 3, ["imu"])
    assert [s.device_s for s in reports.take()] == [1.0, 2.0] and reports.unpaired == 1


def test_encoders_are_unwrapped_and_reports_that_nobody_reads_do_not_pile_up():
    reports = Reports(lambda: 0.0)
    ticks = [2**31 - 2, -(2**31) + 1, -(2**31) + 5]
    for k, t in enumerate(ticks):
        reports.encoder(0, t)
        a_round(reports, k, ["r_enc", "l_vel", "r_vel", "imu"])
    steps = [s.angles_rad[0] / RAD_PER_TICK - ticks[0] for s in reports.take()]
    assert steps == pytest.approx([0, 3, 7], abs=1e-3)
    for k in range(3000):
        a_round(reports, k, ["l_enc", "r_enc", "l_vel", "r_vel", "imu"])
    assert len(reports.take()) == 1000


def test_threads_may_report_at_once():
    reports = Reports(lambda: 0.0)
    threads = [
        threading.Thread(target=lambda part=part: [a_round(reports, k, [part]) for k in range(300)])
        for part in ("imu", "l_enc", "r_enc", "l_vel", "r_vel")
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert 1 <= len(reports.take()) <= 300

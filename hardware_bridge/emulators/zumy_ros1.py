"""An emulated Zumy's ROS node: the topics and the service of the robot's own, driven by the simulator.

    python -m hardware_bridge.emulators.zumy_ros1 --simulator HOST:PORT --robot K --master URI --namespace /zumy1

Set-points latch, as on the robot; only a clean end sends zero. Its loop runs at 100 Hz, but a round of messages goes
out only when the IMU has a fresh sample, once a tick of the simulator. What the robot's does not: topics are latched
and begin with a report at rest, so that a host may connect while simulated time stands still; a repeated ``markers``
is not passed on, so that in lock-step a tick waits for the ``command`` that follows it; with ``--camera`` there is
an image topic. Lines of JSON on stdin begin a `FaultCommand`; the end of stdin ends the process.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from coop_envs.errors import CoopError
from coop_envs.validation import STRICT, validated
from hardware_bridge import ros1
from hardware_bridge.emulators.frame_drawing import FrameDrawer
from hardware_bridge.emulators.quirks import Quirks
from hardware_bridge.links.laser_service import KIND, REQUEST
from hardware_bridge.links.zumy_ros1 import COMMAND_TOPICS
from hardware_bridge.protocols.datagrams import Datagram
from hardware_bridge.protocols.zumy_packets import MAX_WHEEL_RAD_S, RAD_PER_TICK, STANDARD_GRAVITY_M_S2, laser_duty
from hardware_bridge.simulator_client import SimulatorClient

LOOP_S = 0.01
WHEEL_RADIUS_M, TRACK_M = 0.02, 0.1
SIZE_PX = (640, 480)
IMAGE_TOPIC = "image_raw"
REPLY = "bool done"
"""Made up: the real reply is not published, and the bridge must do without knowing it."""
AT_REST: Datagram = {
    "time_s": 0.0,
    "gyro": [0.0, 0.0, 0.0],
    "accel": [0.0, 0.0, STANDARD_GRAVITY_M_S2],
    "angles": [0.0, 0.0],
    "wheels": [0.0, 0.0],
    "voltage": 7.2,
    "current": 1.0,
}


@dataclass(frozen=True)
class FaultCommand:
    """A fault to begin now; ``heal`` ends all but ``die``.

    ``freeze``: the node hears nothing and says nothing, its set-points stay. ``silent``: it hears, and says nothing.
    ``garbage``: what it says is not a number. ``late``: what it hears and says takes ``delay_s`` longer. ``die``: the
    process is gone at once, and tells nobody.
    """

    __pydantic_config__ = STRICT
    fault: Literal["freeze", "silent", "garbage", "late", "die", "heal"]
    delay_s: float = 0.5


class ZumyNode:
    """The robot's node: ROS on one side, the simulator on the other."""

    def __init__(self, rospy: Any, client: SimulatorClient, namespace: str, dialect: str, quirks: Quirks) -> None:
        self.fault: str = "heal"
        self.late_s = 0.0
        self._rospy, self._client, self._quirks, self._path = rospy, client, quirks, namespace
        self._chance = random.Random(quirks.seed)
        self._under_way: list[tuple[float, Callable[[], None]]] = []
        self._lock = threading.Lock()
        self._markers: tuple[int, ...] = ()
        self._drawer: FrameDrawer | None = None
        self._topics: dict[str, Any] = {}
        for topic in ("l_enc", "r_enc"):
            self._advertise(topic, "std_msgs/Int32")
        for topic in ("l_vel", "r_vel", "voltage", "current"):
            self._advertise(topic, "std_msgs/Float32")
        self._advertise("imu", "sensor_msgs/Imu")
        self._say(AT_REST)
        self._hear(COMMAND_TOPICS[dialect], "geometry_msgs/Twist", self._command)
        self._hear("markers", "std_msgs/UInt32MultiArray", self._light)
        if dialect == "packet":
            service = ros1.service_class(KIND, REQUEST, REPLY, strict=True)
            rospy.Service(f"{namespace}/set_laser_galvo", service, lambda m: self._steer(service, m))

    def add_camera(self) -> None:
        """Publish images from now on."""
        self._drawer = FrameDrawer(*SIZE_PX)
        self._topics[IMAGE_TOPIC] = self._rospy.Publisher(
            f"{self._path}/{IMAGE_TOPIC}", ros1.message("sensor_msgs/Image"), queue_size=2
        )

    def report(self, state: Datagram) -> None:
        """Tell the host what the simulator says of the robot."""
        missed = self._chance.random() < self._quirks.lost
        if state.get("powered", True) and not missed and self.fault not in ("freeze", "silent"):
            self._later(lambda: self._say(state))

    def begin(self, command: FaultCommand) -> None:
        """Begin a fault."""
        if command.fault == "die":
            os._exit(1)
        self.fault = command.fault
        self.late_s = command.delay_s if command.fault == "late" else 0.0

    def loop(self) -> None:
        """Do what is due."""
        with self._lock:
            due = [act for at, act in self._under_way if at <= time.monotonic()]
            del self._under_way[: len(due)]
        for act in due:
            act()

    def rest(self) -> None:
        """What a clean end does."""
        self._client.set(wheels=[0.0, 0.0])

    def _advertise(self, topic: str, kind: str) -> None:
        path = f"{self._path}/{topic}"
        self._topics[topic] = self._rospy.Publisher(path, ros1.message(kind), queue_size=100, latch=True)

    def _hear(self, topic: str, kind: str, take: Callable[[Any], None]) -> None:
        def heard(message: Any) -> None:
            if self.fault != "freeze":
                self._later(lambda: take(message))

        self._rospy.Subscriber(f"{self._path}/{topic}", ros1.message(kind), heard, queue_size=100, tcp_nodelay=True)

    def _later(self, act: Callable[[], None]) -> None:
        """Act after the quirks' delay, in order; at once without one."""
        delay_s = self._quirks.delay_s + self.late_s + self._chance.random() * self._quirks.jitter_s
        with self._lock:
            if delay_s > 0 or self._under_way:
                last = self._under_way[-1][0] if self._under_way else 0.0
                self._under_way.append((max(time.monotonic() + delay_s, last), act))
                return
        act()

    def _command(self, message: Any) -> None:
        v, omega = message.linear.x, message.angular.z
        wheels = [(v + side * omega * TRACK_M / 2) / WHEEL_RADIUS_M for side in (-1, 1)]
        if all(math.isfinite(w) for w in wheels):
            self._client.set(wheels=[min(max(w, -MAX_WHEEL_RAD_S), MAX_WHEEL_RAD_S) for w in wheels])

    def _light(self, message: Any) -> None:
        colours = tuple(message.data)
        if colours != self._markers:
            self._markers = colours
            channels = [colour >> shift & 255 for colour in colours for shift in (0, 8, 16)]
            self._client.set(brightness=max(channels, default=0) / 255)

    def _steer(self, service: Any, message: Any) -> Any:
        while self.fault == "freeze":
            time.sleep(LOOP_S)
        counts = [float(message.galvo_cmd_0), float(message.galvo_cmd_1)]
        duty = laser_duty(message.laser_cmd)
        self._later(lambda: self._client.set(laser=duty, galvo=counts))
        return service._response_class(True)

    def _say(self, state: Datagram) -> None:
        """One round of messages."""
        garbled = self.fault == "garbage" or self._chance.random() < self._quirks.garbled
        for k, wheel in enumerate("lr"):
            ticks = round(state["angles"][k] / RAD_PER_TICK)
            self._topics[f"{wheel}_enc"].publish((ticks + 2**31) % 2**32 - 2**31)
            self._topics[f"{wheel}_vel"].publish(math.nan if garbled else state["wheels"][k])
        for topic in ("voltage", "current"):
            self._topics[topic].publish(state[topic])
        imu, vector = ros1.message("sensor_msgs/Imu")(), ros1.message("geometry_msgs/Vector3")
        imu.header.stamp = self._stamp(state["time_s"])
        imu.angular_velocity = vector(*([math.nan] * 3 if garbled else state["gyro"]))
        imu.linear_acceleration = vector(*state["accel"])
        self._topics["imu"].publish(imu)
        if self._drawer is not None and state.get("blobs") is not None:
            frame = self._drawer.draw(state["blobs"], state.get("spot"))
            image = ros1.message("sensor_msgs/Image")(
                height=frame.shape[0], width=frame.shape[1], encoding="bgr8", step=3 * frame.shape[1]
            )
            image.header.stamp, image.data = imu.header.stamp, frame.tobytes()
            self._topics[IMAGE_TOPIC].publish(image)

    def _stamp(self, time_s: float) -> Any:
        quirks = self._quirks
        return self._rospy.Time.from_sec(quirks.clock_start_us * 1e-6 + time_s * (1 + quirks.clock_drift_ppm * 1e-6))


def serve(node: ZumyNode, client: SimulatorClient) -> None:
    """Run until stdin ends."""
    typed = b""
    while True:
        node.loop()
        for ready in select.select([client, sys.stdin], [], [], LOOP_S)[0]:
            if ready is client:
                for message in client.poll():
                    if message["kind"] == "state":
                        node.report(message)
                continue
            read = os.read(sys.stdin.fileno(), 65536)
            if not read:
                return
            *lines, typed = (typed + read).split(b"\n")
            for line in filter(None, lines):
                take_fault(node, line)


def take_fault(node: ZumyNode, line: bytes) -> None:
    """Begin the fault of a line; a line that is none is told on stderr."""
    try:
        node.begin(validated(FaultCommand, json.loads(line), "fault"))
    except (ValueError, CoopError) as error:
        print(f"stdin: {error}", file=sys.stderr)  # noqa: T201


def main() -> int:
    """Emulate one robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--simulator", required=True, help="HOST:PORT")
    parser.add_argument("--robot", required=True, type=int, help="its index in the team")
    parser.add_argument("--master", default="http://localhost:11311")
    parser.add_argument("--namespace", default="/zumy1")
    parser.add_argument("--dialect", default="packet", choices=sorted(COMMAND_TOPICS))
    parser.add_argument("--quirks", default="{}", help="JSON")
    parser.add_argument("--camera", action="store_true", help="publish images")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # at Ctrl-C whoever started us stops the robot, then us
    host, port = options.simulator.rsplit(":", 1)
    try:
        rospy = ros1.start_node(f"zumy_emulator_{options.robot}", options.master)
        quirks = validated(Quirks, json.loads(options.quirks), "quirks")
        client = SimulatorClient((host, int(port)), options.robot)
        client.hello(10.0)
    except (ValueError, CoopError) as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    node = ZumyNode(rospy, client, options.namespace, options.dialect, quirks)
    if options.camera:
        node.add_camera()
    print(json.dumps({"ready": True, "port": options.namespace}), flush=True)  # noqa: T201
    try:
        serve(node, client)
    finally:
        node.rest()
        rospy.signal_shutdown("end")
    return 0


if __name__ == "__main__":
    sys.exit(main())

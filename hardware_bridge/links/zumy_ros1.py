"""A Zumy over ROS 1: the topics and the service of its own bridge node, which runs on the robot.

Publishes ``command`` (Twist in m/s and rad/s; ``cmd_vel`` in the older dialect) and ``markers`` (0xRRGGBB an LED);
hears ``imu``, ``l_enc``, ``r_enc``, ``l_vel``, ``r_vel`` and ``voltage``; calls ``set_laser_galvo``, which the older
dialect lacks. The service's request is published, its reply is not: any reply counts as done.

Source: `ros_zumy` [packet] ``zumy_ros_bridge.py``; [master] for ``cmd_vel``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

from coop_envs.agents.specification import Hat, RobotSpecification
from coop_envs.errors import require
from coop_envs.validation import STRICT
from hardware_bridge import ros1
from hardware_bridge.command import RobotCommand, SafeCommand, checked_safe
from hardware_bridge.link import Identity, LinkError, Now
from hardware_bridge.links.laser_service import LaserService
from hardware_bridge.links.zumy_reports import Reports
from hardware_bridge.links.zumy_set_points import colours, sendable
from hardware_bridge.protocols.zumy_packets import LEDS
from hardware_bridge.reading import Pair, Sample

COMMAND_TOPICS = {"packet": "command", "master": "cmd_vel"}
GALVO_LIMIT = 2**15 - 1
CLOSING_S = 0.3


@dataclass(frozen=True)
class ZumyRos1Settings:
    """Where the robot's node is, and which of its dialects it speaks."""

    __pydantic_config__ = STRICT
    kind: Literal["zumy_ros1"]
    master: str = "http://localhost:11311"
    namespace: str = "/zumy1"
    dialect: Literal["packet", "master"] = "packet"
    connect_s: float = 5.0

    def __post_init__(self) -> None:
        ros1.require_master("link.master", self.master)
        ros1.require_name("link.namespace", self.namespace)
        require(0 < self.connect_s <= 60, "link.connect_s", self.connect_s, "above 0, at most 60 seconds")


class ZumyRos1Link:
    """One Zumy.

    ``reports`` counts messages that could not be used, ``unsent`` those that could not be queued, ``laser`` the mirror
    moves that were not made.
    """

    def __init__(
        self, name: str, robot: RobotSpecification, hat: Hat | None, settings: ZumyRos1Settings, now: Now
    ) -> None:
        self._name, self._robot, self._settings = name, robot, settings
        self._hues = tuple(led.hue_deg for led in hat.leds) if hat else ()
        require(len(self._hues) <= LEDS, f"{name}.hat.leds", len(self._hues), f"at most {LEDS} LEDs")
        self.reports = Reports(now)
        self.laser: LaserService | None = None
        self.unsent = 0
        self._command_topic = COMMAND_TOPICS[settings.dialect]
        self._publishers: dict[str, Any] = {}
        self._subscribers: dict[str, Any] = {}

    @property
    def name(self) -> str:
        """The agent's name."""
        return self._name

    def connect(self) -> Identity:
        """Join the robot's master, wait until its node hears us and has reported; the robot is told to stand.

        Raises:
            LinkError: no ROS here, no master, no such node, or a node that says nothing.
        """
        settings = self._settings
        rospy = ros1.start_node("coop_bridge", settings.master)
        try:
            self._open(rospy)
            self._wait(lambda: not self._unheard(), lambda: f"nobody at {', '.join(self._unheard())}")
            self._wait(lambda: self.reports.count > 0, lambda: "no report of IMU, encoders and speeds")
            if settings.dialect == "packet":
                self._open_laser(rospy)
        except LinkError:
            self.close()
            raise
        self.stop()
        self.reports.clear()
        return Identity("zumy", f"ros_zumy [{settings.dialect}]", f"{settings.master}{settings.namespace}")

    def read(self) -> list[Sample]:
        """Everything that arrived since the last call, oldest first.

        Raises:
            LinkError: the robot's node is gone. One that hangs still holds its connections; its samples stop.
        """
        self._require_node()
        return self.reports.take()

    def send(self, command: SafeCommand) -> RobotCommand:
        """Send, and return what was really sent after clipping and quantising.

        Raises:
            LinkError: the robot's node is gone.
            CoopError: the command did not come from a supervisor.
        """
        wanted = checked_safe(command)
        self._require_node()
        sent, level = sendable(wanted, bool(self._hues))
        if self.laser is None:
            sent = replace(sent, laser=0.0, galvo=(0, 0))
        else:
            self.laser.want(level, sent.galvo)
        self._publish("markers", data=colours(self._hues, sent.brightness))
        self._drive(sent.wheels_rad_s)
        return sent

    def stop(self) -> None:
        """Tell the robot to stand, laser off. Its LEDs stay as they are: others may be looking at them."""
        self._drive((0.0, 0.0))
        if self.laser is not None:
            self.laser.stop()

    def close(self) -> None:
        """Stop, and leave the topics; the process's node stays until the process ends."""
        self.stop()
        laser, self.laser = self.laser, None
        if laser is not None:
            laser.settled(CLOSING_S)
            laser.close()
        for publisher in self._publishers.values():
            ros1.flush(publisher, CLOSING_S)
        publishers, self._publishers = self._publishers, {}
        for end in [*publishers.values(), *self._subscribers.values()]:
            end.unregister()
        self._subscribers = {}

    def _path(self, topic: str) -> str:
        return f"{self._settings.namespace}/{topic}"

    def _open(self, rospy: Any) -> None:
        kinds = {self._command_topic: "geometry_msgs/Twist", "markers": "std_msgs/UInt32MultiArray"}
        for topic, kind in kinds.items():
            # A queue of one: no call waits for the network, and the newest set-point wins.
            self._publishers[topic] = rospy.Publisher(self._path(topic), ros1.message(kind), queue_size=1)
        reports = self.reports
        takers: dict[str, tuple[str, Callable[[Any], None]]] = {
            "imu": ("sensor_msgs/Imu", self._take_imu),
            "l_enc": ("std_msgs/Int32", lambda m: reports.encoder(0, m.data)),
            "r_enc": ("std_msgs/Int32", lambda m: reports.encoder(1, m.data)),
            "l_vel": ("std_msgs/Float32", lambda m: reports.speed(0, m.data)),
            "r_vel": ("std_msgs/Float32", lambda m: reports.speed(1, m.data)),
            "voltage": ("std_msgs/Float32", lambda m: reports.voltage(m.data)),
        }
        for topic, (kind, take) in takers.items():
            self._subscribers[topic] = rospy.Subscriber(
                self._path(topic), ros1.message(kind), take, queue_size=100, tcp_nodelay=True
            )

    def _open_laser(self, rospy: Any) -> None:
        path = self._path("set_laser_galvo")
        try:
            rospy.wait_for_service(path, timeout=self._settings.connect_s)
        except rospy.ROSException:
            raise LinkError(f"{self._name}: got no service {path}, expected a Zumy's bridge node") from None
        self.laser = LaserService(rospy, path)

    def _wait(self, done: Callable[[], bool], otherwise: Callable[[], str]) -> None:
        end = time.monotonic() + self._settings.connect_s
        while not done():
            if time.monotonic() > end:
                raise LinkError(f"{self._name}: got {otherwise()}, expected a Zumy's bridge node")
            time.sleep(0.01)

    def _unheard(self, *topics: str) -> list[str]:
        """Which of these topics, or of all, have nobody at their other end."""
        ends = {**self._publishers, **self._subscribers}
        return [self._path(topic) for topic in topics or ends if not ros1.connected(ends[topic])]

    def _require_node(self) -> None:
        if not self._publishers:
            raise LinkError(f"{self._name}: got a closed link, expected one that is connected")
        gone = self._unheard(self._command_topic, "imu")
        if gone:
            raise LinkError(f"{self._name}: got nobody at {', '.join(gone)}, expected the robot's bridge node")

    def _drive(self, wheels_rad_s: Pair) -> None:
        if self._publishers:
            vector = ros1.message("geometry_msgs/Vector3")
            v, omega = twist_of(wheels_rad_s, self._robot)
            self._publish(self._command_topic, linear=vector(v, 0, 0), angular=vector(0, 0, omega))

    def _publish(self, topic: str, **fields: Any) -> None:
        """Queue a message. One that cannot be queued is counted; `read` and `send` then find the node gone."""
        publisher = self._publishers.get(topic)
        if publisher is not None:
            try:
                publisher.publish(**fields)
            except Exception:  # noqa: BLE001
                # rospy raises whatever its transport did, and `stop` must not
                self.unsent += 1

    def _take_imu(self, m: Any) -> None:
        gyro, accel, stamp = m.angular_velocity, m.linear_acceleration, m.header.stamp
        device_s = stamp.to_sec() if stamp.secs or stamp.nsecs else None
        self.reports.imu(device_s, (gyro.x, gyro.y, gyro.z), (accel.x, accel.y, accel.z))


def twist_of(wheels_rad_s: Pair, robot: RobotSpecification) -> Pair:
    """(v, omega) in m/s and rad/s at which the node turns the wheels so: l, r = (v -/+ omega d/2) / radius."""
    left, right = wheels_rad_s
    radius_m = robot.wheel_radius_m
    return radius_m * (left + right) / 2, radius_m * (right - left) / robot.track_m
